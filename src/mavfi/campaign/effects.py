"""What faults cost beside the mission: outcomes, flight time, energy; where they struck; how missions ended."""

from collections import Counter
from typing import Any

import numpy as np

from mavfi.campaign import paper
from mavfi.campaign.flights import Row, group, is_golden, is_injected, is_null, settings_of
from mavfi.campaign.plan import FI
from mavfi.campaign.statistics import wilson
from mavfi.campaign.store import Store
from mavfi.outcomes import Outcome
from mavfi.states import STATES

FATES = ("hit", "no_site", "not_hit")


def outcomes(rows: list[Row]) -> list[dict[str, Any]]:
    """Masked, SDC, DUE and unknown, and the fate of the sites, by environment, setting and stage.

    `sdc_alarmed` counts those of the SDC that had an alarm on the struck publication.
    """
    table = []
    injected = [row for row in rows if is_injected(row)]
    for key, own in group(injected, lambda row: (row.spec.environment, row.spec.setting, row.stage)).items():
        verdicts = Counter(row.outcome.label for row in own)
        fates = Counter(row.site_fate for row in own)
        table.append(
            {
                "environment": key[0],
                "setting": key[1],
                "stage": key[2],
                "n": len(own),
                **{outcome.label: verdicts[outcome.label] for outcome in Outcome},
                "sdc_alarmed": sum(row.outcome is Outcome.SDC and row.alarmed for row in own),
                **{fate: fates[fate] for fate in FATES},
            }
        )
    return table


def endings(rows: list[Row]) -> list[dict[str, Any]]:
    """How missions ended: number of runs by status, by environment and setting."""
    groups = group((row for row in rows if not is_null(row)), lambda row: (row.spec.environment, row.spec.setting))
    return [
        {
            "environment": environment,
            "setting": setting,
            "n": len(own),
            "statuses": dict(Counter(r.status for r in own)),
        }
        for (environment, setting), own in groups.items()
    ]


def flight_times(rows: list[Row]) -> list[dict[str, Any]]:
    """Flight time and energy against the golden twin, on pairs that succeed in every setting.

    Returns:
        One entry per environment and setting: `pairs`, quantiles and worst case of the inflation (0.1 = 10 % more than
        the golden run of the same world), the same of the energy, `failing` (share of missions, the rest of the story),
        and `inflations`, sorted, of all successes, with `censored` failures, for a distribution function.
    """
    table = []
    injected = [row for row in rows if is_injected(row) and row.judged]
    for environment, part in group(injected, lambda row: row.spec.environment).items():
        settings = settings_of(part)
        by_pair = group(part, lambda row: row.pair)
        complete = {
            pair
            for pair, own in by_pair.items()
            if len(own) == len(settings) and all(row.inflation is not None for row in own)
        }
        for setting in settings:
            own = [row for row in part if row.spec.setting == setting]
            table.append(_flight_time(environment, setting, own, [row for row in own if row.pair in complete]))
    return table


def _flight_time(environment: str, setting: str, own: list[Row], paired: list[Row]) -> dict[str, Any]:
    flown = sorted(row.inflation for row in own if row.inflation is not None)
    failing = [row for row in own if not row.success]
    worst = max(paired, key=lambda row: row.inflation or 0.0, default=None)
    return {
        "environment": environment,
        "setting": setting,
        "pairs": len(paired),
        "time": _quantiles([row.inflation for row in paired]),
        "energy": _quantiles([row.energy_inflation for row in paired]),
        "worst_run": None if worst is None else worst.spec.run_id,
        "failing": len(failing) / len(own) if own else None,
        "n": len(own),
        "time_limit_s": max((row.record.get("meta", {}).get("time_limit_s", 0.0) for row in own), default=None),
        "inflations": flown,
        "censored": len(failing),
        "paper_worst": _paper_worst(environment, setting),
    }


def _quantiles(values: list[float | None]) -> dict[str, float] | None:
    known = [value for value in values if value is not None]
    if not known:
        return None
    names = ("median", "p75", "p95", "worst")
    return dict(zip(names, (float(q) for q in np.quantile(known, (0.5, 0.75, 0.95, 1.0))), strict=True))


def _paper_worst(environment: str, setting: str) -> float | None:
    worst = paper.WORST_TIME_INCREASE.get(environment)
    if worst is None or setting == FI:
        return worst
    recovered = paper.WORST_TIME_RECOVERED[environment].get(setting)
    return None if recovered is None else worst - recovered


def golden_flights(rows: list[Row]) -> list[dict[str, Any]]:
    """Flight time, energy, distance and replans of the golden runs, medians of the successes."""
    table = []
    golden = [row for row in rows if is_golden(row) and row.success]
    for (environment, setting), own in group(golden, lambda r: (r.spec.environment, r.spec.setting)).items():
        keys = ("flight_time_s", "energy_j", "distance_m", "replans")
        medians = {key: float(np.median([row.record[key] for row in own])) for key in keys}
        table.append({"environment": environment, "setting": setting, "n": len(own), **medians})
    return table


def unmonitored_failures(rows: list[Row], monitored_set: str) -> list[dict[str, Any]]:
    """Of the missions that fail with a fault: the share of which struck a field that no detector watches."""
    failing = [row for row in rows if row.spec.setting == FI and row.judged and not row.success]
    table = []
    for environment, own in group(failing, lambda row: row.spec.environment).items():
        rate = wilson(sum(not row.watched(monitored_set) for row in own), len(own))
        table.append(
            {
                "environment": environment,
                "n": rate.n,
                "unmonitored": rate.successes,
                "rate": rate.rate,
                "low": rate.low,
                "high": rate.high,
            }
        )
    return table


def acted_on(rows: list[Row], store: Store) -> list[dict[str, Any]]:
    """Of the states on which consumers act now and then only: publications, and those acted upon."""
    published: Counter[tuple[str, str]] = Counter()
    struck: Counter[tuple[str, str]] = Counter()
    names = [name for name, spec in STATES.items() if spec.acted_on]
    profiles = store.profiles()
    for row in rows:
        if row.world in profiles and row.record is row.golden:
            for name in names:
                key = (row.spec.environment, name)
                published[key] += row.record.get("meta", {}).get("publications", {}).get(name, 0)
                struck[key] += len(profiles[row.world].times_us.get(name, ()))
    return [
        {"environment": environment, "state": name, "publications": count, "acted_on": struck[environment, name]}
        for (environment, name), count in published.items()
    ]


def null_check(rows: list[Row]) -> dict[str, Any]:
    """Runs with an empty mask must have the digest of their golden twins."""
    null = [row for row in rows if is_null(row)]
    differing = [row.spec.run_id for row in null if row.outcome is not Outcome.MASKED]
    return {"n": len(null), "differing": differing, "passed": not differing}
