"""What detectors do: false alarms on golden flights, detection of faults, and what recomputing costs."""

from collections import Counter
from dataclasses import asdict
from typing import Any

import numpy as np

from mavfi.campaign import paper
from mavfi.campaign.flights import Row, group, is_golden, is_injected
from mavfi.campaign.statistics import event_rate, wilson
from mavfi.states import PPC_STAGES

PROMPT = 1.0
"""An alarm counts as a detection of the fault up to this time after it (s)."""


def false_alarms(rows: list[Row]) -> list[dict[str, Any]]:
    """Alarms of each arm on golden flights, per flight hour, by environment and over all ("all")."""
    table = []
    golden = [row for row in rows if is_golden(row) and row.spec.arm and "flight_time_s" in row.record]
    for setting, part in group(golden, lambda row: row.spec.setting).items():
        groups = group(part, lambda row: row.spec.environment)
        for environment, own in {**groups, "all": part}.items():
            hours = sum(row.record["flight_time_s"] for row in own) / 3600
            kinds: Counter[str] = Counter()
            for row in own:
                kinds.update(row.record["alarm_counts"])
            rate = event_rate(sum(row.record["alarms_total"] for row in own), hours)
            table.append(
                {
                    "environment": environment,
                    "setting": setting,
                    "flights": len(own),
                    "flights_with_alarm": sum(row.record["alarms_total"] > 0 for row in own),
                    **asdict(rate),
                    "kinds": dict(kinds),
                }
            )
    return table


def detections(rows: list[Row], monitored_set: str) -> list[dict[str, Any]]:
    """Faults that hit and were followed by an alarm within `PROMPT`: by environment, arm, stratum, watched or not."""
    table = []
    struck = [row for row in rows if is_injected(row) and row.spec.arm and row.site_fate == "hit" and row.judged]
    groups = group(
        struck, lambda row: (row.spec.environment, row.spec.setting, row.stratum, row.watched(monitored_set))
    )
    for (environment, setting, stratum, watched), own in groups.items():
        latencies = [row.record.get("alarm_latency_s") for row in own]
        prompt = [latency for latency in latencies if latency is not None and latency <= PROMPT]
        table.append(
            {
                "environment": environment,
                "setting": setting,
                "population": stratum,
                "monitored": watched,
                **asdict(wilson(len(prompt), len(own))),
                "median_latency_s": float(np.median(prompt)) if prompt else None,
            }
        )
    return table


def overheads(rows: list[Row]) -> list[dict[str, Any]]:
    """Recomputation time / compute time of the pipeline, both in the platform's modelled time, by stage.

    Detection itself costs no modelled time; its measured cost belongs beside a measured pipeline, not here.
    """
    table = []
    watched = [row for row in rows if row.spec.arm and "meta" in row.record]
    for (environment, setting), own in group(watched, lambda r: (r.spec.environment, r.spec.setting)).items():
        spent: Counter[str] = Counter()
        for row in own:
            spent.update(row.record["meta"]["recompute_us"])
        # kernels charge each of their steps, recomputations included
        compute = sum(sum(row.record["meta"]["compute_us"].values()) for row in own) - sum(spent.values())
        stages = {str(stage): spent[stage] / compute if compute else None for stage in PPC_STAGES}
        table.append(
            {
                "environment": environment,
                "setting": setting,
                "flights": len(own),
                "compute_s": compute * 1e-6,
                "recompute": stages,
                "total": sum(spent.values()) / compute if compute else None,
                "paper": paper.RECOMPUTE_OVERHEAD.get(environment, {}).get(setting),
            }
        )
    return table
