"""Faults in instructions of a mission's kernels and detectors, uniform over all executed instructions.

Two golden flights make a draw.  The first one is the mission's golden run: it counts the instructions of every call,
and takes the checkpoints for the injected runs.  Call and index of each fault are drawn from these counts.  Which
instruction that is, and how many bits its value has, is resolved in the second flight: where to look is not known
before the first one has ended.  Both are bit-identical.
Instructions of protected kernels are those of the protected code: shadows and comparisons can be drawn.

In a campaign, faults are distributed equally over kernels, or over stages and their kernels.  Faults in a planner other
than the campaign's are drawn in separate missions with that planner.  Faults in a detector are drawn from the golden
run of its arm, which counts kernels, recomputations included, and detector, and are injected in that arm alone.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from mavfi.campaign.config import Campaign, InstructionSampling
from mavfi.campaign.fingerprint import python
from mavfi.campaign.samplers.sampler import Block, Draw, Sampled, watched_in
from mavfi.detectors.detector import Detector, part_of
from mavfi.errors import BadInputError
from mavfi.faults.fault import NO_SITE, Fault, InstructionFault
from mavfi.faults.levels.instruction import Profiling, Resolving, Site, budget_for, choose
from mavfi.faults.levels.instruction.plan import plan
from mavfi.faults.levels.instruction.selection import parse_selection
from mavfi.faults.sampling import share_out, stream
from mavfi.faults.spec import InstructionRequest, InstructionSite
from mavfi.flight.case import check_kernel
from mavfi.flight.decide import INLINE, Recovery
from mavfi.flight.host import ArmSetup, Flight, MissionFlights
from mavfi.flight.mission_flights import LocalFlights, LocalHost
from mavfi.ir.module import DIGEST_VERSION
from mavfi.mission import Scenario
from mavfi.pipeline.functions import PLAIN
from mavfi.rewriting import rewriting_of
from mavfi.states import DETECTORS, INJECTABLE, KERNEL_STAGES, PLANNERS, PPC_STAGES

_MAX_ROUNDS = 6
"""Rounds of drawing for instructions of a class; more only if it is executed less than once in 240 instructions."""
_SPARES = 40
"""Draws per fault of a class: those outside it are dropped."""


@dataclass(frozen=True, slots=True)
class DrawnFaults:
    """Faults drawn from a golden flight.

    Attributes:
        golden: The golden flight.
        counts: By kernel: number of executed `instructions` and `calls`, and `lines`: file, line, count.
        faults: The faults by kernel.
    """

    golden: Flight
    counts: dict[str, dict[str, Any]]
    faults: dict[str, list[InstructionFault]]


@dataclass(frozen=True, slots=True)
class _Position:
    """A dynamic instruction: function, its call, and index in the call."""

    entry: str
    call: int
    index: int


def draw_instruction_faults(
    scenario: Scenario, request: InstructionRequest, *address: str, seed: int, detector: Detector | None = None,
    recovery: Recovery = INLINE, flights: LocalFlights | None = None, arm: str = "",
) -> DrawnFaults:  # fmt: skip
    """Fly the golden flight, and draw faults; a kernel that executes no such instruction gives faults without a site.

    The draw depends on the seed and on an address, e.g. the environment, that distinguishes faults of the same seed.
    A detector, with its recovery, is flown only if the faults are in its own instructions.  `flights` are all flights
    of the mission, `arm` the one that is flown here.

    Raises:
        BadInputError: A kernel, class or fault model is unknown.
        RefusedError: A kernel cannot be instrumented exactly.
    """
    for kernel in request.kernels:
        check_kernel(kernel, scenario.planner.name, detector)
    parse_selection(request.which)
    if flights is None:
        flights = _flights_of(ArmSetup(scenario, None if detector is None else lambda: detector, recovery), arm)

    # 1. Count the instructions of every call in the golden flight.
    rewriting = rewriting_of(scenario.protection)
    functions = {kernel: _functions(kernel, detector) for kernel in request.kernels}
    compiled = {entry: function for entries in functions.values() for entry, function in entries.items()}
    counters = {entry: Profiling(function, rewriting) for entry, function in compiled.items()}
    golden = flights.count_instructions(arm, counters)

    # 2. Draw positions, and resolve them, until there are enough faults of the class.
    draws = [
        _KernelDraw(kernel, number, request, {entry: counters[entry] for entry in functions[kernel]}, seed, address)
        for kernel, number in request.kernels.items()
    ]
    for _ in range(_MAX_ROUNDS):
        positions = [(draw, position) for draw in draws for position in draw.positions()]
        if not positions:
            break
        indices: dict[str, dict[int, list[int]]] = {}
        for _, position in positions:
            indices.setdefault(position.entry, {}).setdefault(position.call, []).append(position.index)
        resolvers = {entry: Resolving(compiled[entry], calls, rewriting) for entry, calls in indices.items()}
        flights.resolve_instructions(arm, resolvers)
        for draw, position in positions:
            draw.take(position, resolvers[position.entry].sites[position.call, position.index])
    return DrawnFaults(
        golden,
        {draw.kernel: instruction_counts(list(draw.counters.values())) for draw in draws},
        {draw.kernel: draw.all_faults() for draw in draws},
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
    return InstructionFault("", kernel=site.kernel, entry=site.entry, **site.given)


def _flights_of(setup: ArmSetup, arm: str = "") -> LocalFlights:
    """Flights of one arm alone: nothing would start from checkpoints."""
    return LocalHost().mission({arm: setup}, fast_forward=False)


def _functions(kernel: str, detector: Detector | None) -> dict[str, Any]:
    """The compiled functions of a kernel, of the detector of that name, or of recovery."""
    if kernel in DETECTORS:
        compiled: dict[str, Any] = dict(part_of(detector, kernel).compiled)
        return compiled
    return {entry: getattr(PLAIN, entry) for entry in INJECTABLE[kernel]}


class _KernelDraw:
    """The draw of one kernel's faults from the counts of its functions."""

    def __init__(
        self, kernel: str, number: int, request: InstructionRequest, counters: Mapping[str, Profiling], seed: int,
        address: tuple[str, ...],
    ) -> None:  # fmt: skip
        self.kernel, self.counters = kernel, counters
        self._number, self._request, self._seed = number, request, seed
        self._random = stream(seed, "instruction", kernel, *address)
        self._selection = parse_selection(request.which)
        self._faults: list[InstructionFault] = []

    def positions(self) -> list[_Position]:
        """Draw dynamic instructions of the mission uniformly, with spares if limited to a class; empty when done."""
        counts = [count for counter in self.counters.values() for count in counter.counts]
        if len(self._faults) >= self._number or not sum(counts):
            return []
        calls = [(entry, call) for entry, counter in self.counters.items() for call in range(len(counter.counts))]
        number = self._number if self._request.which == "all" else _SPARES * self._number
        return [_Position(*calls[place], index) for place, index in choose(self._random, counts, number)]

    def take(self, position: _Position, site: Site | None) -> None:
        """Plan a fault at a position if its instruction is of the class and faults are still missing."""
        if site is None or site not in self._selection or len(self._faults) >= self._number:
            return
        counter, request, call = self.counters[position.entry], self._request, position.call
        self._faults.append(
            plan(
                self._random, "", counter.digests[call], site, position.index, request.model,
                call=call, which=request.which, budget=budget_for(counter.counts[call]), kernel=self.kernel,
                entry=position.entry, restart_s=request.restart_s, seed=self._seed,
            )
        )  # fmt: skip

    def all_faults(self) -> list[InstructionFault]:
        """The requested number of faults; those that could not be drawn have no site."""
        nothing = InstructionFault("", "", 0, NO_SITE, kernel=self.kernel, seed=self._seed)
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


class InstructionSampler:
    """Draws one result of one dynamic instruction.

    Raises:
        BadInputError: Arms and kernels are incompatible.
    """

    instruments = True

    def __init__(self, campaign: Campaign) -> None:
        assert isinstance(campaign.sampling, InstructionSampling)  # as `sampler_for` chooses
        self._campaign, self._sampling = campaign, campaign.sampling
        # Numba compiles Python's bytecode, which determines the fault space.
        self.versions: Mapping[str, str] = {"python": python(), "fault space": DIGEST_VERSION}
        self._blocks: dict[str, Sequence[Block]] = {}
        planner = campaign.spec(campaign.environments[0], campaign.first_seed).planner
        other_planners = [name for name in self._sampling.kernels if name in PLANNERS and name != planner]
        self.variants: Mapping[str, Mapping[str, Any]] = {name: {"planner": name} for name in other_planners}
        if campaign.arms and other_planners:
            raise BadInputError(
                f"sampling.kernels: {other_planners[0]!r}: detectors are trained with one planner; allowed with arms: "
                f"kernels of missions with planner {planner!r}"
            )
        self._arm_of = {name: watched_in(campaign, name) for name in self._sampling.kernels if name in DETECTORS}
        _check_arms(campaign, self._sampling.kernels, {"planner": planner, "map": "octomap"})
        if campaign.nulls:
            raise BadInputError(f"null_runs: {campaign.nulls}; allowed: 0 with faults in instructions")

    def blocks(self, environment: str) -> Sequence[Block]:
        """One block per kernel or stage; the seed draws the kernels of a stage's faults."""
        if environment not in self._blocks:
            groups = kernel_groups(self._sampling)
            self._blocks[environment] = [self._block(environment, place, group) for place, group in enumerate(groups)]
        return self._blocks[environment]

    def _block(self, environment: str, place: int, group: tuple[str, ...]) -> Block:
        campaign, stage = self._campaign, str(KERNEL_STAGES.get(group[0], group[0]))
        kernels = share_out(dict.fromkeys(group, 1.0), campaign.faults, campaign.first_seed, environment, stage)

        def draw_one(index: int) -> Draw:
            seed = campaign.first_seed + index % campaign.missions
            return Draw(kernels[index], index, seed, self._flown_in(kernels[index]))

        return Block(campaign.faults, draw_one, place * campaign.faults)

    def _flown_in(self, kernel: str) -> str:
        """Variant or arm in whose golden runs faults of a kernel are drawn; "" = the campaign's own mission."""
        if kernel in self._arm_of:
            return self._arm_of[kernel]
        return kernel if kernel in self.variants else ""

    def golden(
        self, arm: str, draws: Sequence[Draw], environment: str, flights: MissionFlights, setup: ArmSetup
    ) -> Sampled:  # fmt: skip
        """Fly the golden run with instruction counters, and draw its faults."""
        targets = [draw.target for draw in draws]
        has_targets = arm in self._arm_of.values()
        counted_arms = {arm, ""} if has_targets else {arm}  # where a detector is counted, kernels are, too
        kernels = [name for name in self._sampling.kernels if self._flown_in(name) in counted_arms]
        if not kernels:
            return Sampled(flights.golden(arm))
        sampling, scenario = self._sampling, setup.scenario
        numbers = {name: targets.count(name) for name in kernels}
        request = InstructionRequest(numbers, sampling.which, sampling.model, sampling.restart_s)
        drawn = draw_instruction_faults(
            scenario, request, environment, seed=scenario.seed, recovery=setup.recovery,
            detector=setup.detector(), flights=flights if isinstance(flights, LocalFlights) else None, arm=arm,
        )  # fmt: skip
        flights.know(arm, drawn.golden)
        return Sampled(drawn.golden, drawn.counts, {name: faults for name, faults in drawn.faults.items() if faults})

    def draw(self, draws: Sequence[Draw], environment: str, golden: Mapping[str, Sampled]) -> list[Fault | None]:
        """The faults drawn by `golden`, in order; None for each fault of a failed golden run."""
        del environment
        remaining = {
            (arm, kernel): iter(faults)
            for arm, sampled in golden.items()
            for kernel, faults in sampled.faults.items()
        }  # fmt: skip
        return [next(remaining.get((draw.variant, draw.target), iter(())), None) for draw in draws]

    def null(self, index: int, seed: int, environment: str, golden: Mapping[str, Sampled]) -> Fault:
        """Not supported at this level."""
        raise BadInputError("null runs: allowed with faults in states")


def _check_arms(campaign: Campaign, drawn: Sequence[str], kernels: Mapping[str, str]) -> None:
    """Refuse an arm that replaces functions with drawn faults, which would never be activated there.

    `kernels`: the kernel whose functions change, by mission key.
    """
    world = campaign.environments[0], campaign.first_seed
    for name, arm in campaign.arms.items():
        for key, kernel in kernels.items():
            campaign_value = getattr(campaign.spec(*world), key)
            arm_value = getattr(campaign.spec(*world, arm.mission), key)
            if arm_value != campaign_value and kernel in drawn:
                raise BadInputError(
                    f"arms: {name!r}: {key}: {arm_value!r}: does not call what faults in {kernel} are drawn from; "
                    f"allowed: {campaign_value!r}"
                )


def kernel_groups(sampling: InstructionSampling) -> list[tuple[str, ...]]:
    """Kernels that share one number of faults: each kernel separately, or the kernels of each stage."""
    if sampling.share == "kernel":
        return [(name,) for name in sampling.kernels]
    stages = [tuple(name for name in sampling.kernels if KERNEL_STAGES.get(name) is stage) for stage in PPC_STAGES]
    detectors = [(name,) for name in sampling.kernels if name in DETECTORS]
    return [group for group in (*stages, *detectors) if group]
