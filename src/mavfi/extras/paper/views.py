"""Views for the paper's figures: flight time and success by kernel, state and bit class; flight time distributions."""

import operator
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
import polars as pl

from mavfi.analysis import measures as m
from mavfi.analysis import published as paper
from mavfi.analysis.flight_views import (
    INSTRUCTION,
    INTERVALS,
    ONE_FAULT,
    SETTING,
    named_populations,
    of_states,
    of_values,
    paired,
)
from mavfi.analysis.measures import Measure
from mavfi.analysis.runs import Runs
from mavfi.analysis.table import POINTS_TEST, SIGNED, TEXT
from mavfi.analysis.views import View, has
from mavfi.campaign.plan import FI, GOLDEN
from mavfi.extras.paper.worlds import CONTRAST, contrast_measure
from mavfi.plugins import Chapter

GOLDEN_ROW = "golden run"
BIT_CLASSES = ("sign", "exponent", "mantissa")
TAIL = 0.05
"""Tail probability of the conditional value at risk (Rockafellar and Uryasev 2000)."""
SECONDS = "number .1f s"
_DETOURS = m.rate("hurt", "fails or > 5 % longer", m.FAILS_OR_SLOWER)


def with_golden(faulty: Runs, runs: Runs, column: str) -> Runs:
    """Golden runs without a detector, labelled "golden run" in `column`, followed by runs with a fault."""
    golden = runs.golden.where("judged", arm="").adding(**{column: pl.lit(GOLDEN_ROW)})
    return Runs(pl.concat([golden.frame, faulty.frame], how="diagonal"), runs.records, runs.campaign, runs.flights)


def by_kernel(runs: Runs) -> Runs:
    """Fig. 3: golden runs, and runs with an instruction fault, by kernel."""
    return with_golden(runs.injected.where("judged", level=INSTRUCTION, setting=FI), runs, "kernel")


def by_state(runs: Runs) -> Runs:
    """Fig. 4: golden runs, and runs with a state fault in the leading population, by group of fields."""
    return with_golden(m.leading_faults(runs).where(level="state", setting=FI), runs, "target")


def by_bits(runs: Runs) -> Runs:
    """Section III-B: golden runs, and runs with a fault in a float of a state, by class of the flipped bit."""
    floats = pl.col("population").is_in(BIT_CLASSES) & (pl.col("bit_class") == pl.col("population"))
    own = named_populations(runs.injected.where("judged", floats, level="state", setting=FI))
    return with_golden(own, runs, "bits")


_TIMES = (
    Measure("median_s", "flight time, median", SECONDS, lambda own: _quantile(own, 0.5)),
    Measure("p95_s", "95 %", SECONDS, lambda own: _quantile(own, 0.95)),
    Measure("worst_s", "worst", SECONDS, lambda own: _quantile(own, 1.0)),
    m.quantile("inflation", 1.0, "worst_time", "worst against golden"),
    Measure("worst_run", "worst run", TEXT, m.worst_run, hidden=True),
)


def _pairs(own: Runs) -> Runs:
    """Runs with a fault whose golden run was judged."""
    return own.injected.where(pl.col("golden_success").is_not_null())


def _p_value(own: Runs) -> float | None:
    pairs = _pairs(own)
    return m.against_golden(pairs).p_value if len(pairs) else None


_P = Measure("p", "p against golden", "number .3g", _p_value, counted=_pairs)


def _quantile(own: Runs, share: float) -> float | None:
    return m.quantile_of(own.where("success")["flight_time_s"], share)


def _shown(
    name: str, title: str, by: str, where: Callable[[Runs], Runs], heading: str, applies: Any, note: str,
    *, leads: bool = False,
) -> View:  # fmt: skip
    return View(
        name, title, ("environment", by),
        (m.count("n", "n"), m.rate("success", "success %", "success"), _P, _DETOURS, *_TIMES), where=where,
        headings=("environment", heading), applies=applies, leads=leads,
        notes=lambda _: (
            note, f"rates: {INTERVALS}; flight times of missions that succeed; against golden: of the "
            "same world", f"p: {m.PAIRED_TEST}; success with the fault and without it, in the same missions; not "
            "corrected for the number of rows", ONE_FAULT,
        ),
    )  # fmt: skip


def _kernels_note() -> str:
    worst, lost = (paper.figure("kernels_worst", quantity=name) for name in ("flight_time", "success_loss"))
    return (
        f"the paper (Fig. 3, a drawing without numbers; section III-A): flight time up to {100 * worst:+z.1f} %, "
        f"success lower by up to {100 * lost:.0f} points, both in planning and control; a node that dies is restarted; "
        "golden run: with the planner of the campaign, the other planners have golden runs of their own"
    )


_EFFECTS = (
    _shown("kernels_as_in_the_paper", "Fig. 3: flight time and success, one fault in one kernel", "kernel", by_kernel,
           "kernel", lambda runs: has(runs.injected, level=INSTRUCTION) and runs.campaign.get("each") == "kernel",
           _kernels_note(), leads=True),
    _shown("states_as_in_the_paper", "Fig. 4: flight time and success, one fault in one inter-kernel state", "target",
           by_state, "state", lambda runs: of_states(runs) and runs.campaign.get("each") == "group",
           "the paper's Fig. 4 is a drawing without numbers; faults in sign and exponent bits, where drawn apart"),
    _shown("bits_as_in_the_paper", "Section III-B: flight time and success, by class of the flipped bit", "bits",
           by_bits, "bits", lambda runs: set(BIT_CLASSES) <= set(runs.injected.values("population")),
           "section III-B: faults in sign and exponent fields have a greater impact"),
)  # fmt: skip


# ---- Fig. 6 ------------------------------------------------------------------------------------------------------
def distribution(runs: Runs) -> Runs:
    """Fig. 6: golden runs without a detector, and faults in the leading population.

    Column `paired` marks faults with which the mission succeeds in all settings.
    """
    faulty = paired(m.leading_faults(runs)).frame
    golden = runs.golden.where("judged", arm="").frame.with_columns(paired=pl.col("inflation").is_not_null())
    return Runs(pl.concat([golden, faulty], how="diagonal"), runs.records, runs.campaign, runs.flights)


def value_at_risk(values: list[float]) -> float | None:
    """Conditional value at risk: mean of the largest `TAIL` of the values (at least one value); None without values."""
    if not values:
        return None
    largest = np.sort(np.asarray(values, np.float64))[::-1]
    return float(largest[: max(1, round(TAIL * len(largest)))].mean())


def _censored(own: Runs) -> list[float]:
    """Flight times (s), with the time limit for failures."""
    at = (
        pl.when("success")
        .then("flight_time_s")
        .otherwise(pl.col("time_limit_s").fill_null(pl.col("time_limit_s").max()))
    )
    return own.frame.select(at.alias("s"))["s"].drop_nulls().to_list()


def _increase(share: float) -> Callable[[Runs], float | None]:
    return lambda own: m.quantile_of(own.where("paired")["inflation"], share)


def _recovered(runs: Runs, by: tuple[str, ...]) -> Iterable[Measure]:
    """Increase of flight time with the fault less that with fault and detector: of the worst and of the 95 % flight."""
    del by
    alone = runs.where("paired", setting=FI)

    def compared(own: Runs) -> tuple[Runs, ...]:
        if own.first("setting") in (GOLDEN, FI):
            return ()
        return alone.where(environment=own.first("environment")), own.where("paired")

    def points(key: str, heading: str, share: float) -> Measure:
        return contrast_measure(key, heading, POINTS_TEST, compared, "inflation", share, operator.sub)

    yield points("recovered", "recovered by", 1.0)
    yield Measure("paper_recovered", "paper's", "signed points", _papers)
    yield points("recovered_p95", "of the 95 %", 0.95)


def _papers(own: Runs) -> float | None:
    if not paper.comparable(own.campaign, own.first("detector_profile")):
        return None
    place = {key: own.first(key) for key in SETTING}
    found: float | None = paper.figure("worst_time_recovered", **place)
    return found


CHAPTER = Chapter(80, (
    *_EFFECTS,
    View(
        "flight_times", "Flight time: worst cases, and what detection and recovery take from them",
        SETTING,
        (
            m.count("n", "n"), m.rate("success", "success %", "success"), *_TIMES[:3],
            Measure("time_limit", "limit", "number .0f s", lambda own: own.frame["time_limit_s"].max()),
            Measure("cvar_s", "CVaR 5 %", SECONDS, lambda own: value_at_risk(own.where("success")["flight_time_s"])),
            Measure("cvar_limit_s", "CVaR, failures at the limit", SECONDS, lambda own: value_at_risk(_censored(own))),
            m.count("pairs", "pairs", "paired"),
            Measure("p95", "95 % increase", SIGNED, _increase(0.95)),
            Measure("worst", "worst increase", SIGNED, _increase(1.0)),
            paper.column(paper.worst_time, "paper's worst", SIGNED),
            _recovered,
            Measure("worst_energy", "worst energy", SIGNED,
                    lambda own: m.quantile_of(own.where("paired")["energy_inflation"], 1.0)),
            Measure("worst_run", "worst run", TEXT, lambda own: m.worst_run(own.where("paired")), hidden=True),
        ),
        where=distribution, applies=lambda runs: of_values(runs) or has(runs.injected, level=INSTRUCTION),
        notes=lambda _: (
            "flight times of missions that succeed; CVaR 5 %: mean of the slowest 5 % of them, and of all missions "
            "with failures at the time limit, which bounds every worst case",
            "increase: flight time / that of the golden run of the same world - 1, on pairs that succeed in all "
            "settings, faults in the leading bits; recovered by: the increase with the fault less that with the "
            "detector, in percentage points, as the paper counts; a maximum grows with n: compare it at equal n",
            f"{CONTRAST}; of a maximum the interval is too narrow, since no sample is worse than the flown ones",
            ONE_FAULT,
        ),
    ),
))  # fmt: skip
