"""Draws faults in instructions of a mission's kernels: uniformly over all executed instructions, or by strata.

Instructions of protected kernels are those of the protected code: shadows and comparisons can be drawn.
A first golden flight counts instructions; a second one resolves the drawn instructions (uniform), or locates their
calls (stratified, see `mavfi.faults.instruction.strata`).  Both are bit-identical; the first one is the golden run.
With a mission's other flights at hand, the first one takes their checkpoints, and the second one starts from these.
"""

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from mavfi.detectors.detector import Detector, part_of
from mavfi.errors import BadInputError
from mavfi.faults.fault import NO_SITE, InstructionFault
from mavfi.faults.instruction import Locating, Profiling, Resolving, Site, budget_for, choose
from mavfi.faults.instruction.plan import plan
from mavfi.faults.instruction.selection import parse_selection
from mavfi.faults.instruction.strata import pick
from mavfi.faults.sampling import stream
from mavfi.faults.spec import InstructionRequest, InstructionSite
from mavfi.hosts.host import ArmSetup, Flight
from mavfi.hosts.instruction.case import check_kernel
from mavfi.hosts.instruction.protected import rewriting_of
from mavfi.hosts.local import fly
from mavfi.hosts.local.mission_flights import LocalFlights
from mavfi.hosts.loop.assemble import new_loop, watch
from mavfi.hosts.loop.golden_prefix import fly_until, prefix_of
from mavfi.hosts.loop.policy import INLINE, Recovery
from mavfi.ir.build import Rewriting, name_of
from mavfi.mission import Scenario
from mavfi.pipeline.functions import PLAIN, KernelFunctions
from mavfi.states import DETECTORS, GUARDS, INJECTABLE

_ROUNDS, _SPARE, _NEAR = 6, 40, 200


@dataclass(frozen=True, slots=True)
class Drawn:
    """A golden flight, and the drawn faults by kernel."""

    golden: Flight
    counts: dict[str, dict[str, Any]]  # per kernel `instructions`, `calls`, and `lines`: file, line, count
    faults: dict[str, list[InstructionFault]]


def draw_instruction_faults(
    scenario: Scenario, request: InstructionRequest, *address: str, seed: int, detector: Detector | None = None,
    recovery: Recovery = INLINE, flights: LocalFlights | None = None, arm: str = "",
) -> Drawn:  # fmt: skip
    """Fly the golden flight, and draw faults; a kernel that executes no such instruction gives faults without a site.

    The draw depends on the seed and on an address, e.g. the environment, that distinguishes faults of the same seed.
    A detector, with its recovery, is flown only if the faults are in its own instructions.  `flights` are all flights
    of the mission, `arm` the one that is flown here, if they are fast-forwarded.

    Raises:
        BadInputError: A kernel, class or fault model is unknown.
        RefusedError: A kernel cannot be instrumented exactly.
    """
    for kernel in request.kernels:
        check_kernel(kernel, scenario.planner.name, detector)
    parse_selection(request.which)
    functions = {kernel: _functions(kernel, detector) for kernel in request.kernels}
    plain = {name: function for own in functions.values() for name, function in own.items()}
    rewriting = rewriting_of(scenario)
    counted = {name: Profiling(function, rewriting) for name, function in plain.items()}
    log = None if flights is None else flights.counted(arm, counted)
    if log is None:
        counted = {name: Profiling(function, rewriting) for name, function in plain.items()}
        with _instrumented(detector, counted) as table:
            golden = fly(scenario, None, detector, recovery=recovery, functions=table)
    else:
        golden = Flight(log)

    def fly_again(made: Mapping[str, Any], enough: Callable[[], bool] = lambda: False) -> None:
        with _instrumented(detector, made) as table, np.errstate(all="ignore"):
            loop = new_loop(scenario, functions=table)
            watch(loop, detector, recovery)
            fly_until(loop, enough)
        prefix_of(loop).check(golden.log)

    def resolve(wanted: Mapping[str, Mapping[int, Sequence[int]]]) -> Mapping[str, Resolving]:
        def make() -> dict[str, Resolving]:
            return {name: Resolving(plain[name], calls, rewriting) for name, calls in wanted.items()}

        made = make()
        if log is None or flights is None or not flights.resolve(arm, made):
            made = make()
            fly_again(made, lambda: all(function.done for function in made.values()))
        return made

    draws = [
        _Draw(kernel, number, request, {name: counted[name] for name in functions[kernel]}, seed, address)
        for kernel, number in request.kernels.items()
    ]
    if request.sampling == "stratified":
        _draw_strata(draws, fly_again)
    else:
        _draw_uniform(draws, resolve)
    return Drawn(
        golden,
        {draw.kernel: _counts(list(draw.counted.values()), _copies(draw.kernel, recovery)) for draw in draws},
        {draw.kernel: draw.faults() for draw in draws},
    )


def instruction_fault(scenario: Scenario, site: InstructionSite, detector: Detector | None = None) -> InstructionFault:
    """The fault in a given instruction.

    Raises:
        BadInputError: The mission lacks the kernel, or the kernel the function.
    """
    check_kernel(site.kernel, scenario.planner.name, detector)
    functions = _functions(site.kernel, detector)
    if site.entry not in functions:
        raise BadInputError(f"kernel {site.kernel!r}: no function {site.entry!r}; allowed: {', '.join(functions)}")
    return InstructionFault(name_of(functions[site.entry]), kernel=site.kernel, entry=site.entry, **site.given)


def in_other_calls(fault: InstructionFault, setup: ArmSetup, count: int) -> list[InstructionFault]:
    """The fault in the same instruction, in up to `count` evenly spaced other calls in the golden flight of an arm.

    Of the executions of the instruction in a call the one nearest to the fault's index is chosen; calls that execute it
    at none of the `_NEAR` indices on either side are omitted.

    Raises:
        BadInputError: The mission lacks the kernel.
    """
    detector, name = setup.detector(), fault.entry
    check_kernel(fault.kernel, setup.scenario.planner.name, detector)
    function, rewriting = _functions(fault.kernel, detector)[name], rewriting_of(setup.scenario)

    def flown(made: Any) -> Any:
        with _instrumented(detector, {name: made}) as table:
            fly(setup.scenario, None, detector, recovery=setup.recovery, functions=table)
        return made

    counted = flown(Profiling(function, rewriting))
    calls = [call for call, ir in enumerate(counted.digests) if call != fault.call and ir == fault.ir_sha256]
    places = np.unique(np.linspace(0, len(calls) - 1, min(count, len(calls))).round().astype(int))
    near = {
        call: range(max(0, fault.index - _NEAR), min(counted.counts[call], fault.index + _NEAR + 1))
        for call in (calls[place] for place in places)
    }
    sites = flown(Resolving(function, {fault.call: [fault.index], **near}, rewriting)).sites
    wanted, found = sites[fault.call, fault.index], []
    for call, indices in near.items():
        same = [index for index in indices if sites[call, index] == wanted]
        if same:
            index, budget = min(same, key=lambda one: abs(one - fault.index)), budget_for(counted.counts[call])
            found.append(replace(fault, call=call, index=index, budget=budget))
    return found


def _functions(kernel: str, detector: Detector | None) -> dict[str, Any]:
    """The compiled functions of a kernel, of the detector of that name, or of recovery."""
    if kernel in DETECTORS:
        compiled: dict[str, Any] = dict(part_of(detector, kernel).compiled)
        return compiled
    return {name: getattr(PLAIN, name) for name in (INJECTABLE | GUARDS)[kernel]}


@contextmanager
def _instrumented(detector: Detector | None, made: Mapping[str, Any]) -> Iterator[KernelFunctions]:
    """Function table of the kernels with the instrumented functions `made`; the detector uses its own meanwhile."""
    parts = [part for part in (part_of(detector, source) for source in DETECTORS) if part is not None]
    for part in parts:
        part.instrument({name: function for name, function in made.items() if name in part.compiled})
    own = {field.name for field in fields(KernelFunctions)}
    try:
        yield PLAIN.instrumented(tuple(own.intersection(made)), lambda name, _: made[name])
    finally:
        for part in parts:
            part.instrument({})


_Place = tuple[str, int, int]  # function, call, index
_FlyAgain = Callable[..., None]
"""Repeats the golden flight with instrumented functions until a stop condition; raises a MavfiError if it differs."""


class _Draw:
    """The draw of one kernel's faults."""

    def __init__(
        self, kernel: str, number: int, request: InstructionRequest, counted: Mapping[str, Profiling], seed: int,
        address: tuple[str, ...],
    ) -> None:  # fmt: skip
        self.kernel, self.number, self.request, self.counted, self.seed = kernel, number, request, counted, seed
        self.random = stream(seed, "instruction", kernel, *address)
        self.selection = parse_selection(request.which)
        self.found: list[InstructionFault] = []

    @property
    def rewriting(self) -> Rewriting | None:
        """Transformation of the functions."""
        return next((function.rewriting for function in self.counted.values()), None)

    def places(self) -> list[_Place]:
        """Draw dynamic instructions of the mission uniformly, with spares if limited to a class; empty when done."""
        counts = [count for function in self.counted.values() for count in function.counts]
        if len(self.found) >= self.number or not sum(counts):
            return []
        calls = [(name, call) for name, function in self.counted.items() for call in range(len(function.counts))]
        number = self.number if self.request.which == "all" else _SPARE * self.number
        return [(*calls[call], index) for call, index in choose(self.random, counts, number)]

    def take(self, place: _Place, site: Site | None, weight: float = 1.0) -> None:
        """Plan a fault at a place if its instruction is of the class and faults are still missing."""
        if site is None or site not in self.selection or len(self.found) >= self.number:
            return
        name, call, index = place
        function, request = self.counted[name], self.request
        self.found.append(
            plan(
                self.random, name_of(function.function), function.digests[call], site, index, request.model,
                call=call, which=request.which, budget=budget_for(function.counts[call]), kernel=self.kernel,
                entry=name, restart_s=request.restart_s, weight=weight, seed=self.seed,
            )
        )  # fmt: skip

    def faults(self) -> list[InstructionFault]:
        """The requested number of faults; those that could not be drawn have no site."""
        nothing = InstructionFault("", "", 0, NO_SITE, kernel=self.kernel, seed=self.seed)
        return self.found + [nothing] * (self.number - len(self.found))


def _draw_uniform(
    draws: Sequence[_Draw], resolve: Callable[[Mapping[str, Mapping[int, Sequence[int]]]], Mapping[str, Resolving]]
) -> None:  # fmt: skip
    """Draw places and resolve them in golden flights, until there are enough faults of the class.

    `resolve` gets indices by function and call.
    """
    for _ in range(_ROUNDS):
        places = [(draw, place) for draw in draws for place in draw.places()]
        if not places:
            return
        wanted: dict[str, dict[int, list[int]]] = {}
        for _, (name, call, index) in places:
            wanted.setdefault(name, {}).setdefault(call, []).append(index)
        resolving = resolve(wanted)
        for draw, (name, call, index) in places:
            draw.take((name, call, index), resolving[name].sites[call, index])


def _draw_strata(draws: Sequence[_Draw], fly_again: _FlyAgain) -> None:
    """Draw by stratum; one further golden flight locates the calls of the drawn instructions."""
    picks = [
        (draw, chosen) for draw in draws for chosen in pick(draw.random, draw.counted, draw.selection, draw.number)
    ]
    wanted: dict[str, dict[str, list[tuple[int, int]]]] = {}
    for _, chosen in picks:
        member = chosen.member
        wanted.setdefault(member.function, {}).setdefault(member.digest, []).append((member.site.block, chosen.number))
    if not wanted:
        return
    plain = {name: function.function for draw, _ in picks for name, function in draw.counted.items()}
    locating = {name: Locating(plain[name], blocks, draws[0].rewriting) for name, blocks in wanted.items()}
    fly_again(locating)
    for draw, chosen in picks:
        member = chosen.member
        call, start = locating[member.function].place(member.digest, member.site.block, chosen.number)
        draw.take((member.function, call, start + member.site.offset), member.site, chosen.weight)


def _copies(kernel: str, recovery: Recovery) -> int:
    """Number of copies that execute a kernel's instructions; in golden flights those of a detector are identical."""
    return recovery.copies if kernel in DETECTORS else 1


def _counts(functions: Sequence[Profiling], copies: int = 1) -> dict[str, Any]:
    """Executed instructions and calls of all copies, given the functions of one."""
    lines: Counter[tuple[str, int]] = Counter()
    for function in functions:
        for _, site, times in function.executed():
            lines[site.file, site.line] += copies * times
    return {
        "instructions": copies * sum(sum(function.counts) for function in functions),
        "calls": copies * sum(len(function.counts) for function in functions),
        "lines": [[file, line, count] for (file, line), count in sorted(lines.items())],
    }
