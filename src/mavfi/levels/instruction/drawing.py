"""Drawing of faults in instructions from golden flights.

Two golden flights make a draw.  The first one is the mission's golden run: it counts the instructions of every call,
and takes the checkpoints for the injected runs.  Call and index of each fault are drawn from these counts.  Which
instruction that is, and how many bits its value has, is resolved in the second flight: where to look is not known
before the first one has ended.  Both are bit-identical.
Instructions of protected kernels are those of the protected code: shadows and comparisons can be drawn.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal

from mavfi.errors import BadInputError
from mavfi.faults.fault import NO_SITE, RESTART_S
from mavfi.faults.sampling import stream
from mavfi.flight.decide import INLINE, RecoveryPolicy
from mavfi.flight.targets import InjectionTarget, Targets
from mavfi.ir.injection.table import InjectionSite, parse_selection
from mavfi.ir.injection.variant import Profiling, Resolving
from mavfi.levels.instruction.fault import InstructionFault, Model
from mavfi.levels.instruction.plan import budget_for, choose, plan
from mavfi.mission import Scenario
from mavfi.rewriting import rewriting_of

if TYPE_CHECKING:
    from mavfi.detectors.detector import Detector
    from mavfi.flight.host import ArmSetup, Flight
    from mavfi.flight.mission_flights import LocalFlights

_MAX_ROUNDS = 6
"""Rounds of drawing for instructions of a class; more only if it is executed less than once in 240 instructions."""
_SPARES = 40
"""Draws per fault of a class: those outside it are dropped."""
When = Literal["uniform", "second_plan"]
"""Calls from which faults are drawn: all of the mission, or those from the second step of the planner on.

At its second plan the authors' injector of registers stops the planner's node (MAVBench/MAV_apps, branch mavfi).
"""


@dataclass(frozen=True, slots=True)
class InstructionRequest:
    """Faults in instructions to be drawn from one mission.

    Attributes:
        kernels: Number of faults in each kernel, by names of targets, see `mavfi.flight.targets`.
        which: Class of instructions, see `mavfi.ir.injection.table`.
        model: How the value is changed.
        restart_s: Time after which a crashed node has restarted (s).
        when: Calls from which they are drawn.
        times: Number of calls that are changed.
    """

    kernels: Mapping[str, int]
    which: str = "all"
    model: Model = "one_bit"
    restart_s: float = RESTART_S
    when: When = "uniform"
    times: int = 1

    def draw(self, setup: "ArmSetup", seed: int) -> "tuple[InstructionFault, Flight | None]":
        """See `Request.draw`, for a request of one fault."""
        ((kernel, _),) = self.kernels.items()
        target = Targets(setup.scenario, setup.detector()).find(kernel)
        detector = None
        if target.in_detector:
            detector = setup.detector()
        drawn = draw_instruction_faults(setup.scenario, self, seed=seed, detector=detector, recovery=setup.recovery)
        fault = drawn.faults[kernel][0]
        if not fault.has_site:
            raise BadInputError(
                f"fault instruction:{kernel}: this mission executes no instruction {self.which!r} there; "
                "allowed: a class that it executes"
            )
        if detector is not None:
            return fault, None
        return fault, drawn.golden


@dataclass(frozen=True, slots=True)
class InstructionSite:
    """A fault in one dynamic instruction of one call; nothing is drawn."""

    fault: InstructionFault

    def draw(self, setup: "ArmSetup", seed: int) -> tuple[InstructionFault, None]:
        """See `Request.draw`; a BadInputError if the mission lacks the kernel, or the kernel the function."""
        del seed
        target = Targets(setup.scenario, setup.detector()).of_fault(self.fault)
        return replace(self.fault, kernel=target.name, role=target.role), None


@dataclass(frozen=True, slots=True)
class DrawnFaults:
    """Faults drawn from a golden flight.

    Attributes:
        golden: The golden flight.
        counts: By kernel: number of executed `instructions` and `calls`, and `lines`: file, line, count.
        faults: The faults by kernel.
    """

    golden: "Flight"
    counts: dict[str, dict[str, Any]]
    faults: dict[str, list[InstructionFault]]


@dataclass(frozen=True, slots=True)
class _Position:
    """A dynamic instruction: function (name of its counter), its call, and index in the call."""

    counter: str
    call: int
    index: int


def draw_instruction_faults(
    scenario: Scenario,
    request: InstructionRequest,
    *address: str,
    seed: int,
    detector: "Detector | None" = None,
    recovery: RecoveryPolicy = INLINE,
    flights: "LocalFlights | None" = None,
    arm: str = "",
) -> DrawnFaults:
    """Fly the golden flight, and draw faults; a kernel that executes no such instruction gives faults without a site.

    The draw depends on the seed and on an address, e.g. the environment, that distinguishes faults of the same seed.
    A detector, with its recovery, is flown only if the faults are in its own instructions.  `flights` are all flights
    of the mission, `arm` the one that is flown here.

    Raises:
        BadInputError: A kernel, class or fault model is unknown.
        NotInstrumentableError: A kernel cannot be instrumented exactly.
    """
    from mavfi.flight.host import ArmSetup
    from mavfi.flight.mission_flights import LocalHost
    from mavfi.levels.instruction.second_plan import SecondPlan

    mission_targets = Targets(scenario, detector)
    targets = {kernel: mission_targets.find(kernel) for kernel in request.kernels}
    parse_selection(request.which)
    if flights is None:
        setup = ArmSetup(scenario, recovery=recovery)
        if detector is not None:
            setup = ArmSetup(scenario, lambda: detector, recovery)
        flights = LocalHost().mission({arm: setup}, fast_forward=False)  # nothing would start from checkpoints

    # 1. Count the instructions of every call in the golden flight.
    rewriting = rewriting_of(scenario.protection)
    compiled = {
        counter: target.functions[entry] for target in targets.values() for counter, entry in target.counters.items()
    }
    counters = {counter: Profiling(function, rewriting) for counter, function in compiled.items()}
    if request.when == "second_plan":
        of_planner = [target for target in targets.values() if target.kernel == "planner"]
        second_plan = SecondPlan(counters, [counter for target in of_planner for counter in target.counters])
        golden = flights.count_instructions(arm, counters, [second_plan])
        first_calls = second_plan.first_calls()
    else:
        golden = flights.count_instructions(arm, counters)
        first_calls = dict.fromkeys(counters, 0)

    # 2. Draw positions, and resolve them, until there are enough faults of the class.
    draws = [
        _KernelDraw(
            targets[kernel],
            number,
            request,
            {counter: counters[counter] for counter in targets[kernel].counters},
            first_calls,
            seed,
            address,
        )
        for kernel, number in request.kernels.items()
    ]
    for _ in range(_MAX_ROUNDS):
        positions = [(draw, position) for draw in draws for position in draw.positions()]
        if not positions:
            break
        indices: dict[str, dict[int, list[int]]] = {}
        for _, position in positions:
            indices.setdefault(position.counter, {}).setdefault(position.call, []).append(position.index)
        resolvers = {name: Resolving(compiled[name], calls, rewriting) for name, calls in indices.items()}
        flights.resolve_instructions(arm, resolvers)
        for draw, position in positions:
            draw.take(position, resolvers[position.counter].sites[position.call, position.index])
    draw_of = dict(zip(request.kernels, draws, strict=True))
    return DrawnFaults(
        golden,
        {kernel: instruction_counts(list(draw.counters.values())) for kernel, draw in draw_of.items()},
        {kernel: draw.all_faults() for kernel, draw in draw_of.items()},
    )


class _KernelDraw:
    """The draw of one kernel's faults from the counts of its functions, from the first call that is given for each."""

    def __init__(
        self,
        target: InjectionTarget,
        number: int,
        request: InstructionRequest,
        counters: Mapping[str, Profiling],
        first_calls: Mapping[str, int],
        seed: int,
        address: tuple[str, ...],
    ) -> None:
        self._target = target
        self.counters = counters
        self._calls: list[tuple[str, int]] = []
        self._counts: list[int] = []
        for name, counter in counters.items():
            first = first_calls[name]
            self._calls += [(name, call) for call in range(first, len(counter.counts))]
            self._counts += counter.counts[first:]
        self._number = number
        self._request = request
        self._seed = seed
        self._random = stream(seed, "instruction", target.name, *address)
        self._selection = parse_selection(request.which)
        self._faults: list[InstructionFault] = []

    def positions(self) -> list[_Position]:
        """Draw dynamic instructions of the mission uniformly, with spares if limited to a class; empty when done."""
        if len(self._faults) >= self._number or not sum(self._counts):
            return []
        if self._request.which == "all":
            number = self._number
        else:
            number = _SPARES * self._number
        chosen = choose(self._random, self._counts, number)
        return [_Position(*self._calls[position], index) for position, index in chosen]

    def take(self, position: _Position, site: InjectionSite | None) -> None:
        """Plan a fault at a position if its instruction is of the class and faults are still missing."""
        if site is None or site not in self._selection or len(self._faults) >= self._number:
            return
        counter = self.counters[position.counter]
        request = self._request
        call = position.call
        self._faults.append(
            plan(
                self._random,
                "",
                counter.digests[call],
                site,
                position.index,
                request.model,
                call=call,
                which=request.which,
                budget=budget_for(counter.counts[call]),
                kernel=self._target.name,
                entry=self._target.counters[position.counter],
                restart_s=request.restart_s,
                seed=self._seed,
                role=self._target.role,
                times=request.times,
            )
        )

    def all_faults(self) -> list[InstructionFault]:
        """The requested number of faults; those that could not be drawn have no site."""
        target = self._target
        nothing = InstructionFault("", "", 0, NO_SITE, kernel=target.name, seed=self._seed, role=target.role)
        return self._faults + [nothing] * (self._number - len(self._faults))


def instruction_counts(counters: Sequence[Profiling]) -> dict[str, Any]:
    """Executed instructions and calls of a kernel's functions, see `DrawnFaults.counts`."""
    lines: Counter[tuple[str, int]] = Counter()
    for counter in counters:
        for _, site, times in counter.executed():
            lines[site.file, site.line] += times
    return {
        "instructions": sum(sum(counter.counts) for counter in counters),
        "calls": sum(len(counter.counts) for counter in counters),
        "lines": [[file, line, count] for (file, line), count in sorted(lines.items())],
    }
