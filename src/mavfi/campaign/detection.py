"""What detectors do: false alarms on golden flights, detection of faults, and what recomputing costs."""

from collections import Counter
from dataclasses import asdict
from typing import Any

from mavfi.campaign import paper
from mavfi.campaign.flights import Row, group, is_golden, is_injected
from mavfi.campaign.statistics import clustered_rate, event_rate_by_flight
from mavfi.states import PPC_STAGES

SYSTEMATIC = 0.9
"""Share of flights from which alarms of one state at one instant are systematic: of the start, not of the mission."""


def false_alarms(rows: list[Row]) -> list[dict[str, Any]]:
    """Alarms of each arm on golden flights, per flight hour, by environment and over all ("all")."""
    table = []
    golden = [row for row in rows if is_golden(row) and row.spec.arm and "flight_time_s" in row.record]
    for setting, part in group(golden, lambda row: row.spec.setting).items():
        groups = group(part, lambda row: row.spec.environment)
        for environment, own in {**groups, "all": part}.items():
            kinds: Counter[str] = Counter()
            for row in own:
                kinds.update(row.record["alarm_counts"])
            rate = event_rate_by_flight(
                [row.record["alarms_total"] for row in own], [row.record["flight_time_s"] / 3600 for row in own]
            )
            table.append(
                {
                    "environment": environment,
                    "setting": setting,
                    "flights": len(own),
                    "flights_with_alarm": sum(row.record["alarms_total"] > 0 for row in own),
                    **asdict(rate),
                    "kinds": dict(kinds),
                    "systematic": _systematic(own),
                }
            )
    return table


def _systematic(rows: list[Row]) -> list[dict[str, Any]]:
    """Alarms that more than `SYSTEMATIC` of the flights have, and so not by chance; none where there is one flight."""
    flights: Counter[tuple[str, int]] = Counter()
    for row in rows:
        flights.update({(alarm["state"], round(1e6 * alarm["time_s"])) for alarm in row.record["alarms"]})
    return [
        {"state": state, "time_s": 1e-6 * time_us, "flights": count}
        for (state, time_us), count in sorted(flights.items())
        if len(rows) > 1 and count > SYSTEMATIC * len(rows)
    ]


def detections(rows: list[Row], monitored_set: str) -> list[dict[str, Any]]:
    """Faults that hit, and alarms: by environment, arm, stratum, watched or not.

    Returns:
        Rate of faults with an alarm on the very publication that was struck (coupling inline: its latency is 0), and
        as `consequence` the rate of those with an alarm within `worker.AFTERMATH` that the golden twin has not.
    """
    table = []
    struck = [row for row in rows if is_injected(row) and row.spec.arm and row.site_fate == "hit" and row.judged]
    groups = group(
        struck, lambda row: (row.spec.environment, row.spec.setting, row.population, row.watched(monitored_set))
    )
    for (environment, setting, stratum, watched), own in groups.items():
        worlds = [row.world for row in own]
        table.append(
            {
                "environment": environment,
                "setting": setting,
                "population": stratum,
                "monitored": watched,
                **asdict(clustered_rate([row.alarmed for row in own], worlds)),
                "consequence": asdict(clustered_rate([row.consequence_alarmed for row in own], worlds)),
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
