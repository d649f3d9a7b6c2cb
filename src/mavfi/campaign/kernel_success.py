"""Success of missions with a fault in an instruction, under each policy for kernels that die, by stage."""

from collections.abc import Callable, Sequence
from dataclasses import asdict
from typing import Any

from mavfi.campaign import paper
from mavfi.campaign.config import Campaign
from mavfi.campaign.flights import Row, group, is_golden, is_injected
from mavfi.campaign.plan import kernel_groups
from mavfi.campaign.statistics import clustered_rate, wilson
from mavfi.states import KERNEL_STAGES

RESTART, END = "restart", "end"
POLICIES: dict[str, Callable[[Row], bool]] = {
    RESTART: lambda row: row.success,
    END: lambda row: row.success_if_ended,
}
"""What becomes of a mission whose kernel crashes, hangs or raises: its node starts again, or the mission has failed."""
ALL = "all"


def success_by_policy(rows: list[Row]) -> list[dict[str, Any]]:
    """Rates over all faults of an environment and setting, and of each stage of them.

    Faults count alike, so where stages have equal numbers, and their kernels share them equally, the rate over all is
    the mean over stages, over kernels of a stage, and over missions.

    Args:
        rows: All runs of a campaign with faults in instructions.

    Returns:
        One entry per environment, stage ("all" first), setting and policy ("" for golden runs): rate with its interval,
        `died` (kernels that crashed, hung or raised), `not_hit`, `unknown` (runs that could not be judged and are left
        out) and the paper's figure, of all stages.
    """
    table = []
    for environment, part in group(rows, lambda row: row.spec.environment).items():
        for setting, own in group(part, lambda row: row.spec.setting).items():
            head = {"environment": environment, "setting": setting}
            if is_golden(own[0]):
                judged = [row for row in own if row.judged]
                rate = wilson(sum(row.success for row in judged), len(judged))
                beside = paper.SUCCESS.get(environment, {}).get(setting)
                counts = {"died": 0, "not_hit": 0, "unknown": len(own) - len(judged)}
                table.append({**head, "stage": ALL, "policy": "", **asdict(rate), **counts, "paper": beside})
            elif is_injected(own[0]):
                for stage, struck in {ALL: own, **group(own, lambda row: row.stage)}.items():
                    table += _entries({**head, "stage": stage}, struck)
    return table


def _entries(head: dict[str, str], own: Sequence[Row]) -> list[dict[str, Any]]:
    """Both policies of some runs."""
    judged = [row for row in own if row.judged]
    worlds = [row.world for row in judged]
    counts = {
        "died": sum("due_end" in row.record for row in judged),
        "not_hit": sum(row.site_fate != "hit" for row in judged),
        "unknown": len(own) - len(judged),
    }
    beside = paper.SUCCESS.get(head["environment"], {}).get(head["setting"]) if head["stage"] == ALL else None
    return [
        {**head, "policy": policy, **asdict(clustered_rate([test(row) for row in judged], worlds)), **counts,
         "paper": beside}
        for policy, test in POLICIES.items()
    ]  # fmt: skip


def stages_of(campaign: Campaign) -> dict[str, list[str]]:
    """Kernels that are struck, by stage, in the order of the table."""
    if campaign.kernels is None:
        return {}
    found: dict[str, list[str]] = {}
    for kernel in (name for row in kernel_groups(campaign.kernels) for name in row):
        found.setdefault(KERNEL_STAGES[kernel].value, []).append(kernel)
    return found
