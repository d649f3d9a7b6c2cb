"""How many missions succeed: rates by environment, stage, state, field and bits; recovery; paired tests."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict
from typing import Any

from mavfi.campaign import paper
from mavfi.campaign.flights import ALL_BITS, Row, group, is_golden, is_injected, settings_of
from mavfi.campaign.pairs import mcnemar, recovery
from mavfi.campaign.plan import FI, GOLDEN, RECOVERY
from mavfi.campaign.statistics import Rate, clustered_rate, smallest_difference, weighted_rate, wilson
from mavfi.faults.strata import HEADLINE

WHOLE_WORD = "whole_word"
PARTITIONS = ({"sign_exponent", "mantissa"}, {"sign", "exponent", "mantissa"})
"""Sets of strata that together make up whole words."""
SLOWER = 0.05
"""Flight time over the golden twin's from which a success counts as slower."""
_LEADING = (HEADLINE, ALL_BITS)
"""Populations that the success table leads with."""


def populations(rows: Iterable[Row], test: Callable[[Row], bool]) -> dict[str, Rate]:
    """Rate of a property by population: each bit stratum, and the whole word where the strata make one up.

    Args:
        rows: Runs with faults; those that could not be judged are left out.
        test: The property.

    Returns:
        Rate by the name of the stratum, or `WHOLE_WORD`.
    """
    judged = [row for row in rows if row.judged]
    by_stratum = group(judged, lambda row: row.population)
    rates = {
        name: clustered_rate([test(row) for row in part], [row.world for row in part])
        for name, part in by_stratum.items()
    }
    if set(by_stratum) in PARTITIONS:
        rates[WHOLE_WORD] = weighted_rate(
            [test(row) for row in judged],
            [row.weight for row in judged],
            [row.stratum for row in judged],
            [row.world for row in judged],
        )
    return rates


def success_by_environment(rows: list[Row]) -> list[dict[str, Any]]:
    """The success table: one entry per environment, setting and population ("all" for golden runs)."""
    table = []
    for environment, part in group(rows, lambda row: row.spec.environment).items():
        beside = paper.SUCCESS.get(environment, {})
        for setting, own in group(part, lambda row: row.spec.setting).items():
            if is_golden(own[0]):
                judged = [row for row in own if row.judged]
                rates = {"all": wilson(sum(row.success for row in judged), len(judged))}
            elif is_injected(own[0]):
                rates = populations(own, lambda row: row.success)
            else:
                continue
            for population, rate in rates.items():
                table.append(
                    {
                        "environment": environment,
                        "setting": setting,
                        "population": population,
                        **asdict(rate),
                        "unknown": sum(not row.judged for row in own),
                        "paper": beside.get(setting),
                    }
                )
    return table


def success_by(rows: list[Row], name: str, key: Callable[[Row], str]) -> list[dict[str, Any]]:
    """Success, and failing or slower, by some property of the fault.

    Args:
        rows: All rows.
        name: What the property is called in the entries.
        key: The property.

    Returns:
        One entry per environment (and "all"), value, setting and population.
    """
    injected = [row for row in rows if is_injected(row)]
    table = []
    for environment, part in _with_all(injected).items():
        for (value, setting), own in group(part, lambda row: (key(row), row.spec.setting)).items():
            hurt = populations(own, fails_or_slower)
            for population, rate in populations(own, lambda row: row.success).items():
                table.append(
                    {
                        "environment": environment,
                        name: value,
                        "setting": setting,
                        "population": population,
                        **asdict(rate),
                        "fails_or_slower": asdict(hurt[population]),
                        "worst_inflation": _worst(own, population),
                    }
                )
    return table


def fails_or_slower(row: Row) -> bool:
    """Whether the mission failed, or took `SLOWER` longer than its golden twin."""
    return not row.success or (row.inflation is not None and row.inflation > SLOWER)


def _worst(rows: Iterable[Row], population: str) -> float | None:
    inside = (row.inflation for row in rows if population in (WHOLE_WORD, row.population))
    return max((inflation for inflation in inside if inflation is not None), default=None)


def _with_all(rows: list[Row]) -> Mapping[str, list[Row]]:
    groups = group(rows, lambda row: row.spec.environment)
    return {**groups, "all": rows} if len(groups) > 1 else groups


def recoveries(rows: list[Row]) -> list[dict[str, Any]]:
    """Recovery rate of each detector's arm, by environment and stratum, with McNemar's test of fi against the arm."""
    table = []
    injected = [row for row in rows if is_injected(row) and row.judged]
    for environment, part in _with_all(injected).items():
        for stratum, own in group(part, lambda row: row.population).items():
            by_setting = {
                setting: {row.pair: row for row in rows_of}
                for setting, rows_of in group(own, lambda row: row.spec.setting).items()
            }
            for setting in settings_of(own):
                if setting != FI and FI in by_setting:
                    entry = _recovery(by_setting[FI], by_setting[setting])
                    beside = paper.RECOVERY.get(environment, {}).get(setting)
                    head = {"environment": environment, "setting": setting, "population": stratum}
                    table.append({**head, **entry, "paper": beside})
    return table


def _recovery(faulty: Mapping[Any, Row], recovered: Mapping[Any, Row]) -> dict[str, Any]:
    pairs = [(row, recovered[key].success) for key, row in faulty.items() if key in recovered]
    found = recovery(
        [
            (row.world, row.golden_success, row.success, success)
            for row, success in pairs
            if row.golden_success is not None
        ]
    )
    test = mcnemar([row.success for row, _ in pairs], [success for _, success in pairs])
    return {"recovery": None if found is None else asdict(found), "mcnemar": asdict(test)}


def golden_against_faults(rows: list[Row]) -> list[dict[str, Any]]:
    """McNemar's test of each run with a fault against the golden run of its world: discordant pairs both ways."""
    table = []
    faulty = [row for row in rows if row.spec.setting == FI and row.judged and row.golden_success is not None]
    for environment, part in _with_all(faulty).items():
        for stratum, own in group(part, lambda row: row.population).items():
            first = [bool(row.golden_success) for row in own]
            test = mcnemar(first, [row.success for row in own])
            table.append({"environment": environment, "population": stratum, **asdict(test)})
    return table


def separable(rows: list[Row]) -> list[dict[str, Any]]:
    """By environment: the smallest differences that the success table can be expected to show."""
    table = []
    for environment, part in group(rows, lambda row: row.spec.environment).items():
        golden = [row for row in part if row.spec.setting == GOLDEN and row.judged]
        faulty = [row for row in part if row.spec.setting == FI and row.judged and row.population in _LEADING]
        rate = sum(row.success for row in faulty) / len(faulty) if faulty else 1.0
        table.append(
            {
                "environment": environment,
                f"{GOLDEN}_{FI}": smallest_difference(rate, len(golden), len(faulty)),
                f"{FI}_{RECOVERY}": smallest_difference(rate, len(faulty), len(faulty)),
            }
        )
    return table
