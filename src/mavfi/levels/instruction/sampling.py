"""Faults in instructions of a campaign.

They are distributed equally over kernels, or over stages and their kernels.  Faults in a planner other than the
campaign's are drawn in separate missions with that planner.  Faults in a detector are drawn from the golden run of its
arm, which counts kernels, recomputations included, and detector, and are injected in that arm alone.
"""

import platform
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar, Literal, NamedTuple

from pydantic import Field, ValidationInfo, model_validator

from mavfi.config import STORED
from mavfi.dropped import dropped_name
from mavfi.errors import BadInputError
from mavfi.faults.fault import Fault
from mavfi.faults.plug_ins import planner_name, plug_ins_of_spec
from mavfi.ir.module import DIGEST_VERSION
from mavfi.levels.campaign import SampledCampaign
from mavfi.levels.instruction.drawing import InstructionRequest, When, draw_instruction_faults
from mavfi.levels.instruction.fault import MOST_CALLS, Model
from mavfi.levels.level import Draw, Golden, Sampled, Sampler, Sampling, check_distinct
from mavfi.states import DETECTORS, INJECTABLE, KERNEL_STAGES, PLANNERS, PLUG_INS, PPC_STAGES, unknown

if TYPE_CHECKING:
    from mavfi.flight.host import ArmSetup, MissionFlights

_STORED_SCHEME = "uniform"
"""Value of the key `scheme` in the identities of ledgers; there was another one once."""


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
        return stage_of(self.name, self.role)


def stage_of(name: str, role: str) -> str:
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
