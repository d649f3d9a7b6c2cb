"""Faults in instructions of kernels and detectors, uniform over all executed instructions of a mission.

As text: `instruction:pid`, `instruction:pid:which=floating_point:model=zero`, or one instruction as printed by `mavfi
shrink`.

Two golden flights make a draw.  The first one is the mission's golden run: it counts the instructions of every call,
and takes the checkpoints for the injected runs.  Call and index of each fault are drawn from these counts.  Which
instruction that is, and how many bits its value has, is resolved in the second flight: where to look is not known
before the first one has ended.  Both are bit-identical.
Instructions of protected kernels are those of the protected code: shadows and comparisons can be drawn.

In a campaign, faults are distributed equally over kernels, or over stages and their kernels.  Faults in a planner other
than the campaign's are drawn in separate missions with that planner.  Faults in a detector are drawn from the golden
run of its arm, which counts kernels, recomputations included, and detector, and are injected in that arm alone.
"""

import platform
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar, Literal, NamedTuple

from pydantic import Field, ValidationInfo, model_validator

from mavfi.config import STORED
from mavfi.dropped import dropped_name
from mavfi.errors import BadInputError, not_known
from mavfi.faults.fault import MODELS, MOST_CALLS, NO_SITE, RESTART_S, Fault, InstructionFault, Model
from mavfi.faults.levels.instruction import InjectionSite, Profiling, Resolving, budget_for, choose
from mavfi.faults.levels.instruction.plan import plan
from mavfi.faults.levels.instruction.table import parse_selection
from mavfi.faults.plug_ins import planner_name, plug_ins_of_spec, without_module
from mavfi.faults.sampling import stream
from mavfi.flight.decide import INLINE, RecoveryPolicy
from mavfi.flight.targets import InjectionTarget, Targets
from mavfi.ir.module import DIGEST_VERSION
from mavfi.levels.campaign import SampledCampaign
from mavfi.levels.level import DECIMAL, WHOLE, Draw, Golden, Level, Sampled, Sampler, Sampling, check_distinct
from mavfi.mission import Scenario
from mavfi.record import Injection
from mavfi.rewriting import rewriting_of
from mavfi.states import DETECTORS, INJECTABLE, KERNEL_STAGES, PLANNERS, PLUG_INS, PPC_STAGES, unknown

if TYPE_CHECKING:
    from mavfi.detectors.detector import Detector
    from mavfi.flight.host import ArmSetup, Flight, MissionFlights
    from mavfi.flight.mission_flights import LocalFlights

_ONE_INSTRUCTION = re.compile(
    rf"""(?P<kernel>[\w-]+)\.(?P<entry>\w+)
    :call=(?P<call>\d+)
    :index=(?P<index>\d+)
    :(bit=(?P<bits>\d+(\+\d+)*)|value=0x(?P<value>[\da-f]+))
    (:model=(?P<model>\w+))?
    (:restart=(?P<restart>{DECIMAL}))?
    (:times=(?P<times>\d+))?
    :budget=(?P<budget>\d+)
    :ir=(?P<ir>[\da-f]{{64}})""",
    re.VERBOSE,
)
"""A fault in one instruction, as written by `InstructionLevel.text_of`."""
_STORED_SCHEME = "uniform"
"""Value of the key `scheme` in the identities of ledgers; there was another one once."""
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
        which: Class of instructions, see `mavfi.faults.levels.instruction.table`.
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
    from mavfi.flight.second_plan import SecondPlan

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


class InstructionSampling(Sampling):
    """Faults in instructions: the result of one dynamic instruction of a kernel."""

    null_runs: ClassVar[int] = 0
    level: Literal["instruction"]
    kernels: tuple[str, ...] = Field(min_length=1, description="kernels; planners; detectors of an arm")
    share: Literal["kernel", "stage"] = Field(
        "kernel", description="what `faults` counts: each kernel, or each stage, whose kernels share them equally"
    )
    which: str = Field("all", description="class of instructions, e.g. floating_point")
    model: Model = Field(
        "one_bit",
        description="what becomes of the value; low_byte and high_bits are those of the authors' injector of registers",
    )
    restart_s: float = Field(0.57, ge=0, le=60, description="time until a dead node is back (s)")
    times: int = Field(1, ge=1, le=MOST_CALLS, description="changed calls, from the drawn one on")
    when: When = Field(
        "uniform",
        description="calls that are drawn from: all; or, as by the authors' injector of registers, those from the "
        "planner's second plan on; no site if the golden flight has none",
    )

    @model_validator(mode="before")
    @classmethod
    def _without_scheme(cls, data: Any, info: ValidationInfo) -> Any:
        """Ledgers store `_STORED_SCHEME`, which users may no longer write."""
        if info.context != STORED or not isinstance(data, dict) or data.get("scheme") != _STORED_SCHEME:
            return data
        return {key: value for key, value in data.items() if key != "scheme"}

    @model_validator(mode="after")
    def _consistent(self) -> "InstructionSampling":
        check_distinct("sampling.kernels", self.kernels)
        return self

    @property
    def instrumented(self) -> tuple[str, ...]:
        """See `Sampling.instrumented`."""
        return self.kernels

    def to_json(self) -> dict[str, Any]:
        """See `Sampling.to_json`."""
        data = super().to_json()
        if self.when == "uniform":
            del data["when"]
        if self.times == 1:
            del data["times"]
        return data

    def identity(self) -> dict[str, Any]:
        """See `Sampling.identity`."""
        return self.to_json() | {"scheme": _STORED_SCHEME}


class InstructionSampler(Sampler):
    """Draws one result of one dynamic instruction; the seed draws the kernels of a stage's faults.

    Raises:
        BadInputError: Arms and kernels are incompatible.
    """

    instruments = True

    def __init__(self, campaign: SampledCampaign) -> None:
        super().__init__(campaign)
        # Numba compiles Python's bytecode, which determines the fault space.
        self.versions = {"python": ".".join(platform.python_version_tuple()[:2]), "fault space": DIGEST_VERSION}
        planner = planner_name(campaign.first_mission.planner)
        drawn_from = campaign_targets(campaign)
        self._kernels = kernels = [target.name for target in drawn_from]
        other_planners = [name for name in kernels if name in PLANNERS and name != planner]
        self.variants = {name: {"planner": name} for name in other_planners}
        if campaign.arms and other_planners:
            raise BadInputError(
                f"sampling.kernels: {other_planners[0]!r}: detectors are trained with one planner; allowed with arms: "
                f"kernels of missions with planner {planner!r}"
            )
        # Where faults of a kernel are drawn, if not in the campaign's own mission.
        self._detectors = {target.name: target.arm for target in drawn_from if target.arm}
        self.arms = self._detectors | {name: name for name in other_planners}
        self.targets = {}
        self.orders = {}
        for group in _groups(drawn_from, self.sampling.share):
            first = group[0]
            self.targets[first.name] = dict.fromkeys((target.name for target in group), 1.0)
            self.orders[first.name] = first.stage or first.name
        replaceable = {"planner": planner, "map": "octomap", "pid": "pid"}
        replaceable |= {target.role: target.name for target in drawn_from if target.role and not target.arm}
        _check_arms(campaign, kernels, replaceable)
        if campaign.nulls:
            raise BadInputError(f"null_runs: {campaign.nulls}; allowed: 0 with faults in instructions")

    def numbered(self, target: str, index: int, seed: int, stratum: str) -> Draw:
        """See `Sampler.numbered`; what is drawn in a stage is the kernel."""
        return Draw(stratum, index, seed, self.arms.get(stratum, ""))

    def golden(
        self, arm: str, draws: Sequence[Draw], environment: str, flights: "MissionFlights", setup: "ArmSetup"
    ) -> Sampled:
        """Fly the golden run with instruction counters, and draw its faults."""
        # Kernels whose instructions are counted in this flight.
        targets = [draw.target for draw in draws]
        counted_arms = {arm}
        if arm in self._detectors.values():
            counted_arms.add("")  # where a detector is counted, kernels are, too
        kernels = [name for name in self._kernels if self.arms.get(name, "") in counted_arms]
        if not kernels:
            return Sampled(flights.golden(arm))
        from mavfi.flight.mission_flights import LocalFlights

        # Draw as many faults in each kernel as were requested; if another host has the flights, they are flown here.
        sampling = self.sampling
        scenario = setup.scenario
        local_flights = None
        if isinstance(flights, LocalFlights):
            local_flights = flights
        numbers = {name: targets.count(name) for name in kernels}
        request = InstructionRequest(
            numbers, sampling.which, sampling.model, sampling.restart_s, sampling.when, sampling.times
        )
        drawn = draw_instruction_faults(
            scenario,
            request,
            environment,
            seed=scenario.seed,
            recovery=setup.recovery,
            detector=setup.detector(),
            flights=local_flights,
            arm=arm,
        )
        # The first flight of the draw is the golden run of this arm: it need not be flown again.
        flights.register_golden(arm, drawn.golden)
        return Sampled(drawn.golden, drawn.counts, {(name, ""): faults for name, faults in drawn.faults.items()})

    def null(self, index: int, seed: int, environment: str, golden: Golden) -> Fault:
        """Not supported at this level."""
        raise BadInputError("null runs: allowed with faults in states")


def _check_arms(campaign: SampledCampaign, drawn: Sequence[str], kernels: Mapping[str, str]) -> None:
    """Refuse an arm that replaces functions with drawn faults, which would never be activated there.

    `kernels`: the kernel whose functions change, by mission key.
    """
    for name, arm in campaign.arms.items():
        for key, kernel in kernels.items():
            campaign_value = getattr(campaign.first_mission, key)
            arm_value = getattr(campaign.spec(campaign.environments[0], campaign.first_seed, arm.mission), key)
            if arm_value != campaign_value and kernel in drawn:
                raise BadInputError(
                    f"arms: {name!r}: {key}: {arm_value!r}: does not call what faults in {kernel} are drawn from; "
                    f"allowed: {campaign_value!r}"
                )


class CampaignTarget(NamedTuple):
    """A kernel, plug-in or detector of which a campaign draws faults.

    Attributes:
        name: Its name in faults and tables.
        role: Kind of the plug-in, as in `states.PLUG_INS`; "" = of mavfi.
        arm: The arm whose detector it is; "" = it is none.
    """

    name: str
    role: str = ""
    arm: str = ""

    @property
    def stage(self) -> str:
        """Its stage; "" = a detector."""
        return _stage_of(self.name, self.role)


def _stage_of(name: str, role: str) -> str:
    """The stage of a kernel or plug-in; "" = a detector."""
    if role:
        return PLUG_INS[role].stage
    return str(KERNEL_STAGES.get(name, ""))


def campaign_targets(campaign: SampledCampaign) -> list[CampaignTarget]:
    """The targets that the sampling of a campaign names.

    Raises:
        BadInputError: Its missions and arms have no such target, or it is named twice.
    """
    targets = [_campaign_target(campaign, name) for name in campaign.sampling.kernels]
    for name, count in Counter(target.name for target in targets).items():
        if count > 1:
            raise BadInputError(f"sampling.kernels: {name!r}: named {count} times; allowed: once")
    return targets


def _campaign_target(campaign: SampledCampaign, name: str) -> CampaignTarget:
    """See `campaign_targets`: the target of this name."""
    spec = campaign.first_mission
    planner = planner_name(spec.planner)
    members = plug_ins_of_spec(spec)
    replaced = [PLUG_INS[plug_in.role].kernel for plug_in in members]
    of_mavfi = [kernel for kernel in INJECTABLE if kernel not in replaced]

    # Kernels and detectors of mavfi, then plug-ins of all missions, then detectors of an arm that are plug-ins.
    if name in of_mavfi:
        return CampaignTarget(name)
    if name in DETECTORS:
        return CampaignTarget(name, arm=campaign.arm_with(name))
    for plug_in in members:
        if plug_in.is_called(name):
            return CampaignTarget(plug_in.name, plug_in.role)
    if name == "planner":
        return CampaignTarget(planner)
    detectors = campaign.custom_detectors
    watching = [(arm, plug_in) for arm, plug_in in detectors.items() if plug_in.is_called(name)]
    if len(watching) > 1:
        raise BadInputError(f"sampling.kernels: {name!r}: is in {len(watching)} arms; allowed: what is in one arm")
    if watching:
        ((arm, plug_in),) = watching
        return CampaignTarget(plug_in.name, plug_in.role, arm)

    refusal = dropped_name("kernels", name)
    if not refusal:
        names = [*of_mavfi, *(plug_in.name for plug_in in (*members, *detectors.values()))]
        refusal = unknown("kernel", name, dict.fromkeys(names))
    raise BadInputError(f"sampling.kernels: {refusal}")


def _groups(targets: Sequence[CampaignTarget], share: str) -> list[list[CampaignTarget]]:
    """Targets that share one number of faults: each separately, or the kernels of each stage, and each detector."""
    if share == "kernel":
        return [[target] for target in targets]
    stages = [[target for target in targets if target.stage == stage] for stage in PPC_STAGES]
    detectors = [[target] for target in targets if target.arm]
    return [group for group in (*stages, *detectors) if group]


def lower_bits(fault: InstructionFault, _: Injection | None) -> Iterator[Fault]:
    """Faults in less significant bits."""
    return (replace(fault, bits=(bit,), stratum="") for bit in range(fault.bit or 0))


def single_bit_faults(fault: InstructionFault, _: Injection | None) -> Iterator[Fault]:
    """Single-bit faults for a multi-bit one."""
    if len(fault.bits) > 1:
        yield from (replace(fault, bits=(bit,)) for bit in sorted(fault.bits))


class InstructionLevel(Level):
    """Faults in instructions of compiled functions; flights of the host `local` fork at the injected call."""

    fault = InstructionFault
    sampling = InstructionSampling
    sampler = InstructionSampler
    local = True
    form = "instruction:KERNEL[:which=CLASS][:model=MODEL][:times=N], or one instruction as printed by mavfi shrink"
    options = {"which": (".+", "a class of instructions", str), "model": (r"\w+", "a model", str), "times": WHOLE}
    reductions = {"width": single_bit_faults, "bit": lower_bits}
    absent = ("executed", "the instruction was not executed")

    def parse(self, text: str, localization: str) -> InstructionRequest | InstructionSite:
        """See `Level.parse`."""
        instruction = _ONE_INSTRUCTION.fullmatch(text)
        if instruction is not None:
            return InstructionSite(_fault_in(instruction))
        text = without_module(text)
        kernel = text.partition(":")[0]
        if not re.fullmatch(r"[\w-]+", kernel):
            self.not_understood()
        parts = self.parts_of(text)
        if parts.time_us is not None:
            self.not_understood()
        which = parts.options.get("which", "all")
        parse_selection(which)
        times = parts.options.get("times", 1)
        InstructionFault("", "", 0, kernel=kernel, times=times)  # checks the number
        return InstructionRequest({kernel: 1}, which, _model(parts.options.get("model")), times=times)

    def shipped_site(self, request: InstructionRequest | InstructionSite) -> bool:
        """See `Level.shipped_site`."""
        return isinstance(request, InstructionSite) or not set(request.kernels) - {*INJECTABLE, *DETECTORS}

    def text_of(self, fault: InstructionFault) -> str | None:
        """See `Level.text_of`."""
        if not fault.kernel:
            return None
        value = f"value={fault.value:#x}"
        if fault.bits:
            value = f"bit={'+'.join(map(str, fault.bits))}"
        model = ""
        if fault.model != "one_bit":
            model = f":model={fault.model}"
        restart = ""
        if fault.restart_s != RESTART_S:
            restart = f":restart={fault.restart_s}"
        times = ""
        if fault.times != 1:
            times = f":times={fault.times}"
        return (
            f"instruction:{fault.kernel}.{fault.entry}:call={fault.call}:index={fault.index}:{value}{model}{restart}{times}"
            f":budget={fault.budget}:ir={fault.ir_sha256}"
        )

    def columns(self, fault: InstructionFault) -> dict[str, Any]:
        """See `Level.columns`."""
        return {
            "stage": _stage_of(fault.kernel, fault.role),
            "kernel": fault.kernel,
            "function": fault.entry,
            "value_class": fault.value_class,
        }

    def about(self, campaign: SampledCampaign) -> dict[str, Any]:
        """See `Level.about`."""
        sampling = campaign.sampling
        how = f"instructions: {sampling.which}, model {sampling.model}"
        if sampling.when != "uniform":
            how += f", calls: {sampling.when}"
        targets = campaign_targets(campaign)
        return {
            "each": sampling.share,
            "how": how,
            "kernels": [target.name for target in targets],
            "stages": list(dict.fromkeys(target.stage for target in targets)),
            "which": sampling.which,
        }


def _fault_in(match: re.Match[str]) -> InstructionFault:
    """The fault that a text names in full."""
    bits: tuple[int, ...] = ()
    if match["bits"]:
        bits = tuple(map(int, match["bits"].split("+")))
    return InstructionFault(
        "",
        match["ir"],
        int(match["index"]),
        int(match["call"]),
        bits,
        int(match["value"] or "0", 16),
        int(match["budget"]),
        model=_model(match["model"]),
        kernel=match["kernel"],
        entry=match["entry"],
        restart_s=float(match["restart"] or RESTART_S),
        times=int(match["times"] or 1),
    )


def _model(name: str | None) -> Any:
    """A fault model; by default, one bit."""
    if name is not None and name not in MODELS:
        raise BadInputError(f"model {not_known(name, MODELS)}")
    return name or "one_bit"
