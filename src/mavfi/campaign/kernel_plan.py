"""The law `kernels`: which kernels a golden run counts, and the runs with the faults that it drew.

Fault i of a kernel, or of a stage whose kernels share its faults, strikes in mission i modulo the number of missions,
flown with that kernel's planner.  The golden run of a mission, without a detector, counts its kernels' instructions and
draws; so its record holds the faults.  Detectors' arms fly the same faults: same call, same instruction, same bit.
"""

from collections.abc import Iterable, Mapping
from typing import Any

from mavfi.campaign.config import PLANNER_KERNELS, Campaign
from mavfi.campaign.plan import (
    FI,
    PHASE_INJECTED,
    Arm,
    RunSpec,
    injected_setting,
    kernel_groups,
    scenario_name,
    share_out,
)
from mavfi.faults.fault import Fault
from mavfi.states import KERNEL_STAGES

DRAWN = "drawn"
"""Where a golden run's record holds the faults, by kernel."""


def arm_of(kernel: str, campaign: Campaign) -> str:
    """Name of the arm that flies with a kernel."""
    return kernel if kernel in PLANNER_KERNELS and kernel != campaign.planner else ""


def strikes(campaign: Campaign, environment: str) -> list[tuple[str, int]]:
    """Kernel and number of every fault of an environment, in the order of the plan.

    Where a stage's kernels share its faults, each has as many as the others (give or take one), and the seed draws
    which number falls to which kernel: so no kernel is struck in every third mission only.

    Args:
        campaign: The campaign.
        environment: Name.
    """
    if campaign.kernels is None:
        return []
    found = []
    for own in kernel_groups(campaign.kernels):
        stage = KERNEL_STAGES[own[0]].value
        kernels = share_out(dict.fromkeys(own, 1.0), campaign.faults, campaign.first_seed, environment, stage)
        found += [(kernel, index) for index, kernel in enumerate(kernels)]
    return found


def kernels_of(spec: RunSpec, campaign: Campaign) -> dict[str, int]:
    """How many faults a golden run draws in which kernels."""
    if campaign.kernels is None or spec.detector:
        return {}
    own = [kernel for kernel, index in strikes(campaign, spec.environment) if _in_mission(index, spec.seed, campaign)]
    return {name: own.count(name) for name in campaign.kernels.names if arm_of(name, campaign) == spec.arm}


def _in_mission(index: int, seed: int, campaign: Campaign) -> bool:
    return index % campaign.flights == seed - campaign.first_seed


def plan_kernel_world(
    campaign: Campaign, scenarios: Mapping[str, str], arms: Iterable[Arm], world: tuple[str, int],
    golden: Iterable[dict[str, Any]],
) -> dict[int, RunSpec]:  # fmt: skip
    """Runs with the faults of one mission, by place in the phase.

    Args:
        campaign: The campaign.
        scenarios: Key of the scenario by its name in the ledger.
        arms: See `plan.arms_of`; every detector's arm flies every fault.
        world: Environment and seed.
        golden: Records of the golden runs; one that ended badly has drawn nothing.
    """
    environment, seed = world
    drawn = {kernel: iter(faults) for record in golden for kernel, faults in record.get(DRAWN, {}).items()}
    watching = [arm for arm in arms if arm.config is not None]
    order = strikes(campaign, environment)
    first = campaign.environments.index(environment) * len(order)
    planned = {}
    for place, (kernel, index) in enumerate(order):
        data = next(drawn.get(kernel, iter(())), None) if _in_mission(index, seed, campaign) else None
        if data is None:
            continue
        fault = Fault.from_json(data)
        own = Arm(arm_of(kernel, campaign))
        key = scenarios[scenario_name(environment, own.name, "")]
        for number, arm in enumerate([own, *watching]):
            setting = FI if arm is own else injected_setting(arm.name)
            planned[(first + place) * (1 + len(watching)) + number] = RunSpec(
                PHASE_INJECTED, setting, environment, seed, key, kernel, index, fault, **arm.fields()
            )
    return planned
