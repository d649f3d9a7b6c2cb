"""Draws faults in the instructions of a kernel, uniformly over all that it executes in a golden flight.

Two golden flights come first: one counts, and one finds out what the drawn instructions are.  Both are bit for bit the
golden flight, so the first one is it.
"""

import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from mavfi.detectors.detector import Detector
from mavfi.errors import BadInputError
from mavfi.faults.fault import NO_SITE, Fault, FaultSite
from mavfi.faults.instruction import InstructionFault, Locating, Profiling, Resolving, Site, budget_for, choose
from mavfi.faults.instruction.build import name_of
from mavfi.faults.instruction.fault import plan
from mavfi.faults.instruction.selection import parse_selection
from mavfi.faults.sampling import stream
from mavfi.hosts.beginning import beginning_of, fly_until
from mavfi.hosts.inprocess import Flight, Host, fly
from mavfi.hosts.kernel_strata import Pick, pick
from mavfi.mission import Scenario
from mavfi.pipeline.functions import PLAIN, STRUCK, KernelFunctions
from mavfi.states import KERNEL_STAGES

RESTART_S = 0.57
"""Time until a node that died answers again: a ROS 1 node that was killed and started again by roslaunch, measured."""
PLANNERS = ("rrt", "rrt_connect", "rrt_star")
"""Kernels that are flown only where the mission names them as its planner."""
DATA = ("floating_point", "integer")
"""Value classes from which neither an address nor a branch is computed."""
_LAYOUTS = {"double": (63, 52), "float": (31, 23), "half": (15, 10)}
"""Sign bit and lowest exponent bit."""
_ROUNDS, _SPARE = 6, 40


@dataclass(frozen=True, slots=True)
class Wish:
    """What is to be drawn.

    Attributes:
        kernels: How many faults in each kernel.
        which: Class of instructions, see `mavfi.faults.instruction.selection`.
        model: What becomes of the value.
        restart_s: After which time a node that died answers again (s).
        lines: Whether to count by source line too.
        sampling: "uniform" over dynamic instructions, or "stratified" by value class and source line, with weights.
    """

    kernels: Mapping[str, int]
    which: str = "all"
    model: Any = "one_bit"
    restart_s: float = RESTART_S
    lines: bool = True
    sampling: Literal["uniform", "stratified"] = "uniform"


@dataclass(frozen=True, slots=True)
class Drawn:
    """A golden flight, and the faults for its twins.

    Attributes:
        golden: The flight.
        kernels: By kernel, as plain data: `instructions` and `calls` of the mission, and `lines`: file, line, count.
        faults: By kernel.
    """

    golden: Flight
    kernels: dict[str, dict[str, Any]]
    faults: dict[str, list[Fault]]


def check_kernel(kernel: str, planner: str) -> None:
    """Refuse a kernel that cannot be struck in a mission.

    Raises:
        BadInputError: There is none of that name, or it is a planner and the mission flies another one.
    """
    if kernel not in STRUCK:
        raise BadInputError(f"kernel {kernel!r}: not known; allowed: {', '.join(STRUCK)}")
    if kernel in PLANNERS and kernel != planner:
        raise BadInputError(f"kernel {kernel!r}: the planner of this mission is {planner!r}; allowed: planner {kernel}")


def stratum_of(kind: str, bit: int | None) -> str:
    """What a bit means in a value: "sign", "exponent" or "mantissa"; "other" where it is no floating-point number.

    Args:
        kind: Type of the value, as in LLVM; of a vector the bit counts through its elements.
        bit: None = no single bit.
    """
    element = re.sub(r"<\d+ x (\w+)>", r"\1", kind)
    if bit is None or element not in _LAYOUTS:
        return "other"
    sign, exponent = _LAYOUTS[element]
    place = bit % (sign + 1)
    return "sign" if place == sign else "exponent" if place >= exponent else "mantissa"


def draw_kernel_faults(
    scenario: Scenario, wish: Wish, *address: str, seed: int, detector: Detector | None = None
) -> Drawn:  # fmt: skip
    """Fly the golden flight, and draw.

    Args:
        scenario: The mission.
        wish: What to draw.
        address: What tells these faults from others of the same seed, e.g. the environment.
        seed: Of the draw.
        detector: What watches the flight.

    Returns:
        Flight and faults. A kernel that executes no such instruction gives faults without a site.

    Raises:
        BadInputError: There is no such kernel, class or model.
        RefusedError: A kernel cannot be instrumented exactly.
    """
    for kernel in wish.kernels:
        check_kernel(kernel, scenario.planner.name)
    parse_selection(wish.which)
    names = tuple(name for kernel in wish.kernels for name in STRUCK[kernel])
    counted: dict[str, Profiling] = {}

    def count(name: str, function: Any) -> Profiling:
        counted[name] = Profiling(function)
        return counted[name]

    golden = fly(scenario, None, detector, functions=PLAIN.with_twins(names, count))
    draws = {
        kernel: _Draw(kernel, wish, counted, number, stream(seed, "instruction", kernel, *address), seed)
        for kernel, number in wish.kernels.items()
    }
    if wish.sampling == "stratified":
        _draw_strata(scenario, detector, draws, golden)
    for _ in range(_ROUNDS if wish.sampling == "uniform" else 0):
        places = {kernel: draw.places() for kernel, draw in draws.items() if not draw.done}
        if not any(places.values()):
            break
        sites = _resolve(scenario, detector, [place for own in places.values() for place in own], golden)
        for kernel, own in places.items():
            draws[kernel].take(own, sites)
    return Drawn(
        golden,
        {kernel: _profile([counted[name] for name in STRUCK[kernel]]) for kernel in wish.kernels},
        {kernel: draw.faults() for kernel, draw in draws.items()},
    )


_Place = tuple[str, int, int]
"""Function, call, index."""


def _resolve(
    scenario: Scenario, detector: Detector | None, places: Sequence[_Place], golden: Flight
) -> dict[_Place, Site | None]:
    """What the drawn instructions are, from one more golden flight."""
    wanted: dict[str, dict[int, list[int]]] = {}
    for name, call, index in places:
        wanted.setdefault(name, {}).setdefault(call, []).append(index)
    twins = {name: Resolving(getattr(PLAIN, name), calls) for name, calls in wanted.items()}
    _fly_again(scenario, detector, twins, golden, lambda: all(twin.done for twin in twins.values()))
    return {(name, *place): site for name, twin in twins.items() for place, site in twin.sites.items()}


def _draw_strata(
    scenario: Scenario, detector: Detector | None, draws: "Mapping[str, _Draw]", golden: Flight
) -> None:  # fmt: skip
    """Draw by stratum; one more golden flight tells in which calls the drawn instructions are."""
    picks = {kernel: draw.picks() for kernel, draw in draws.items()}
    wanted: dict[str, dict[str, list[tuple[int, int]]]] = {}
    for chosen in [chosen for own in picks.values() for chosen in own]:
        by_digest = wanted.setdefault(chosen.function, {})
        by_digest.setdefault(chosen.digest, []).append((chosen.site.block, chosen.number))
    if not wanted:
        return
    twins = {name: Locating(getattr(PLAIN, name), blocks) for name, blocks in wanted.items()}
    _fly_again(scenario, detector, twins, golden, lambda: False)
    for kernel, own in picks.items():
        for chosen in own:
            call, start = twins[chosen.function].place(chosen.digest, chosen.site.block, chosen.number)
            place = chosen.function, call, start + chosen.site.offset
            draws[kernel].add(place, chosen.site, chosen.weight)


def _fly_again(
    scenario: Scenario, detector: Detector | None, twins: Mapping[str, Any], golden: Flight, enough: Callable[[], bool]
) -> None:  # fmt: skip
    """Fly the golden flight with twins of functions, until it is enough.

    Raises:
        MavfiError: It was another flight.
    """
    functions: KernelFunctions = PLAIN.with_twins(tuple(twins), lambda name, _: twins[name])
    host = Host(scenario, None, detector, functions=functions)
    with np.errstate(all="ignore"):
        fly_until(host, enough)
    beginning_of(host).check(golden.log)


class _Draw:
    """The draw of one kernel's faults."""

    def __init__(
        self, kernel: str, wish: Wish, counted: Mapping[str, Profiling], number: int, random: np.random.Generator,
        seed: int,
    ) -> None:  # fmt: skip
        self._kernel, self._wish, self._number, self._random, self._seed = kernel, wish, number, random, seed
        self._counted = {name: counted[name] for name in STRUCK[kernel]}
        self._counts = [count for twin in self._counted.values() for count in twin.counts]
        self._calls = [(name, call) for name, twin in self._counted.items() for call in range(len(twin.counts))]
        self._found: list[Fault] = []

    @property
    def done(self) -> bool:
        """Whether nothing is left to draw."""
        return len(self._found) >= self._number or not sum(self._counts)

    def places(self) -> list[_Place]:
        """Dynamic instructions of the mission, uniform; spare ones where only a class is wanted."""
        number = self._number if self._wish.which == "all" else _SPARE * self._number
        return [(*self._calls[call], index) for call, index in choose(self._random, self._counts, number)]

    def take(self, places: Sequence[_Place], sites: Mapping[_Place, Site | None]) -> None:
        """Plan a fault for each place that is of the class."""
        selection = parse_selection(self._wish.which)
        for place in places:
            site = sites[place]
            if site is not None and site in selection and len(self._found) < self._number:
                self._found.append(self._fault(place, site))

    def picks(self) -> list[Pick]:
        """Dynamic instructions of the mission, drawn by stratum."""
        return pick(self._random, self._counted, parse_selection(self._wish.which), self._number)

    def add(self, place: _Place, site: Site, weight: float) -> None:
        """Plan a fault for an instruction that was drawn by stratum."""
        self._found.append(replace(self._fault(place, site), weight=weight))

    def _fault(self, place: _Place, site: Site) -> Fault:
        name, call, index = place
        twin = self._counted[name]
        planned = plan(
            self._random, name_of(getattr(PLAIN, name)), twin.digests[call], site, index, self._wish.model
        )  # fmt: skip
        planned = replace(planned, call=call, which=self._wish.which, budget=budget_for(twin.counts[call]))
        bit = planned.bits[0] if len(planned.bits) == 1 else None
        fault = make_fault(self._kernel, name, planned, stratum_of(site.kind, bit), self._wish.restart_s, self._seed)
        return replace(fault, instruction={**(fault.instruction or {}), "value_class": site.value_class})

    def faults(self) -> list[Fault]:
        """As many as were wanted; those that were not found have no site."""
        nothing = Fault(
            "instruction", FaultSite(self._kernel, ""), NO_SITE, stage=_stage(self._kernel), seed=self._seed
        )  # fmt: skip
        return self._found + [nothing] * (self._number - len(self._found))


def make_fault(
    kernel: str, function: str, planned: InstructionFault, stratum: str, restart_s: float, seed: int
) -> Fault:  # fmt: skip
    """A planned instruction fault as a fault of a mission."""
    bit = planned.bits[0] if len(planned.bits) == 1 else None
    data = planned.to_json() | {"restart_s": restart_s}
    return Fault(
        "instruction", FaultSite(kernel, function), bit=bit, stratum=stratum, stage=_stage(kernel), seed=seed,
        instruction=data,
    )  # fmt: skip


def planned_of(fault: Fault) -> tuple[InstructionFault, float]:
    """Inverse of `make_fault`: what is struck, and the restart latency (s)."""
    data = dict(fault.instruction or {})
    restart_s = float(data.pop("restart_s"))
    data.pop("value_class", None)
    return InstructionFault.from_json(data), restart_s


def is_in_data(fault: Fault) -> bool:
    """Whether neither an address nor a branch depends on what is struck, so that the rest of the process is safe."""
    return not fault.has_site or (fault.instruction or {}).get("value_class") in DATA


def _stage(kernel: str) -> str:
    return KERNEL_STAGES[kernel].value


def _profile(twins: Sequence[Profiling]) -> dict[str, Any]:
    lines: Counter[tuple[str, int]] = Counter()
    for twin in twins:
        for site, times in twin.sites():
            lines[site.file, site.line] += times
    return {
        "instructions": sum(sum(twin.counts) for twin in twins),
        "calls": sum(len(twin.counts) for twin in twins),
        "lines": [[file, line, count] for (file, line), count in sorted(lines.items())],
    }
