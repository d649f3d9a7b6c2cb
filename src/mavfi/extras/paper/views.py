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
    of_missions,
    of_states,
    of_values,
    paired,
)
from mavfi.analysis.measures import Measure
from mavfi.analysis.runs import Runs
from mavfi.analysis.statistics import Rate, paired_difference
from mavfi.analysis.table import PERCENT, PERCENT_TEST, POINTS_TEST, RATE, SIGNED, TEXT, TIMES_TEST
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
    faults = named_populations(runs.injected.where("judged", floats, level="state", setting=FI))
    return with_golden(faults, runs, "bits")


_TIMES = (
    Measure("median_s", "flight time, median", SECONDS, lambda runs: _quantile(runs, 0.5)),
    Measure("p95_s", "95 %", SECONDS, lambda runs: _quantile(runs, 0.95)),
    Measure("worst_s", "worst", SECONDS, lambda runs: _quantile(runs, 1.0)),
    m.quantile("inflation", 1.0, "worst_time", "worst against golden"),
    Measure("worst_run", "worst run", TEXT, m.worst_run, hidden=True),
)


def _pairs(runs: Runs) -> Runs:
    """Runs with a fault whose golden run was judged."""
    return runs.injected.where(pl.col("golden_success").is_not_null())


def _p_value(runs: Runs) -> float | None:
    pairs = _pairs(runs)
    if len(pairs):
        return m.against_golden(pairs).p_value
    return None


_P = Measure("p", "p against golden", "number .3g", _p_value, counted=_pairs)


def _quantile(runs: Runs, share: float) -> float | None:
    return m.quantile_of(runs.where("success")["flight_time_s"], share)


def _view_by(
    name: str,
    title: Callable[[Runs], str],
    by: str,
    where: Callable[[Runs], Runs],
    heading: str,
    applies: Any,
    papers_note: str,
    *,
    leads: bool = False,
) -> View:
    """A view of flight time and success with one fault, one row per environment and value of the column `by`."""
    return View(
        name,
        title,
        ("environment", by),
        (m.count("n", "n"), m.rate("success", "success %", "success"), _P, _DETOURS, *_TIMES),
        where=where,
        headings=("environment", heading),
        applies=applies,
        leads=leads,
        notes=lambda runs: (
            *_beside_the_papers(runs, papers_note),
            f"rates: {INTERVALS}; flight times of missions that succeed; against golden: of the same world",
            f"p: {m.PAIRED_TEST}; success with the fault and without it, in the same missions; not "
            "corrected for the number of rows",
            ONE_FAULT,
        ),
    )


def _beside_the_papers(runs: Runs, note: str) -> list[str]:
    """A note on the paper's figure, if these are its missions."""
    if paper.same_missions(runs.campaign):
        return [note]
    return []


def _kernels_note() -> str:
    worst = paper.figure("kernels_worst", quantity="flight_time")
    lost = paper.figure("kernels_worst", quantity="success_loss")
    return (
        f"the paper (Fig. 3, a drawing without numbers; section III-A): flight time up to {100 * worst:+z.1f} %, "
        f"success lower by up to {100 * lost:.0f} points, both in planning and control; a node that dies is restarted; "
        "golden run: with the planner of the campaign, the other planners have golden runs of their own"
    )


_EFFECTS = (
    _view_by(
        "kernels_as_in_the_paper",
        paper.titled("Fig. 3: ", "flight time and success, one fault in one kernel"),
        "kernel",
        by_kernel,
        "kernel",
        lambda runs: has(runs.injected, level=INSTRUCTION) and runs.campaign.get("each") == "kernel",
        _kernels_note(),
        leads=True,
    ),
    _view_by(
        "states_as_in_the_paper",
        paper.titled("Fig. 4: ", "flight time and success, one fault in one inter-kernel state"),
        "target",
        by_state,
        "state",
        lambda runs: of_states(runs) and runs.campaign.get("each") == "group",
        "the paper's Fig. 4 is a drawing without numbers; faults in sign and exponent bits, where drawn apart",
    ),
    _view_by(
        "bits_as_in_the_paper",
        paper.titled("Section III-B: ", "flight time and success, by class of the flipped bit"),
        "bits",
        by_bits,
        "bits",
        lambda runs: set(BIT_CLASSES) <= set(runs.injected.values("population")),
        "section III-B: faults in sign and exponent fields have a greater impact",
    ),
)


# ---- Table I as differences: what a fault costs, and what detectors bring back ---------------------------------------
_COST_ROWS = {FI: "one fault", "dr_gaussian": "with GAD", "dr_autoencoder": "with AAD"}


def _costed(runs: Runs) -> Runs:
    """Runs with a fault whose mission has a golden run, with the settings of the paper's table."""
    settings = pl.col("setting").is_in(list(_COST_ROWS))
    faulty = m.leading_faults(runs).where(settings, pl.col("golden_success").is_not_null())
    return faulty.adding(row=pl.col("setting").replace(_COST_ROWS))


def _success_gained(runs: Runs) -> Rate | None:
    """Success with a setting - success of the golden runs of the same missions."""
    if not len(runs):
        return None
    gain = paired_difference(runs["success"], runs["golden_success"], runs["world"])
    return Rate(len(runs), gain.value, gain.low, gain.high)


def _papers_gain(environment: str, setting: str) -> float | None:
    """The same difference in the paper's table."""
    golden = paper.success(environment, GOLDEN)
    success = paper.success(environment, setting)
    if golden is None or success is None:
        return None
    return success - golden


def _costs_note(runs: Runs) -> str:
    note = "percentage points, [95 % interval: MOVER, n reduced by the design effect of worlds], same missions"
    if paper.compared(runs.campaign):
        return f"{note}; paper: difference of two rates of its Table I, n = 300 and 100"
    return note


def _costs_title(runs: Runs) -> str:
    """The title of the table of differences."""
    if paper.compared(runs.campaign):
        return "Table I as differences: success with a fault - success without it"
    return "Differences: success with a fault - success without it"


_COSTS = View(
    "costs_as_in_the_paper",
    _costs_title,
    ("row",),
    (Measure("here", "here", RATE, _success_gained), paper.column(_papers_gain)),
    where=_costed,
    across="environment",
    headings=("",),
    notes=lambda runs: (
        _costs_note(runs),
        "a loss of golden runs that is independent of the fault cancels out",
        ONE_FAULT,
    ),
    applies=lambda runs: has(runs.injected, setting=FI) and runs.campaign.get("each") in ("stage", "kernel"),
    by_name=True,
)


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


def _censored(runs: Runs) -> list[float]:
    """Flight times (s), with the time limit for failures."""
    at = (
        pl.when("success")
        .then("flight_time_s")
        .otherwise(pl.col("time_limit_s").fill_null(pl.col("time_limit_s").max()))
    )
    return runs.frame.select(at.alias("s"))["s"].drop_nulls().to_list()


def _increase(share: float) -> Callable[[Runs], float | None]:
    return lambda runs: m.quantile_of(runs.where("paired")["inflation"], share)


def _recovered(runs: Runs, by: tuple[str, ...]) -> Iterable[Measure]:
    """Increase of flight time with the fault less that with fault and detector: of the worst and of the 95 % flight."""
    alone = runs.where("paired", setting=FI)

    def compared(group: Runs) -> tuple[Runs, ...]:
        if group.first("setting") in (GOLDEN, FI):
            return ()
        return alone.where(environment=group.first("environment")), group.where("paired")

    def points(key: str, heading: str, share: float) -> Measure:
        return contrast_measure(key, heading, POINTS_TEST, compared, "inflation", share, operator.sub)

    yield points("recovered", "recovered by", 1.0)
    yield from paper.beside(Measure("paper_recovered", "paper's", "signed points", _papers_recovered))(runs, by)
    yield points("recovered_p95", "of the 95 %", 0.95)


def _papers_recovered(runs: Runs) -> float | None:
    """The same value in the paper."""
    if not paper.comparable(runs):
        return None
    setting = {key: runs.first(key) for key in SETTING}
    recovered: float | None = paper.figure("worst_time_recovered", **setting)
    return recovered


_FLIGHT_TIMES = View(
    "flight_times",
    "Flight time: worst cases, and what detection and recovery take from them",
    SETTING,
    (
        m.count("n", "n"),
        m.rate("success", "success %", "success"),
        *_TIMES[:3],
        Measure("time_limit", "limit", "number .0f s", lambda runs: runs.frame["time_limit_s"].max()),
        Measure("cvar_s", "CVaR 5 %", SECONDS, lambda runs: value_at_risk(runs.where("success")["flight_time_s"])),
        Measure("cvar_limit_s", "CVaR, failures at the limit", SECONDS, lambda runs: value_at_risk(_censored(runs))),
        m.count("pairs", "pairs", "paired"),
        Measure("p95", "95 % increase", SIGNED, _increase(0.95)),
        Measure("worst", "worst increase", SIGNED, _increase(1.0)),
        paper.column(paper.worst_time, "paper's worst", SIGNED),
        _recovered,
        Measure(
            "worst_energy",
            "worst energy",
            SIGNED,
            lambda runs: m.quantile_of(runs.where("paired")["energy_inflation"], 1.0),
        ),
        Measure("worst_run", "worst run", TEXT, lambda runs: m.worst_run(runs.where("paired")), hidden=True),
    ),
    where=distribution,
    applies=lambda runs: of_values(runs) or has(runs.injected, level=INSTRUCTION),
    notes=lambda _: (
        "flight times of missions that succeed; CVaR 5 %: mean of the slowest 5 % of them, and of all missions "
        "with failures at the time limit, which bounds every worst case",
        "increase: flight time / that of the golden run of the same world - 1, on pairs that succeed in all "
        "settings, faults in the leading bits; recovered by: the increase with the fault less that with the "
        "detector, in percentage points, as the paper counts; a maximum grows with n: compare it at equal n",
        f"{CONTRAST}; of a maximum the interval is too narrow, since no sample is worse than the flown ones",
        ONE_FAULT,
    ),
)


# ---- Fig. 9 of the paper and its table: the same missions on different computing platforms -------------------------

_KJ = "number .1f kJ"
_RATIO = "number .2f ×"


def platforms(runs: Runs) -> dict[str, str]:
    """Platform by environment, in order, for a campaign whose parts are distinct platforms; empty for others."""
    parts = runs.campaign.get("parts", {})
    platform_of = {name: part["platform"] for name, part in parts.items() if part.get("platform")}
    distinct = len(set(platform_of.values())) == len(platform_of)
    if len(platform_of) > 1 and distinct:
        return platform_of
    return {}


def platform_flights(runs: Runs) -> Runs:
    """Successful runs, without golden runs of detector arms, which differ from the bare ones by false alarms only."""
    flown = of_missions(runs).where("judged", "success")
    return flown.where(pl.col("setting").is_in([GOLDEN, *runs.settings()]))


def _worst(runs: Runs) -> float:
    seconds: Any = runs.frame["flight_time_s"].max()
    return float(seconds)


def _median(runs: Runs) -> float | None:
    seconds: Any = runs.frame["flight_time_s"].median()
    if seconds is None:
        return None
    return float(seconds)


def _power(runs: Runs) -> float | None:
    """Mean power (W): total energy / total flight time."""
    seconds = sum(runs["flight_time_s"])
    if seconds:
        return float(sum(runs["energy_j"]) / seconds)
    return None


def _printed(runs: Runs, quantity: str) -> Any:
    """A value of the paper's table, which stands beside golden flights; None beside others."""
    if runs.first("setting") != GOLDEN or not paper.comparable(runs):
        return None
    return paper.figure("platforms", quantity=quantity, platform=platforms(runs).get(runs.first("environment"), ""))


def _printed_energy(runs: Runs) -> float | None:
    """Energy of the paper's flights (J)."""
    kilojoule = _printed(runs, "energy_kj")
    if kilojoule is None:
        return None
    return float(1000 * kilojoule)


def _printed_power(runs: Runs) -> float | None:
    """Mean power of the paper's flights (W)."""
    time = _printed(runs, "flight_time_s")
    energy = _printed_energy(runs)
    if time and energy:
        return float(energy / time)
    return None


def _printed_processor(runs: Runs) -> str | None:
    """Power of the paper's processor."""
    power = _printed(runs, "power_w")
    if power is None:
        return None
    return f"{power} W"


def _against_first(runs: Runs, by: tuple[str, ...]) -> Iterable[Measure]:
    """Columns computed across groups: ratios to the first platform, and the recovered share of worst flight time."""
    # the groups are always by environment, i.e. platform, and setting
    groups = runs.groups("environment", "setting")
    first = next(iter(platforms(runs)), "")

    # ratios to the same setting on the first platform
    def on_both(group: Runs) -> tuple[Runs, ...]:
        base = groups.get((first, group.first("setting")))
        if base is None or group.first("environment") == first:
            return ()
        return (group, base)

    def ratio(key: str, heading: str, column: str, share: float) -> Measure:
        return contrast_measure(key, heading, TIMES_TEST, on_both, column, share, operator.truediv, by="seed")

    def papers_ratio(group: Runs) -> float | None:
        slow = group.first("environment") != first and group.first("setting") == FI
        if not slow or not paper.comparable(group):
            return None
        printed: float = paper.figure("platforms_worst", quantity="flight_time_ratio")
        return printed

    # recovery: fault alone, fault with detector, and golden flights on one platform
    def recoverable(group: Runs) -> tuple[Runs, ...]:
        golden = groups.get((group.first("environment"), GOLDEN))
        faulty = groups.get((group.first("environment"), FI))
        if golden is None or faulty is None or group.first("setting") in (GOLDEN, FI):
            return ()
        if _worst(faulty) > _worst(golden):
            return (faulty, group, golden)
        return ()

    def papers_recovery(group: Runs) -> float | None:
        slow = group.first("environment") != first
        if not slow or not paper.comparable(group):
            return None
        recovered: float | None = paper.figure("platforms_recovered", setting=group.first("setting"))
        return recovered

    # the columns, ours beside the paper's
    yield ratio("median_ratio", "median ratio", "flight_time_s", 0.5)
    yield ratio("energy_ratio", "of energy", "energy_j", 0.5)
    yield ratio("worst_ratio", "worst ratio", "flight_time_s", 1.0)
    yield from paper.beside(Measure("paper_ratio", "paper", _RATIO, papers_ratio))(runs, by)
    yield contrast_measure(
        "recovered",
        "recovered",
        PERCENT_TEST,
        recoverable,
        "flight_time_s",
        1.0,
        lambda fi, dr, golden: np.where(fi > golden, (fi - dr) / (fi - golden), 0.0),  # of a sample without a worse one
    )
    yield from paper.beside(Measure("paper_recovered", "paper", PERCENT, papers_recovery))(runs, by)


def _explanation(runs: Runs) -> list[str]:
    """Notes that compare the paper's ratio of flight times with that of the campaign."""
    if not paper.compared(runs.campaign):
        return []
    # the paper's table: the fast platform and the slow one
    fast = paper.figure("platforms", quantity="flight_time_s", platform="i9-9940x")
    slow = paper.figure("platforms", quantity="flight_time_s", platform="cortex-a57")
    fast_watts = 1000 * paper.figure("platforms", quantity="energy_kj", platform="i9-9940x") / fast
    slow_watts = 1000 * paper.figure("platforms", quantity="energy_kj", platform="cortex-a57") / slow
    lines = [
        f"the paper's {slow} s / {fast} s = {slow / fast:.1f} is what its text says of the worst flight times, so its "
        "table may hold worst cases; which flights, course and environment is not said",
        "the published tracker advances its reference by 10 ms per loop and needs 26 ms per loop on the TX2, so "
        "flights there take up to 2.6 times as long; latencies of perception and planning add to that where it waits",
        f"the paper's energy / flight time is {fast_watts:.0f} W and {slow_watts:.0f} W, little more than the constant "
        "of the power model: its energies follow from its times",
    ]
    # this campaign: golden flights on the first and the last platform
    golden = platform_flights(runs).where(setting=GOLDEN)
    by_environment = {name: group for (name,), group in golden.groups("environment").items()}
    times = [_median(by_environment[name]) for name in platforms(runs) if name in by_environment]
    if len(times) < 2 or not times[0] or not times[-1]:
        return lines
    ours = times[-1] / times[0]
    course = m.quantile_of(golden["course_m"], 0.5) or 0.0
    distance = m.quantile_of(golden["distance_m"], 0.5) or 0.0
    return [
        f"ours: golden flights take {ours:.2f} times as long (medians), over a course of {course:.0f} m and "
        f"{distance:.0f} m of path",
        *lines,
    ]


def _platforms_title(runs: Runs) -> str:
    """The title of the table of platforms."""
    if paper.compared(runs.campaign):
        return "Computing platforms (Fig. 9): flights that succeed"
    return "Computing platforms: flights that succeed"


_PLATFORMS = View(
    "platforms",
    _platforms_title,
    ("environment", "setting"),
    (
        m.count("n", "flights"),
        Measure("median_s", "median time", SECONDS, _median),
        Measure("worst_s", "worst time", SECONDS, _worst),
        paper.beside(Measure("paper_s", "paper", SECONDS, lambda runs: _printed(runs, "flight_time_s"))),
        m.median("energy_j", "median energy", _KJ),
        paper.beside(Measure("paper_kj", "paper", _KJ, _printed_energy)),
        Measure("power_w", "power", "number .0f W", _power),
        paper.beside(Measure("paper_w", "paper", "number .0f W", _printed_power)),
        _against_first,
        paper.beside(Measure("paper_processor", "paper: processor", "text", _printed_processor)),
    ),
    where=platform_flights,
    headings=("platform", "setting"),
    notes=lambda runs: (
        "recovered: of the worst flight time with a fault beyond the worst golden one, the share that the detector "
        "takes away; ratios: to the same setting on the first platform",
        f"{CONTRAST} (platforms of a ratio, detector and none of recovered); of a worst case the interval is too "
        "narrow, since no sample is worse than the flown ones",
        *_explanation(runs),
        "latencies are modelled; power is that of the rotors, the processor's is not in it",
        ONE_FAULT,
    ),
    applies=lambda runs: bool(platforms(runs)),
)

CHAPTER = Chapter(80, (_COSTS, *_EFFECTS, _FLIGHT_TIMES, _PLATFORMS))
