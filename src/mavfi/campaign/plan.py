"""Campaign -> list of `RunSpec`: every seed and every fault is fixed before the first injected flight.

Settings are the paper's, made general for any number of detectors ("arms"): `golden`, `fi`, and for each arm
`golden_<arm>` and `dr_<arm>`.  `null` and `null_<arm>` fly the whole path through the injector with an empty mask.
Fault i of a target strikes in the same world, at the same site, in `fi` and in every `dr_<arm>`.
"""

import hashlib
import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any

from mavfi.campaign.config import PLANNER_KERNELS, Campaign, DetectorArm, KernelFaults
from mavfi.faults.fault import Fault
from mavfi.faults.sampling import Target, draw, group_target, stage_target, stream
from mavfi.faults.strata import HEADLINE
from mavfi.flight_log import Profile
from mavfi.states import KERNEL_STAGES, PPC_STAGES

GOLDEN, FI, NULL, RECOVERY = "golden", "fi", "null", "dr"
PHASE_GOLDEN, PHASE_INJECTED = 1, 2


@dataclass(frozen=True, slots=True)
class RunSpec:
    """One run: with its scenario, all that decides every byte of its record.

    Attributes:
        phase: 1 = golden runs; 2 = runs with a fault, drawn from the profiles of phase 1.
        setting: See the module's text.
        environment: Name.
        seed: Seed of the mission.
        scenario: Key of the scenario.
        target: Stage or group whose fault it is, "" for golden runs.
        index: Number of the fault within target and environment.
        fault: The fault.
        arm: Name of the detector's arm, "" for none.
        detector: What the arm flies with.
        profile: Profile of the detector.
        model: sha256 of the trained model.
        run_id: Readable, and unique by a hash of all of the above.
    """

    phase: int
    setting: str
    environment: str
    seed: int
    scenario: str
    target: str = ""
    index: int = 0
    fault: Fault | None = None
    arm: str = ""
    detector: str = ""
    profile: str = ""
    model: str = ""
    run_id: str = field(default="", compare=False)

    def __post_init__(self) -> None:
        content = json.dumps({**self.to_json(), "run_id": ""}, sort_keys=True)
        parts = [self.environment, str(self.seed), self.setting]
        if self.target:
            parts += [self.target, str(self.index)]
        readable = "-".join(re.sub(r"[^A-Za-z0-9_.]+", "_", part) for part in parts)
        object.__setattr__(self, "run_id", f"{readable}-{hashlib.sha256(content.encode()).hexdigest()[:8]}")

    @property
    def scenario_name(self) -> str:
        """Under which name the ledger has the scenario."""
        return scenario_name(self.environment, self.arm, self.detector)

    @property
    def golden_setting(self) -> str:
        """Setting of the golden twin: the same detector watches, and nothing strikes."""
        return golden_setting(self.arm)

    def to_json(self) -> dict[str, Any]:
        """Plain data."""
        return asdict(self) | {"fault": None if self.fault is None else self.fault.to_json()}

    @staticmethod
    def from_json(data: dict[str, Any]) -> "RunSpec":
        """Inverse of `to_json`."""
        fault = data["fault"]
        return RunSpec(**{**data, "fault": None if fault is None else Fault.from_json(fault)})


@dataclass(frozen=True, slots=True)
class Arm:
    """A detector's arm, with the hash of the model that it flies with; the arm without a detector has no name.

    Where kernels are struck, an arm is a planner other than the campaign's, and carries its name.
    """

    name: str = ""
    config: DetectorArm | None = None
    model: str = ""

    def fields(self) -> dict[str, Any]:
        """Its part of a `RunSpec`."""
        if self.config is None:
            return {"arm": self.name} if self.name else {}
        return {
            "arm": self.name,
            "detector": self.config.detector,
            "profile": self.config.profile,
            "model": self.model,
        }


def golden_setting(arm: str) -> str:
    """Setting of the error-free flights with a detector's arm ("" = without)."""
    return f"{GOLDEN}_{arm}" if arm else GOLDEN


def injected_setting(arm: str) -> str:
    """Setting of the flights with a fault, with a detector's arm ("" = without)."""
    return f"{RECOVERY}_{arm}" if arm else FI


def null_setting(arm: str) -> str:
    """Setting of the flights with an empty mask."""
    return f"{NULL}_{arm}" if arm else NULL


def arms_of(campaign: Campaign, models: Mapping[str, str]) -> list[Arm]:
    """The arm without a detector, and the campaign's.

    Args:
        campaign: The campaign.
        models: sha256 of the model by the name of the arm; detectors without a model are not in it.
    """
    detectors = [Arm(name, arm, models.get(name, "")) for name, arm in campaign.detectors.items()]
    return [Arm(), *(Arm(planner) for planner in other_planners(campaign)), *detectors]


def other_planners(campaign: Campaign) -> list[str]:
    """Planners whose kernels are struck, beside the one that the campaign flies with."""
    names = () if campaign.kernels is None else campaign.kernels.names
    return [name for name in names if name in PLANNER_KERNELS and name != campaign.planner]


def scenario_name(environment: str, arm: str, detector: str) -> str:
    """Under which name the ledger has the scenario of a run: the environment's, with a planner not the campaign's."""
    return f"{environment}/{arm}" if arm and not detector else environment


def plan_golden(campaign: Campaign, scenarios: Mapping[str, str], arms: list[Arm]) -> list[RunSpec]:
    """Phase 1: every mission without a fault, without a detector and with each.

    Args:
        campaign: The campaign.
        scenarios: Key of the scenario (with the campaign's first seed) by environment.
        arms: See `arms_of`.
    """
    return [
        RunSpec(
            PHASE_GOLDEN, golden_setting(arm.name), environment, seed,
            scenarios[scenario_name(environment, arm.name, "" if arm.config is None else arm.config.detector)],
            **arm.fields(),
        )
        for environment in campaign.environments
        for seed in campaign.seeds
        for arm in arms
    ]  # fmt: skip


def plan_injected(
    campaign: Campaign,
    scenarios: Mapping[str, str],
    arms: list[Arm],
    profiles: Mapping[tuple[str, int], Profile],
) -> list[RunSpec]:
    """Phase 2: all faults, drawn from the golden profiles, and null runs.

    Args:
        campaign: The campaign.
        scenarios: As in `plan_golden`.
        arms: See `arms_of`.
        profiles: By environment and seed; a mission that left none has no site.
    """
    return [
        spec
        for environment in campaign.environments
        for _, spec in _injected(campaign, environment, scenarios[environment], arms, profiles, campaign.seeds)
    ]


def plan_world(
    campaign: Campaign, scenarios: Mapping[str, str], arms: list[Arm], world: tuple[str, int], profile: Profile | None
) -> dict[int, RunSpec]:
    """Phase 2 of one mission, by place in `plan_injected`: its faults depend on no other mission.

    Args:
        campaign: The campaign.
        scenarios: As in `plan_golden`.
        arms: See `arms_of`.
        world: Environment and seed.
        profile: Of its golden flight, if that left one.
    """
    environment, seed = world
    before = campaign.environments.index(environment) * _injected_runs(campaign)
    profiles = {} if profile is None else {world: profile}
    runs = _injected(campaign, environment, scenarios[environment], arms, profiles, range(seed, seed + 1))
    return {before + place: spec for place, spec in runs}


def _injected(
    campaign: Campaign, environment: str, key: str, arms: list[Arm], profiles: Mapping[tuple[str, int], Profile],
    seeds: range,
) -> Iterator[tuple[int, RunSpec]]:  # fmt: skip
    """Place among the environment's runs, and run, of the missions with these seeds."""
    place = 0
    for target, index, seed, stratum in _draws(campaign, environment):
        if seed in seeds:
            profile = profiles.get((environment, seed), Profile())
            fault = draw(target, stratum, profile, seed, environment, index // campaign.flights)
            for number, arm in enumerate(arms):
                setting = injected_setting(arm.name)
                yield (
                    place + number,
                    RunSpec(PHASE_INJECTED, setting, environment, seed, key, target.name, index, fault, **arm.fields()),
                )
        place += len(arms)
    for index in range(campaign.null_runs):
        seed = campaign.first_seed + index % campaign.flights
        if seed in seeds:
            arm = arms[index % len(arms)]
            fault = _null_fault(campaign, environment, index, seed, profiles.get((environment, seed), Profile()))
            setting = null_setting(arm.name)
            yield (
                place + index,
                RunSpec(PHASE_INJECTED, setting, environment, seed, key, NULL, index, fault, **arm.fields()),
            )


def is_null(spec: RunSpec) -> bool:
    """Whether a run flies through the injector with an empty mask."""
    return spec.target == NULL


def _injected_runs(campaign: Campaign) -> int:
    """Runs of phase 2 in each environment."""
    rows = len(_targets(campaign) if campaign.kernels is None else kernel_groups(campaign.kernels))
    return (1 + len(campaign.detectors)) * campaign.faults * rows + campaign.null_runs


def kernel_groups(kernels: KernelFaults) -> list[tuple[str, ...]]:
    """Kernels that share one number of faults: each alone, or those of each stage."""
    if kernels.share == "kernel":
        return [(name,) for name in kernels.names]
    stages = [tuple(name for name in kernels.names if KERNEL_STAGES[name] is stage) for stage in PPC_STAGES]
    return [row for row in stages if row]


def count_runs(campaign: Campaign) -> int:
    """How many runs the campaign has, known before any of them."""
    golden = (1 + len(campaign.detectors) + len(other_planners(campaign))) * campaign.flights
    return len(campaign.environments) * (golden + _injected_runs(campaign))


def _targets(campaign: Campaign) -> list[tuple[Target, dict[str, float]]]:
    if campaign.law == "groups":
        return [(group_target(g.name, g.sites), g.strata or campaign.strata) for g in campaign.groups]
    monitored = campaign.monitored_set if campaign.sites == "monitored" else None
    return [(stage_target(stage, campaign.stack, monitored), campaign.strata) for stage in PPC_STAGES]


def _draws(campaign: Campaign, environment: str) -> Iterator[tuple[Target, int, int, str]]:
    """What is drawn in an environment: target, number of the fault, seed of the mission, stratum."""
    for target, shares in _targets(campaign):
        strata = share_out(shares, campaign.faults, campaign.first_seed, environment, target.name)
        for index, stratum in enumerate(strata):
            yield target, index, campaign.first_seed + index % campaign.flights, stratum


def _null_fault(campaign: Campaign, environment: str, index: int, seed: int, profile: Profile) -> Fault:
    target = stage_target(PPC_STAGES[index % len(PPC_STAGES)], campaign.stack)
    fault = draw(target, HEADLINE, profile, seed, environment, index)
    return replace(fault, bit=None, stratum="", weight=1.0)


def share_out(shares: Mapping[str, float], count: int, seed: int, *address: str) -> list[str]:
    """Give each of `count` faults its stratum: exact shares (largest remainder), in an order that the seed draws.

    Args:
        shares: Share of each stratum; need not add up to 1.
        count: How many faults.
        seed: First seed of the campaign.
        address: Environment, and name of the target; each has an order of its own.
    """
    total = sum(shares.values())
    exact = {stratum: count * share / total for stratum, share in shares.items()}
    whole = {stratum: int(number) for stratum, number in exact.items()}
    by_remainder = sorted(exact, key=lambda stratum: whole[stratum] - exact[stratum])
    for stratum in by_remainder[: count - sum(whole.values())]:
        whole[stratum] += 1
    strata = [stratum for stratum, number in whole.items() for _ in range(number)]
    return [strata[place] for place in stream(seed, "strata", *address).permutation(count)]
