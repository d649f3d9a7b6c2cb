"""The law `kernels`: which kernels a golden run counts, and the runs with the faults that it drew.

Fault i of a kernel strikes in mission i modulo the number of missions, flown with that kernel's planner.
The golden run of a mission counts its kernels' instructions and draws; so its record holds the faults.
"""

from collections.abc import Iterable, Mapping
from typing import Any

from mavfi.campaign.config import PLANNER_KERNELS, Campaign
from mavfi.campaign.plan import FI, PHASE_INJECTED, RunSpec
from mavfi.faults.fault import Fault

DRAWN = "drawn"
"""Where a golden run's record holds the faults, by kernel."""


def arm_of(kernel: str, campaign: Campaign) -> str:
    """Name of the arm that flies with a kernel."""
    return kernel if kernel in PLANNER_KERNELS and kernel != campaign.planner else ""


def kernels_of(spec: RunSpec, campaign: Campaign) -> dict[str, int]:
    """How many faults a golden run draws in which kernels."""
    if campaign.kernels is None:
        return {}
    number = len(range(spec.seed - campaign.first_seed, campaign.faults, campaign.flights))
    return {kernel: number for kernel in campaign.kernels.names if arm_of(kernel, campaign) == spec.arm}


def plan_kernel_world(
    campaign: Campaign, scenarios: Mapping[str, str], world: tuple[str, int], golden: Iterable[dict[str, Any]]
) -> dict[int, RunSpec]:
    """Runs with the faults of one mission, by place in the phase.

    Args:
        campaign: The campaign.
        scenarios: Key of the scenario by its name in the ledger.
        world: Environment and seed.
        golden: Records of the golden runs; one that ended badly has drawn nothing.
    """
    assert campaign.kernels is not None  # nothing else is planned here
    environment, seed = world
    drawn = {kernel: faults for record in golden for kernel, faults in record.get(DRAWN, {}).items()}
    names = campaign.kernels.names
    first = campaign.environments.index(environment) * campaign.faults * len(names)
    planned = {}
    for place, kernel in enumerate(names):
        arm = arm_of(kernel, campaign)
        key = scenarios[f"{environment}/{arm}" if arm else environment]
        indices = range(seed - campaign.first_seed, campaign.faults, campaign.flights)
        for index, data in zip(indices, drawn.get(kernel, ()), strict=False):
            fault = Fault.from_json(data)
            planned[first + place * campaign.faults + index] = RunSpec(
                PHASE_INJECTED, FI, environment, seed, key, kernel, index, fault, arm=arm
            )
    return planned
