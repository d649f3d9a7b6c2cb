"""Measures, which map the rows of a group to one cell: a rate with its interval, a count, a quantile or a test."""

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import polars as pl

from mavfi.analysis.rows import ALL_BITS, POPULATIONS, WHOLE_WORD
from mavfi.analysis.runs import Runs, condition
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
)
from mavfi.analysis.table import NUMBER, RATE, SIGNED, TEXT, Cell, Column
from mavfi.campaign.plan import FI, GOLDEN
from mavfi.faults.strata import HEADLINE, SIGN_EXPONENT
from mavfi.record import FlightRecord

_WORD_PARTITIONS = ({"sign_exponent", "mantissa"}, {"sign", "exponent", "mantissa"})
PARTITIONS = (*_WORD_PARTITIONS, *({*strata, "length"} for strata in _WORD_PARTITIONS))
"""Sets of strata that partition a word; with `length`, a message."""
COMPARED = (HEADLINE, ALL_BITS)  # populations that are compared with the paper
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
    counted: Callable[[Runs], Runs] = lambda runs: runs  # rows of a group -> rows that the cell is computed from

    @property
    def column(self) -> Column:
        """Key, heading, format and visibility as a table column."""
        return Column(self.key, self.heading, self.form, self.hidden)


MeasureFactory = Callable[[Runs, tuple[str, ...]], Iterable[Measure]]
"""Measures that depend on the data: (selected rows, columns to group by) -> measures."""


# ---- basic measures ----------------------------------------------------------------------------------------------
def count(key: str, heading: str, *tests: pl.Expr | str, **values: Any) -> Measure:
    """Number of rows that pass all tests."""
    return Measure(
        key,
        heading,
        NUMBER,
        lambda runs: len(runs.where(*tests, **values)),
        counted=lambda runs: runs.where(*tests, **values),
    )


def first(column: str, heading: str) -> Measure:
    """Value of a column that is constant within a group, taken from the first row."""
    return Measure(column, heading, TEXT, lambda runs: runs.first(column))


def median(column: str, heading: str, form: str = NUMBER) -> Measure:
    """Median of a column; None if it has no values."""
    return Measure(column, heading, form, lambda runs: runs.frame[column].median())


def quantile(column: str, share: float, key: str, heading: str) -> Measure:
    """Quantile of a column."""
    return Measure(key, heading, SIGNED, lambda runs: quantile_of(runs[column], share))


def quantile_of(values: Iterable[float | None], share: float) -> float | None:
    """Quantile of the values that are not None; None if there are none."""
    numbers = [value for value in values if value is not None]
    if not numbers:
        return None
    return float(np.quantile(numbers, share))


def rate(key: str, heading: str, test: pl.Expr | str, *where: pl.Expr | str) -> Measure:
    """Share of rows that pass a test, among those that pass `where`, with a cluster-adjusted Wilson interval."""
    return Measure(
        key,
        heading,
        RATE,
        lambda runs: rate_of(runs.where(*where), test),
        counted=lambda runs: runs.where(*where),
    )


def rate_of(runs: Runs, test: pl.Expr | str) -> Rate:
    """Rate over rows, and its interval with missions as clusters."""
    passed = runs.frame.select(condition(test).fill_null(value=False).alias("passed"))["passed"].to_list()
    return clustered_rate(passed, runs["world"])


# ---- by population -----------------------------------------------------------------------------------------------
# The population of a fault is the class of bits that it was drawn in (golden runs: "all").  A table has one column for
# each; its first, the leading one, is that of sign and exponent bits, if these were drawn by themselves.
def rates_by_population(runs: Runs, test: pl.Expr | str) -> dict[str, Rate]:
    """Rate of a property by population: each bit stratum, and the whole word if the strata partition it.

    Runs that could not be judged are excluded.
    """
    key = ("populations", str(test))  # several columns of a table need the same rates
    if key not in runs.memo:
        judged = runs.where("judged")
        rates = {name: rate_of(part, test) for (name,), part in judged.groups("population").items()}
        if set(rates) in PARTITIONS:
            passed = judged.frame.select(condition(test).alias("passed"))["passed"]
            rates[WHOLE_WORD] = weighted_rate(passed.to_list(), judged["weight"], judged["population"], judged["world"])
        runs.memo[key] = rates
    memoized: dict[str, Rate] = runs.memo[key]
    return memoized


def word_weights(runs: Runs) -> list[float] | None:
    """Weights of runs with which their strata of bits make up whole words; None if they do not partition a word."""
    faults = Counter(runs["population"])
    if set(faults) not in PARTITIONS:
        return None
    return [row["weight"] / faults[row["population"]] for row in runs]


def population_names(runs: Runs, by: Sequence[str]) -> list[str]:
    """Populations in table order, the headline stratum first; golden runs have none."""
    names: dict[str, None] = {}  # a set that keeps the order
    for group in runs.groups(*by).values():
        in_group = group.where("judged").values("population")
        names |= dict.fromkeys(in_group)
        if set(in_group) in PARTITIONS:
            names[WHOLE_WORD] = None
    names.pop("all", None)
    rank = {name: index for index, name in enumerate(_ORDER)}
    return sorted(names, key=lambda name: rank.get(name, len(_ORDER)))


def leading_populations(runs: Runs) -> list[str]:
    """Populations of the faults that a campaign is summarized by.

    They are those of sign and exponent bits, together or apart, or without any the first one; but all of them where a
    whole group of fields would be left out.
    """
    judged = runs.injected.where("judged")
    names = population_names(judged, ())
    leading = [name for name in names if name in SIGN_EXPONENT] or names[:1]
    if runs.campaign.get("each") == "group":
        drawn_by_group = [group.values("population") for group in judged.groups("target").values()]
        if not all(set(drawn) & set(leading) for drawn in drawn_by_group):
            return names
    return leading


def leading_faults(runs: Runs) -> Runs:
    """Judged runs with a fault in the leading bits, see `leading_populations`."""
    return runs.injected.where("judged", pl.col("population").is_in(leading_populations(runs)))


def population_text(names: Collection[str]) -> str:
    """Display name of `leading_populations`; "" for all bits of a word, for all that were drawn, and for none."""
    if len(names) == 1:
        return "".join(POPULATIONS.get(name, name) for name in names if name != ALL_BITS)
    if names and set(names) <= set(SIGN_EXPONENT):
        return POPULATIONS[HEADLINE]
    return ""


def leading_rate(runs: Runs, names: Sequence[str], test: pl.Expr | str) -> Rate | None:
    """Rate in the first of the populations of a table; for golden runs, over all of them."""
    rates = rates_by_population(runs, test)
    if "all" in rates or not names:
        return rates.get("all")
    return rates.get(names[0])


def leading_runs(runs: Runs, names: Sequence[str]) -> Runs:
    """The rows over which `leading_rate` computes the rate."""
    judged = runs.where("judged")
    if "all" in judged.values("population") or not names:
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
        "success",
        heading,
        RATE,
        lambda group: leading_rate(group, names, "success"),
        counted=lambda group: leading_runs(group, names),
    )


def other_success(runs: Runs, by: tuple[str, ...]) -> Iterable[Measure]:
    """Success in each of the other populations."""
    for name in population_names(runs, by)[1:]:
        yield _success_in(name)


def _success_in(population: str) -> Measure:
    """Success in one population."""
    selection = {"population": population}
    if population == WHOLE_WORD:  # of all bits
        selection = {}
    return Measure(
        f"success_{population}",
        POPULATIONS.get(population, population),
        RATE,
        lambda group: rates_by_population(group, "success").get(population),
        counted=lambda group: group.where("judged", **selection),
    )


FAILS_OR_SLOWER = ~pl.col("success") | (pl.col("inflation") > SLOWER).fill_null(value=False)
"""Whether the mission failed, or exceeded its golden run's flight time by more than `SLOWER`."""


def hurt(runs: Runs, by: tuple[str, ...]) -> Iterable[Measure]:
    """Share of failed or slower missions, and the largest increase in flight time, in a group's leading population."""
    names = population_names(runs, by)

    def shown_population(group: Runs) -> str:
        """The leading population of the table or, if the group has none of it, the group's first one."""
        in_group = group.where("judged").values("population")
        if names[0] in in_group:
            return names[0]
        return str(in_group[0])

    def counted(group: Runs) -> Runs:
        return group.where("judged", population=shown_population(group))

    def worst(group: Runs) -> Any:
        return counted(group).frame["inflation"].max()

    def share(group: Runs) -> Rate:
        return rates_by_population(group, FAILS_OR_SLOWER)[shown_population(group)]

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
    without_detector = judged.where(setting=FI).frame.drop("setting", "arm", "detector", "detector_profile")
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
    joined = without_detector.rename({"success": "fi_success"}).join(arms, on=pair, maintain_order="left_right")
    return Runs(joined, runs.records, runs.campaign)


def recovery_of(runs: Runs) -> Recovery | None:
    """Recovery rate (dr - fi) / (golden - fi) of paired rows."""
    if "recovery" not in runs.memo:
        with_golden = runs.where(pl.col("golden_success").is_not_null())
        columns = (with_golden[name] for name in ("world", "golden_success", "fi_success", "dr_success"))
        runs.memo["recovery"] = recovery(list(zip(*columns, strict=True)))
    memoized: Recovery | None = runs.memo["recovery"]
    return memoized


def discordant(runs: Runs) -> Paired:
    """McNemar's test of fi against the arm."""
    return mcnemar(runs["fi_success"], runs["dr_success"], runs["world"])


def against_golden(runs: Runs) -> Paired:
    """McNemar's test of the golden run against the run with a fault."""
    return mcnemar(runs["golden_success"], runs["success"], runs["world"])


class Resolution(NamedTuple):
    """Smallest differences of success rates that the missions of an environment can resolve; None without missions."""

    environment: str
    golden_fi: float | None
    fi_dr: float | None


def separable(runs: Runs) -> list[Resolution]:
    """Smallest differences that a success table can resolve, by environment."""
    differences = []
    for (environment,), part in runs.groups("environment").items():
        golden = part.golden.where("judged", setting=GOLDEN)
        faulty = part.injected.where("judged", pl.col("population").is_in(COMPARED), setting=FI)
        n = len(faulty)
        share = 1.0
        if n:
            share = sum(faulty["success"]) / n
        golden_fi = smallest_difference(share, len(golden), n)
        differences.append(Resolution(environment, golden_fi, smallest_difference(share, n, n)))
    return differences


# ---- alarms and time ---------------------------------------------------------------------------------------------
def alarm_rate(runs: Runs) -> EventRate:
    """Alarms per hour of flight."""
    return event_rate_by_flight(runs["alarms_total"], [time / 3600 for time in runs["flight_time_s"]])


class SystematicAlarm(NamedTuple):
    """An alarm of a state at one instant of nearly all flights."""

    state: str
    time_s: float
    flights: int


def systematic(runs: Runs) -> list[SystematicAlarm]:
    """Alarms common to more than the share `SYSTEMATIC` of the flights; none for a single flight."""
    if len(runs) <= 1:
        return []
    flights: Counter[tuple[str, int]] = Counter()
    for record in runs.recorded():
        flights.update({(alarm.state, round(1e6 * alarm.time_s)) for alarm in record.alarms})
    return [
        SystematicAlarm(state, 1e-6 * time_us, count)
        for (state, time_us), count in sorted(flights.items())
        if count > SYSTEMATIC * len(runs)
    ]


def recomputed(runs: Runs) -> float | None:
    """Recomputation time of all stages / compute time, over all rows."""
    return recomputed_share(runs.recorded())


def recomputed_share(records: Iterable[FlightRecord], stages: Collection[str] = ()) -> float | None:
    """Modelled recomputation time of stages (all if empty) / compute time of the pipeline without recomputations.

    Compute times of kernels include their recomputations.
    """
    recompute_us = 0
    compute_us = 0
    for record in records:
        compute_us += sum(record.compute_us.values()) - sum(record.recompute_us.values())
        recompute_us += sum(us for stage, us in record.recompute_us.items() if not stages or stage in stages)
    if not compute_us:
        return None
    return recompute_us / compute_us


def worst_run(runs: Runs) -> str | None:
    """Id of the run with the largest increase in flight time over its golden run."""
    compared = runs.frame.filter(pl.col("inflation").is_not_null())
    if compared.is_empty():
        return None
    return str(compared["run_id"][int(compared["inflation"].arg_max() or 0)])
