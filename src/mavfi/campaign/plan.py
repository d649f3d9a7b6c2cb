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

from mavfi.campaign.config import Campaign, DetectorArm
from mavfi.faults.fault import Fault
from mavfi.faults.sampling import Target, draw, group_target, stage_target, stream
from mavfi.faults.strata import HEADLINE
from mavfi.flight_log import Profile
from mavfi.states import PPC_STAGES

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
    def golden_setting(self) -> str:
        """Setting of the golden twin: the same detector watches, and nothing strikes."""
        return golden_setting(self.arm)

    def to_json(self) -> dict[str, Any]:
        """Plain data."""
        return asdict(self)

    @staticmethod
    def from_json(data: dict[str, Any]) -> "RunSpec":
        """Inverse of `to_json`."""
        fault = data["fault"]
        return RunSpec(**{**data, "fault": None if fault is None else Fault.from_json(fault)})


@dataclass(frozen=True, slots=True)
class Arm:
    """A detector's arm, with the hash of the model that it flies with; the arm without a detector has no name."""

    name: str = ""
    config: DetectorArm | None = None
    model: str = ""

    def fields(self) -> dict[str, Any]:
        """Its part of a `RunSpec`."""
        if self.config is None:
            return {}
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
    return [Arm(), *(Arm(name, arm, models.get(name, "")) for name, arm in campaign.detectors.items())]


def plan_golden(campaign: Campaign, scenarios: Mapping[str, str], arms: list[Arm]) -> list[RunSpec]:
    """Phase 1: every mission without a fault, without a detector and with each.

    Args:
        campaign: The campaign.
        scenarios: Key of the scenario (with the campaign's first seed) by environment.
        arms: See `arms_of`.
    """
    return [
        RunSpec(PHASE_GOLDEN, golden_setting(arm.name), environment, seed, scenarios[environment], **arm.fields())
        for environment in campaign.environments
        for seed in campaign.seeds
        for arm in arms
    ]


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
    runs = []
    for environment in campaign.environments:
        key = scenarios[environment]
        for target, index, seed, fault in _faults(campaign, environment, profiles):
            runs += [
                RunSpec(
                    PHASE_INJECTED, injected_setting(arm.name), environment, seed, key, target, index, fault,
                    **arm.fields(),
                )
                for arm in arms
            ]  # fmt: skip
        for index, seed, fault in _null_faults(campaign, environment, profiles):
            arm = arms[index % len(arms)]
            setting = null_setting(arm.name)
            runs.append(RunSpec(PHASE_INJECTED, setting, environment, seed, key, NULL, index, fault, **arm.fields()))
    return runs


def count_runs(campaign: Campaign) -> int:
    """How many runs the campaign has, known before any of them."""
    arms = 1 + len(campaign.detectors)
    faults = campaign.faults * len(_targets(campaign))
    return len(campaign.environments) * (arms * (campaign.flights + faults) + campaign.null_runs)


def _targets(campaign: Campaign) -> list[tuple[Target, dict[str, float]]]:
    if campaign.law == "groups":
        return [(group_target(g.name, g.sites), g.strata or campaign.strata) for g in campaign.groups]
    monitored = campaign.monitored_set if campaign.sites == "monitored" else None
    return [(stage_target(stage, campaign.stack, monitored), campaign.strata) for stage in PPC_STAGES]


def _faults(
    campaign: Campaign, environment: str, profiles: Mapping[tuple[str, int], Profile]
) -> Iterator[tuple[str, int, int, Fault]]:
    for target, shares in _targets(campaign):
        strata = share_out(shares, campaign.faults, campaign.first_seed, environment, target.name)
        for index, stratum in enumerate(strata):
            seed = campaign.first_seed + index % campaign.flights
            profile = profiles.get((environment, seed), Profile())
            fault = draw(target, stratum, profile, seed, environment, index // campaign.flights)
            yield target.name, index, seed, fault


def _null_faults(
    campaign: Campaign, environment: str, profiles: Mapping[tuple[str, int], Profile]
) -> Iterator[tuple[int, int, Fault]]:
    for index in range(campaign.null_runs):
        seed = campaign.first_seed + index % campaign.flights
        target = stage_target(PPC_STAGES[index % len(PPC_STAGES)], campaign.stack)
        profile = profiles.get((environment, seed), Profile())
        fault = draw(target, HEADLINE, profile, seed, environment, index)
        yield index, seed, replace(fault, bit=None, stratum="", weight=1.0)


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
