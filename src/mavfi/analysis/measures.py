"""Measures, which map the rows of a group to one cell: a rate with its interval, a count, a quantile or a test."""

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import polars as pl

from mavfi.analysis.rows import ALL_BITS, POPULATIONS, WHOLE_WORD
from mavfi.analysis.runs import Runs
from mavfi.analysis.statistics import (
    EventRate,
    Paired,
    Rate,
    Recovery,
    clustered_rate,
    event_rate_by_flight,
    mcnemar,
    recovery,
    smallest_difference,
    weighted_rate,
    wilson,
)
from mavfi.analysis.table import NUMBER, RATE, SIGNED, TEXT, Cell, Column
from mavfi.campaign.plan import FI, GOLDEN
from mavfi.faults.strata import HEADLINE, SIGN_EXPONENT
from mavfi.record import FlightRecord

_WORDS = ({"sign_exponent", "mantissa"}, {"sign", "exponent", "mantissa"})
PARTITIONS = (*_WORDS, *({*strata, "length"} for strata in _WORDS))
"""Sets of strata that partition a word; with `length`, a message."""
LEADING = (HEADLINE, ALL_BITS)  # leading populations of tables, which are compared with the paper
PAIRED_TEST = "McNemar's exact test, all pairs of a world with the same random sign"
"""Name of the test of success in pairs, see `mcnemar`."""
SLOWER = 0.05  # relative increase in flight time above which a success counts as slower
SYSTEMATIC = 0.9
"""Share of flights above which alarms of one state at one instant are systematic, i.e. not due to the mission."""
_ORDER = (HEADLINE, "sign", "exponent", WHOLE_WORD, "mantissa")


@dataclass(frozen=True, slots=True)
class Measure:
    """One column of a view."""

    key: str  # name of the column in CSV and JSON
    heading: str
    form: str  # display format of cells, see `table`
    of: Callable[[Runs], Cell]  # rows of a group -> cell
    hidden: bool = False  # in CSV and JSON only
    counted: Callable[[Runs], Runs] = lambda own: own  # rows of a group that the cell is computed from

    @property
    def column(self) -> Column:
        """Key, heading, format and visibility as a table column."""
        return Column(self.key, self.heading, self.form, self.hidden)


Spread = Callable[[Runs, tuple[str, ...]], Iterable[Measure]]
"""Measures that depend on the data: (selected rows, columns to group by) -> measures."""


# ---- basic measures ----------------------------------------------------------------------------------------------
def count(key: str, heading: str, *tests: pl.Expr | str, **values: Any) -> Measure:
    """Number of rows that pass all tests."""
    return Measure(
        key,
        heading,
        NUMBER,
        lambda own: len(own.where(*tests, **values)),
        counted=lambda own: own.where(*tests, **values),
    )


def first(column: str, heading: str) -> Measure:
    """Value of a column that is constant within a group, taken from the first row."""
    return Measure(column, heading, TEXT, lambda own: own.first(column))


def median(column: str, heading: str, form: str = NUMBER) -> Measure:
    """Median of a column; None if it has no values."""
    return Measure(column, heading, form, lambda own: own.frame[column].median())


def quantile(column: str, share: float, key: str, heading: str) -> Measure:
    """Quantile of a column."""
    return Measure(key, heading, SIGNED, lambda own: quantile_of(own[column], share))


def quantile_of(values: Iterable[float | None], share: float) -> float | None:
    """Quantile of the known values; None if there are none."""
    known = [value for value in values if value is not None]
    if known:
        return float(np.quantile(known, share))
    return None


def rate(key: str, heading: str, test: pl.Expr | str, *where: pl.Expr | str) -> Measure:
    """Share of rows that pass a test, among those that pass `where`, with a cluster-adjusted Wilson interval."""
    return Measure(
        key,
        heading,
        RATE,
        lambda own: rate_of(own.where(*where), test),
        counted=lambda own: own.where(*where),
    )


def wilson_rate(key: str, heading: str, test: pl.Expr, *where: pl.Expr) -> Measure:
    """Share of rows that pass a test, among those that pass `where`, with a Wilson interval of independent rows."""

    def of(own: Runs) -> Cell:
        judged = own.where(*where)
        return wilson(len(judged.where(test)), len(judged))

    return Measure(key, heading, RATE, of)


def rate_of(own: Runs, test: pl.Expr | str) -> Rate:
    """Rate over rows, and its interval with missions as clusters."""
    asked = pl.col(test) if isinstance(test, str) else test
    passed = own.frame.select(asked.fill_null(value=False).alias("passed"))["passed"].to_list()
    return clustered_rate(passed, own["world"])


# ---- by population -----------------------------------------------------------------------------------------------
def populations(own: Runs, test: pl.Expr | str) -> dict[str, Rate]:
    """Rate of a property by population: each bit stratum, and the whole word if the strata partition it.

    Runs that could not be judged are excluded.
    """
    memo = own.memo
    key = ("populations", str(test))
    if key not in memo:
        judged = own.where("judged")
        rates = {name: rate_of(part, test) for (name,), part in judged.groups("population").items()}
        if set(rates) in PARTITIONS:
            passed = judged.frame.select((pl.col(test) if isinstance(test, str) else test).alias("passed"))["passed"]
            rates[WHOLE_WORD] = weighted_rate(passed.to_list(), judged["weight"], judged["population"], judged["world"])
        memo[key] = rates
    found: dict[str, Rate] = memo[key]
    return found


def population_names(runs: Runs, by: Sequence[str]) -> list[str]:
    """Populations in table order, the headline stratum first; golden runs have none."""
    found: dict[str, None] = {}
    for part in runs.groups(*by).values():
        own = part.where("judged").values("population")
        found |= dict.fromkeys([*own, *([WHOLE_WORD] if set(own) in PARTITIONS else [])])
    own = [name for name in found if name != "all"]
    return sorted(own, key=lambda name: _ORDER.index(name) if name in _ORDER else len(_ORDER))


def leads(names: Sequence[str]) -> list[str]:
    """Of populations in table order, those of sign and exponent bits, together or apart; without any, the first one."""
    return [name for name in names if name in SIGN_EXPONENT] or list(names[:1])


def leading_faults(runs: Runs) -> Runs:
    """Judged runs with a fault in the leading bits: sign and exponent, or all bits where these were not drawn apart."""
    judged = runs.injected.where("judged")
    return judged.where(pl.col("population").is_in(leads(population_names(judged, ()))))


def population_text(names: Collection[str]) -> str:
    """Display name of `leads`; "" for all bits of a word, and for none."""
    if len(names) > 1:
        return POPULATIONS[HEADLINE]
    return "".join(POPULATIONS.get(name, name) for name in names if name != ALL_BITS)


def leading(own: Runs, names: Sequence[str], test: pl.Expr | str) -> Rate | None:
    """Rate in the leading population; for golden runs, over all of them."""
    rates = populations(own, test)
    return rates.get("all", rates.get(names[0]) if names else None)


def in_leading(own: Runs, names: Sequence[str]) -> Runs:
    """The rows over which `leading` computes the rate."""
    judged = own.where("judged")
    held = judged.values("population")
    if "all" in held or not names:
        return judged.where(population="all")
    return judged.where(population=names[0])


def leading_success(runs: Runs, by: tuple[str, ...]) -> Iterable[Measure]:
    """Success in the leading population; golden runs share the column."""
    names = population_names(runs, by)
    if names:
        heading = f"success %, {POPULATIONS.get(names[0], names[0])}"
    else:
        heading = "success %"
    yield Measure(
        "success", heading, RATE, lambda own: leading(own, names, "success"), counted=lambda own: in_leading(own, names)
    )


def other_success(runs: Runs, by: tuple[str, ...]) -> Iterable[Measure]:
    """Success in each of the other populations."""

    def within(name: str) -> Callable[[Runs], Cell]:
        return lambda own: populations(own, "success").get(name)

    def counted(name: str) -> Callable[[Runs], Runs]:
        return lambda own: own.where("judged", *([] if name == WHOLE_WORD else [pl.col("population") == name]))

    for name in population_names(runs, by)[1:]:
        yield Measure(f"success_{name}", POPULATIONS.get(name, name), RATE, within(name), counted=counted(name))


FAILS_OR_SLOWER = ~pl.col("success") | (pl.col("inflation") > SLOWER).fill_null(value=False)
"""Whether the mission failed, or exceeded its golden run's flight time by more than `SLOWER`."""


def hurt(runs: Runs, by: tuple[str, ...]) -> Iterable[Measure]:
    """Share of failed or slower missions, and the largest increase in flight time, in a group's leading population."""
    names = population_names(runs, by)

    def shown(own: Runs) -> str:
        held = own.where("judged").values("population")
        if names[0] in held:
            return names[0]
        return str(held[0])

    def counted(own: Runs) -> Runs:
        return own.where("judged", population=shown(own))

    def worst(own: Runs) -> Any:
        return counted(own).frame["inflation"].max()

    def share(own: Runs) -> Rate:
        return populations(own, FAILS_OR_SLOWER)[shown(own)]

    if names:
        yield Measure("hurt", "hurt %", RATE, share, counted=counted)
        yield Measure("worst_time", "worst time", SIGNED, worst, counted=counted)


# ---- pairs -------------------------------------------------------------------------------------------------------
def against_fi(runs: Runs) -> Runs:
    """Join runs in `fi` with the runs of the same faults in every other setting; unpaired runs are excluded.

    Columns of the other setting have the prefix `dr_`: success, status, inflation, detected, alarm_after_s, time_s,
    before.  The success in `fi` is `fi_success`.
    """
    judged = runs.injected.where("judged")
    pair = ["environment", "target", "index"]
    alone = judged.where(setting=FI).frame.drop("setting", "arm", "detector", "detector_profile")
    arms = judged.where(pl.col("setting") != FI).frame.select(
        *pair,
        "setting",
        "arm",
        "detector",
        "detector_profile",
        dr_success="success",
        dr_status="status",
        dr_inflation="inflation",
        dr_detected="detected_at_site",
        dr_alarm_after_s="alarm_after_s",
        dr_time_s="time_s",
        dr_before="before",
    )
    joined = alone.rename({"success": "fi_success"}).join(arms, on=pair, maintain_order="left_right")
    return Runs(joined, runs.records, runs.campaign)


def recovery_of(own: Runs) -> Recovery | None:
    """Recovery rate (dr - fi) / (golden - fi) of paired rows."""
    if "recovery" not in own.memo:
        known = own.where(pl.col("golden_success").is_not_null())
        columns = (known[name] for name in ("world", "golden_success", "fi_success", "dr_success"))
        own.memo["recovery"] = recovery(list(zip(*columns, strict=True)))
    found: Recovery | None = own.memo["recovery"]
    return found


def discordant(own: Runs) -> Paired:
    """McNemar's test of fi against the arm."""
    return mcnemar(own["fi_success"], own["dr_success"], own["world"])


def against_golden(own: Runs) -> Paired:
    """McNemar's test of the golden run against the run with a fault."""
    return mcnemar(own["golden_success"], own["success"], own["world"])


def separable(runs: Runs) -> list[tuple[str, float | None, float | None]]:
    """Smallest differences (golden - fi, fi - dr) that a success table can resolve, by environment."""
    found = []
    for (environment,), part in runs.groups("environment").items():
        golden = part.golden.where("judged", setting=GOLDEN)
        faulty = part.injected.where("judged", pl.col("population").is_in(LEADING), setting=FI)
        n = len(faulty)
        share = sum(faulty["success"]) / len(faulty) if len(faulty) else 1.0
        found.append((environment, smallest_difference(share, len(golden), n), smallest_difference(share, n, n)))
    return found


# ---- alarms and time ---------------------------------------------------------------------------------------------
def alarm_rate(own: Runs) -> EventRate:
    """Alarms per hour of flight."""
    return event_rate_by_flight(own["alarms_total"], [time / 3600 for time in own["flight_time_s"]])


def systematic(own: Runs) -> list[tuple[str, float, int]]:
    """Alarms common to nearly all flights: state, instant (s), number of flights; empty for a single flight."""
    flights: Counter[tuple[str, int]] = Counter()
    for record in own.recorded():
        flights.update({(alarm.state, round(1e6 * alarm.time_s)) for alarm in record.alarms})
    return [
        (state, 1e-6 * time_us, n)
        for (state, time_us), n in sorted(flights.items())
        if len(own) > 1 and n > SYSTEMATIC * len(own)
    ]


def recomputed(own: Runs) -> float | None:
    """Recomputation time of all stages / compute time, over all rows."""
    return recomputed_share(own.recorded())


def recomputed_share(records: Iterable[FlightRecord], stages: Collection[str] = ()) -> float | None:
    """Modelled recomputation time of stages (all if empty) / compute time of the pipeline without recomputations.

    Compute times of kernels include their recomputations.
    """
    spent = compute = 0
    for record in records:
        compute += sum(record.compute_us.values()) - sum(record.recompute_us.values())
        spent += sum(us for stage, us in record.recompute_us.items() if not stages or stage in stages)
    if compute:
        return spent / compute
    return None


def worst_run(own: Runs) -> str | None:
    """Id of the run with the largest increase in flight time over its golden run."""
    known = own.frame.filter(pl.col("inflation").is_not_null())
    if known.is_empty():
        return None
    return str(known["run_id"][int(known["inflation"].arg_max() or 0)])
