"""Claims: statements of the paper, each tested on the runs of a campaign."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import polars as pl
from scipy.stats import binomtest

from mavfi.analysis import measures as m
from mavfi.analysis import published as paper
from mavfi.analysis.measures import recomputed_share
from mavfi.analysis.rows import ACTIVATED
from mavfi.analysis.runs import Runs
from mavfi.analysis.table import TEXT, Column, Table
from mavfi.campaign.plan import FI, GOLDEN
from mavfi.errors import BadInputError, not_known
from mavfi.extras.paper.overhead_views import ALL
from mavfi.extras.paper.redundancy import TMR, band, between, ratio, shipped_designs
from mavfi.extras.paper.views import by_bits, platform_flights
from mavfi.extras.paper.worlds import Mean, MeanDifference, between_worlds, within_worlds
from mavfi.states import Stage


@dataclass(frozen=True, slots=True)
class Evidence:
    """Result of testing a claim."""

    here: str  # measured values, with intervals and n
    p_value: float | None  # two-sided; None = not testable with these runs
    supports: bool  # whether the measured difference has the claimed sign
    behind: tuple[str, ...] = ()  # ids of the tested runs


@dataclass(frozen=True, slots=True)
class Claim:
    """A testable statement of the paper."""

    name: str
    statement: str
    section: str  # of the paper
    campaign: str  # name of the campaign whose runs test it
    method: str  # the test, as shown in its table, whose notes explain it
    test: Callable[[Runs], Evidence]


LEVEL = 0.05
"""Family-wise error rate: probability that any claim of a table is wrongly confirmed or contradicted."""
CONFIRMED = "confirmed"
CONTRADICTED = "contradicted"
UNDECIDED = "undecided"
NOT_TESTED = "not tested here"
"""Beginning of the note on findings that are left to other scales."""


def holm(p_values: Sequence[float | None]) -> list[float | None]:
    """Apply Holm's (1979) step-down correction over all tests with a p value; None remains None."""
    tests = sorted((p, index) for index, p in enumerate(p_values) if p is not None)
    adjusted: list[float | None] = [None] * len(p_values)
    largest = 0.0  # adjusted values never decrease in the order of the p values
    for rank, (p, index) in enumerate(tests):
        largest = max(largest, min(1.0, (len(tests) - rank) * p))
        adjusted[index] = largest
    return adjusted


def claims_table(
    names: Sequence[str], campaigns: Iterable[Runs], untested: Mapping[str, Sequence[str]] | None = None
) -> Table:
    """Test each claim on its campaign, and tabulate the verdicts with Holm's correction over all claims.

    Args:
        names: Names of the claims.
        campaigns: Runs of the campaigns.
        untested: Names of claims that are only named below the table, by the scale that tests them.

    Raises:
        BadInputError: A name is not known.
    """
    unknown = next((name for name in names if name not in CLAIMS), None)
    if unknown is not None:
        raise BadInputError(f"claim {not_known(unknown, CLAIMS)}")

    # each claim is tested on the runs of its campaign
    claims = [CLAIMS[name] for name in names]
    runs_by_campaign = {runs.campaign["name"]: runs for runs in campaigns}
    results = []
    for claim in claims:
        runs = runs_by_campaign.get(claim.campaign)
        if runs is not None and len(runs):
            results.append(claim.test(runs))
        else:
            results.append(Evidence(f"no runs of campaign {claim.campaign}", None, supports=False))

    # the correction is over the claims of this table: those that could not be tested do not count
    adjusted = holm([evidence.p_value for evidence in results])
    rows = [
        (
            claim.name,
            claim.statement,
            verdict(evidence, corrected),
            claim.section,
            evidence.here,
            evidence.p_value,
            corrected,
            claim.method,
            claim.campaign,
        )
        for claim, evidence, corrected in zip(claims, results, adjusted, strict=True)
    ]
    count = sum(p is not None for p in adjusted)
    return Table(
        "claims",
        "Findings of the paper, tested",
        _COLUMNS,
        rows,
        keys=2,
        notes=(
            f"confirmed, contradicted: two-sided p below {LEVEL:g} after Holm's correction over {count} tests (Holm "
            "1979), in or against the direction of the claim; undecided: at this n the data are compatible with both",
            "p: two-sided, by the test in the row; randomization of worlds: random signs of the differences of worlds, "
            "or, of groups of different worlds, worlds shuffled; flights of one world are not taken as independent",
            "exact sign test, for measured overheads: of timed golden flights, each taken as independent; none: the "
            "output of a model, which has no p",
            "[95 % interval]: of rates Wilson's, n reduced by the design effect of worlds; of other means a bootstrap "
            "of worlds",
            "published autopilot profile, faults and platforms of this project: see the fidelity page for differences",
            *(
                f"{NOT_TESTED}, where flights are too few to decide; tested at scale {scale}: "
                + "; ".join(CLAIMS[name].statement for name in names_at_scale)
                for scale, names_at_scale in (untested or {}).items()
            ),
        ),
        behind=[_behind(evidence) for evidence in results],
    )


_COLUMNS = (
    Column("claim", "claim", TEXT, hidden=True),
    Column("statement", "the paper"),
    Column("verdict", "verdict"),
    Column("section", "section"),
    Column("here", "here"),
    Column("p", "p", "number .2g"),
    Column("holm_p", "p (Holm)", "number .2g"),
    Column("method", "test"),
    Column("campaign", "campaign", TEXT, hidden=True),
)
_LINKED = ("verdict", "p", "holm_p")
"""Columns whose cells open the tested runs."""


def _behind(evidence: Evidence) -> tuple[tuple[str, ...], ...]:
    """The runs that each cell of a finding's row opens."""
    runs_by_column = dict.fromkeys(_LINKED, evidence.behind)
    return tuple(runs_by_column.get(column.key, ()) for column in _COLUMNS)


def verdict(evidence: Evidence, corrected: float | None) -> str:
    """Verdict (confirmed, contradicted or undecided) from the corrected p value."""
    if corrected is None or corrected >= LEVEL:
        return UNDECIDED
    if evidence.supports:
        return CONFIRMED
    return CONTRADICTED


# ---- claims of the paper's text, each with a test on runs (see `claims`); all tests treat worlds as independent ----

KERNELS = "kernels"
STATES = "states"
INSTRUCTIONS = "table1_instructions"
VALUES = "table1"
AS_PUBLISHED = "as_published"
"""Names of the campaigns used in the tests."""
HARMED = m.FAILS_OR_SLOWER
_HARMED_WORDS = "fails or > 5 % longer"
SUCCESS = pl.col("success")
TIME_CHANGED = pl.when("success").then(pl.col("inflation").abs() > m.SLOWER)
"""Whether flight time changes by more than 5 %; null for failures."""
SUCCESS_LOST = pl.col("golden_success").cast(pl.Float64) - pl.col("success").cast(pl.Float64)
"""Success lost to the fault: success without it - success with it."""
WITHIN = "random signs of the differences of worlds"
_BETWEEN = "worlds shuffled between the groups"
_GAUSSIAN = "dr_gaussian"
_AUTOENCODER = "dr_autoencoder"
_SETTING_WORDS = {FI: "fault", _GAUSSIAN: "fault with GAD", _AUTOENCODER: "fault with AAD"}
"""Settings of paired tests."""
_LONGER = "flight time over golden"


@dataclass(frozen=True, slots=True)
class MeanFormat:
    """How means are written: value x factor before the name of the unit."""

    name: str
    factor: float = 1.0
    form: str = ".1f"

    def text(self, mean: Mean, group: str = "") -> str:
        """E.g. "97.0 s [95.1, 99.2] (n = 100)", after the name of the group of runs."""
        interval = ""
        if mean.bounds is not None:
            interval = f" [{', '.join(self._number(bound) for bound in mean.bounds)}]"
        return f"{group} {self._number(mean.value)} {self.name}{interval} (n = {mean.n})".lstrip()

    def _number(self, value: float) -> str:
        return f"{self.factor * value:{self.form}}"


_PERCENT = MeanFormat("%", 100.0)
_SECONDS = MeanFormat("s")
_KILOJOULES = MeanFormat("kJ", 1e-3)
_OVERHEAD_SHARE = MeanFormat("% of compute time", 100.0, ".3g")


def _evidence(
    difference: MeanDifference | None, first: str, second: str, *, more: bool, what: str, unit: MeanFormat = _PERCENT
) -> Evidence:
    """Evidence from a difference, which the claim states to be positive (`more`) or negative.

    `first` and `second` name the groups in the text; "" = a constant, which is left out.
    """
    if difference is None:
        return Evidence("no runs to compare", None, supports=False)
    groups = ((difference.first, first), (difference.second, second))
    means = ", ".join(unit.text(mean, group) for mean, group in groups if group)
    here = f"{what}: {means}, {difference.worlds} worlds"
    return Evidence(here, difference.p_value, (difference.difference > 0) == more, difference.behind)


def _equality(runs: Runs, test: Callable[[Runs], Evidence]) -> Evidence:
    """Evidence on a claim of equality, which can be contradicted, but not confirmed."""
    return replace(test(runs), supports=False)


def _faults(runs: Runs) -> Runs:
    return m.leading_faults(runs).where(setting=FI)


class FaultKind(NamedTuple):
    """Faults of one kind: its name, and the condition on their runs."""

    name: str
    condition: pl.Expr


def _compare_kinds(
    runs: Runs,
    first: FaultKind,
    second: FaultKind,
    *,
    select: Callable[[Runs], Runs] = _faults,
    value: pl.Expr = HARMED,
    what: str = _HARMED_WORDS,
    more: bool = True,
) -> Evidence:
    """Compare two kinds of faults in the same worlds."""
    faults = select(runs)
    difference = within_worlds(faults.where(first.condition), faults.where(second.condition), value)
    return _evidence(difference, first.name, second.name, more=more, what=what)


def _lost(runs: Runs, *where: pl.Expr, setting: str = FI) -> Evidence:
    """Compare golden runs with the same missions with a fault."""
    faults = m.leading_faults(runs).where(pl.col("golden_success").is_not_null(), *where, setting=setting)
    # a world has a single golden run, however many faults were injected in it
    first_faults = replace(faults, frame=faults.frame.unique("world", maintain_order=True))
    golden = first_faults.adding(value=pl.col("golden_success"))
    difference = within_worlds(golden, faults.adding(value=SUCCESS), pl.col("value"))
    return _evidence(difference, "golden", _SETTING_WORDS[setting], more=True, what="success")


def _above_golden(runs: Runs, *where: pl.Expr, value: pl.Expr, what: str) -> Evidence:
    """Compare a value with 0, which it is in golden runs by definition."""
    faults = _faults(runs).where("golden_success", *where)
    faults = faults.adding(value=value).where(pl.col("value").is_not_null())
    difference = within_worlds(faults, faults.adding(value=pl.lit(0.0)), pl.col("value"))
    return _evidence(difference, "fault", "", more=True, what=what)


def _paired(runs: Runs, setting: str, other: str, column: str, *, more: bool, what: str, **where: str) -> Evidence:
    """Compare two settings with the same faults; pairs with a null value in either setting are excluded."""
    flights = m.leading_faults(runs).where(pl.col("setting").is_in((setting, other)), **where)
    pair = ("environment", "target", "index")
    complete = (pl.len().over(pair) == 2) & pl.col(column).is_not_null().all().over(pair)
    flights = flights.where(complete)
    difference = within_worlds(flights.where(setting=setting), flights.where(setting=other), pl.col(column))
    return _evidence(difference, _SETTING_WORDS[setting], _SETTING_WORDS[other], more=more, what=what)


_recovers = partial(_paired, column="success", more=True, what="success")
"""Test whether more missions succeed under the first setting."""
_shortens = partial(_paired, column="inflation", more=False, what=_LONGER)
"""Test whether flights take less time under the first setting."""


def _in_dense(runs: Runs, value: pl.Expr, *, more: bool, what: str) -> Evidence:
    """Compare flights in Dense with those in the other environments."""
    flights = runs.adding(value=value)
    dense = flights.where(environment="dense")
    others = flights.where(pl.col("environment") != "dense")
    difference = between_worlds(dense, others, pl.col("value"))
    return _evidence(difference, "Dense", "other environments", more=more, what=what)


def _hardest(runs: Runs) -> Evidence:
    faults = _faults(runs).where(pl.col("golden_success").is_not_null())
    return _in_dense(faults, SUCCESS_LOST, more=True, what="success lost to a fault")


def _hardest_to_recover(runs: Runs) -> Evidence:
    lost = m.against_fi(m.leading_faults(runs)).where("golden_success", ~pl.col("fi_success"))
    return _in_dense(lost, pl.col("dr_success"), more=False, what="lost missions that GAD or AAD bring back")


def _most_missed(runs: Runs) -> Evidence:
    faults = m.leading_faults(runs).where(pl.col("detector") != "", site_outcome=ACTIVATED)
    return _in_dense(faults, pl.col("detected_at_site"), more=False, what="faults detected at their site by GAD or AAD")


_PERCEPTION = FaultKind("perception", pl.col("stage") == "perception")
_PLANNING_CONTROL = FaultKind("planning and control", pl.col("stage").is_in(("planning", "control")))


def _of_kernels() -> Iterable[Claim]:
    """Claims on the effect of a fault by the kernel that it hits."""
    claim = partial(Claim, section="III-A", campaign=KERNELS, method=WITHIN)
    collision_check = FaultKind("collision check", pl.col("kernel") == "collision_check")
    clouds_and_maps = FaultKind("point cloud and OctoMap", pl.col("kernel").is_in(("point_cloud", "octomap")))
    yield claim(
        "perception_least_critical",
        "The perception stage is the least critical",
        test=partial(_compare_kinds, first=_PERCEPTION, second=_PLANNING_CONTROL, more=False),
    )
    yield claim(
        "collision_check_critical",
        "Collision check is the critical kernel within perception",
        test=partial(_compare_kinds, first=collision_check, second=clouds_and_maps),
    )
    yield claim(
        "planning_control_flight_time",
        "Flight time ranges wider with faults in planning and control",
        test=partial(
            _compare_kinds,
            first=_PLANNING_CONTROL,
            second=_PERCEPTION,
            value=TIME_CHANGED,
            what="flight time changed by > 5 %",
        ),
    )
    yield claim(
        "clouds_and_maps_negligible",
        "Faults in point cloud and OctoMap lose no missions (little to negligible impact)",
        test=partial(_equality, test=lambda runs: _lost(runs, clouds_and_maps.condition)),
    )
    yield claim(
        "planning_control_success",
        "Faults in planning and control lower the success rate (by up to 8 %)",
        test=lambda runs: _lost(runs, _PLANNING_CONTROL.condition),
    )


def _of_states() -> Iterable[Claim]:
    """Claims on the effect of a fault by the state and the bit that it hits."""
    claim = partial(Claim, section="III-B", campaign=STATES, method=WITHIN)
    sequence = FaultKind("future_collision_seq", pl.col("target") == "future_collision_seq")
    time = FaultKind("time_to_collision", pl.col("target") == "time_to_collision")
    yield claim(
        "collision_seq_robust",
        f"{sequence.name} is much more robust than {time.name}",
        test=partial(_compare_kinds, first=sequence, second=time, more=False),
    )

    # classes of bits
    by_class = partial(
        _compare_kinds,
        first=FaultKind("sign and exponent", pl.col("bits").is_in(("sign", "exponent"))),
        second=FaultKind("mantissa", pl.col("bits") == "mantissa"),
        select=by_bits,
    )
    yield claim("sign_exponent_matter_most", "Faults in sign and exponent fields have a greater impact", test=by_class)
    for end, words, value, what in (
        ("flight_time", "flight time", pl.col("inflation"), _LONGER),
        ("energy", "energy", pl.col("energy_inflation"), "energy over golden"),
        ("failures", "failures", ~SUCCESS, "fails"),
    ):
        yield claim(
            f"sign_exponent_{end}",
            f"Faults in sign and exponent fields increase {words} more",
            test=partial(by_class, value=value, what=what),
        )

    waypoints = pl.col("target").is_in(("waypoint position", "waypoint yaw", "waypoint velocity"))
    yield claim(
        "waypoints_harm",
        "Faults in position, yaw and velocity of way-points lead to crashes or longer flights (cannot be contradicted)",
        test=lambda runs: _above_golden(runs, waypoints, value=HARMED, what=_HARMED_WORDS),
    )


def _of_success(campaign: str, level: str, end: str) -> Iterable[Claim]:
    """Claims of Table I on the effects of faults of one level, and on what the detectors recover."""

    def claim(name: str, statement: str, test: Callable[[Runs], Evidence], method: str = WITHIN) -> Claim:
        return Claim(f"{name}{end}", f"Table I, {level}: {statement}", "VI-A", campaign, method, test)

    # what a fault does, then what each detector recovers, on the same missions
    yield claim("fault_loses_missions", "one fault lowers the success rate", _lost)
    yield claim(
        "fault_lengthens_flights",
        "flights that succeed take longer (the worst by 63 to 93 %)",
        partial(_above_golden, value=pl.when("success").then("inflation"), what=_LONGER),
    )
    gaussian = partial(_recovers, setting=_GAUSSIAN, other=FI)
    yield claim("gaussian_recovers", "GAD recovers failed missions", gaussian)
    autoencoder = partial(_recovers, setting=_AUTOENCODER, other=FI)
    yield claim("autoencoder_recovers", "AAD recovers failed missions", autoencoder)
    both = partial(_recovers, setting=_AUTOENCODER, other=_GAUSSIAN)
    yield claim("autoencoder_beats_gaussian", "AAD recovers more than GAD", both)
    yield claim(
        "autoencoder_like_golden",
        "with AAD as many missions succeed as without a fault",
        partial(_equality, test=partial(_lost, setting=_AUTOENCODER)),
    )
    both = partial(_shortens, setting=_AUTOENCODER, other=_GAUSSIAN)
    yield claim("autoencoder_shortens_more", "AAD recovers more flight time than GAD", both)
    gaussian = partial(_shortens, setting=_GAUSSIAN, other=FI)
    yield claim("gaussian_shortens_flights", "GAD recovers flight time", gaussian)
    autoencoder = partial(_shortens, setting=_AUTOENCODER, other=FI)
    yield claim("autoencoder_shortens_flights", "AAD recovers flight time", autoencoder)

    # Dense against the other environments
    yield claim("dense_hardest", "Dense loses most missions (9.7 points)", _hardest, _BETWEEN)
    yield claim("dense_hardest_to_recover", "Dense is the hardest to recover", _hardest_to_recover, _BETWEEN)


# ---- claims of the paper's section VI-C on the overhead of detection and of recovery, modelled and measured --------

_FLIGHTS = "sign test of flights"


def _shares(runs: Runs, setting: str, *stages: Stage) -> Runs:
    """Runs of a setting, with the recomputation of stages (all by default) / compute time, modelled, as `value`."""
    flown = runs.where("judged", setting=setting)
    shares = {run_id: recomputed_share([runs.records[run_id]], stages) for run_id in flown["run_id"]}
    return flown.adding(value=pl.col("run_id").replace_strict(shares, return_dtype=pl.Float64))


def _overhead(runs: Runs, setting: str, bound: float) -> Evidence:
    """Compare the overhead (recomputation / compute time, by run, in modelled time) with an upper bound."""
    shares = _shares(runs, setting)
    difference = within_worlds(shares, shares.adding(value=pl.lit(bound)), pl.col("value"))
    if difference is None:
        return Evidence("no runs", None, supports=False)
    here = f"{MeanFormat('%', 100.0, '.3g').text(difference.first)} of compute time, {difference.worlds} worlds"
    return Evidence(here, difference.p_value, difference.difference < 0, difference.behind)


def _recompute_less(runs: Runs) -> Evidence:
    """Compare the modelled recomputation of both detectors, on the same missions."""
    difference = within_worlds(_shares(runs, _AUTOENCODER), _shares(runs, _GAUSSIAN), pl.col("value"))
    return _evidence(difference, "AAD", "GAD", more=False, what="recomputation", unit=_OVERHEAD_SHARE)


def _of_early_stages(runs: Runs) -> Evidence:
    """Compare the modelled recomputation of the early stages with that of control."""
    early = _shares(runs, _GAUSSIAN, Stage.PERCEPTION, Stage.PLANNING)
    difference = within_worlds(early, _shares(runs, _GAUSSIAN, Stage.CONTROL), pl.col("value"))
    words = "perception and planning", "control"
    return _evidence(difference, *words, more=True, what="recomputation of GAD", unit=_OVERHEAD_SHARE)


def _measured_times(runs: Runs, arm: str, parts: int) -> dict[tuple[str, int], float]:
    """Measured time of an arm's golden flights, by environment and number of the flight.

    `parts`: 1 = detection, 2 = detection and recovery, as shares of the kernels' time.
    """
    rows = runs.campaign.get("overheads", {}).get("rows", ())
    return {
        (row["environment"], flight): sum(shares[:parts])
        for row in rows
        if row["arm"] == arm and row["stage"] == ALL
        for flight, shares in enumerate(row.get("flights", ()))
    }


def _measured_overhead(runs: Runs, arm: str, bound: float) -> Evidence:
    """Sign test of measured detection and recovery of golden flights against an upper bound."""
    times = _measured_times(runs, arm, 2).values()
    if not times:
        return _NOT_MEASURED
    above = sum(share > bound for share in times)
    count = len(times)
    here = f"{100 * sum(times) / count:.3g} % of the kernels' time, mean of {count} flights; above it in {above}"
    return Evidence(here, float(binomtest(above, count).pvalue), supports=2 * above < count)


_NOT_MEASURED = Evidence("not measured by flight", None, supports=False)


def _measured_against(runs: Runs, parts: int, *, more: bool) -> Evidence:
    """Sign test of the measured times of both detectors, on the same golden flights; `parts`: see `_measured_times`."""
    aad = _measured_times(runs, "autoencoder", parts)
    gad = _measured_times(runs, "gaussian", parts)
    shared = [flight for flight in aad if flight in gad]
    if not shared:
        return _NOT_MEASURED

    # flights with equal times are left out
    above = sum(aad[flight] > gad[flight] for flight in shared)
    below = sum(aad[flight] < gad[flight] for flight in shared)
    p_value = 1.0
    if above + below:
        p_value = float(binomtest(above, above + below).pvalue)

    means = (
        f"{name} {100 * sum(times[flight] for flight in shared) / len(shared):.3g} %"
        for name, times in (("AAD", aad), ("GAD", gad))
    )
    here = (
        f"{', '.join(means)} of the kernels' time; AAD's is higher in {above} and lower in {below} of "
        f"{len(shared)} flights"
    )
    if more:
        return Evidence(here, p_value, supports=above > below)
    return Evidence(here, p_value, supports=above < below)


def _largest_recomputation() -> float:
    """The paper's largest recomputation overhead of GAD over environments, summed over stages."""
    sums = []
    for environment in ("factory", "farm", "sparse", "dense"):
        stages = [
            paper.figure("recompute_overhead", environment=environment, setting=_GAUSSIAN, stage=stage)
            for stage in ("perception", "planning", "control")
        ]
        sums.append(float(sum(stages)))
    return max(sums)


def _of_overhead() -> Iterable[Claim]:
    """Claims on the compute time of detection and recovery."""
    modelled = partial(Claim, section="VI-C", campaign=INSTRUCTIONS, method=WITHIN)
    measured = partial(Claim, section="VI-C", campaign=VALUES, method=_FLIGHTS)
    dense = paper.figure("detection_overhead", setting=_AUTOENCODER, environment="dense")
    for arm, short, bound in (("gaussian", "GAD", _largest_recomputation()), ("autoencoder", "AAD", dense)):
        limit = f"at most {100 * bound:.4g} % of compute time"
        yield modelled(
            f"{arm}_overhead",
            f"Recomputation of {short} takes {limit}, both modelled",
            test=partial(_overhead, setting=f"dr_{arm}", bound=bound),
        )
        yield measured(
            f"{arm}_overhead_measured",
            f"Detection and recovery by {short} take {limit}, measured here",
            test=partial(_measured_overhead, arm=arm, bound=bound),
        )
    text = "The overhead of AAD is smaller than GAD's"
    yield modelled("autoencoder_overhead_smaller", f"{text}: recomputation, modelled", test=_recompute_less)
    yield measured(
        "autoencoder_overhead_smaller_measured",
        f"{text}, measured here",
        test=partial(_measured_against, parts=2, more=False),
    )
    yield measured(
        "autoencoder_detection_slower",
        "AAD's detection takes more time than GAD's, measured here",
        test=partial(_measured_against, parts=1, more=True),
    )
    yield modelled(
        "gaussian_recovery_of_early_stages",
        "GAD's recovery is dominated by perception and planning, modelled",
        test=_of_early_stages,
    )


# ---- claims of the paper's sections VI-C and VI-D: computing platforms on flights, redundant processors by a model -

PLATFORMS = "platforms"
FAST = "i9-9940x"
SLOW = "cortex-a57"
"""Parts of the campaign, with the same worlds."""


def _of_golden(runs: Runs, column: str, what: str, unit: MeanFormat) -> Evidence:
    """Compare successful golden flights on both platforms."""
    flights = platform_flights(runs).where(setting=GOLDEN)
    difference = within_worlds(
        flights.where(environment=SLOW), flights.where(environment=FAST), pl.col(column), by="seed"
    )
    return _evidence(difference, SLOW, FAST, more=True, what=what, unit=unit)


def _times_as_long(runs: Runs, factor: float) -> Evidence:
    """Compare successful flights with a fault: mean time on the slow platform, and factor x that on the fast one."""
    flights = platform_flights(runs).where(setting=FI)
    scaled = flights.where(environment=FAST).adding(flight_time_s=factor * pl.col("flight_time_s"))
    difference = within_worlds(flights.where(environment=SLOW), scaled, pl.col("flight_time_s"), by="seed")
    return _evidence(difference, SLOW, f"{factor:g} x {FAST}", more=True, what="mean flight time", unit=_SECONDS)


def _same_trend(runs: Runs) -> Evidence:
    """Compare the share of faults that harm on both platforms."""
    faults = _faults(runs)
    difference = within_worlds(faults.where(environment=SLOW), faults.where(environment=FAST), HARMED, by="seed")
    return _evidence(difference, SLOW, FAST, more=True, what=_HARMED_WORDS)


def _redundant(_: Runs, vehicle: str) -> Evidence:
    """Flight time with TMR by the model; its inputs were calibrated to the claim, so it tests nothing."""
    ratios = [
        f"{design.calibration}: {ratio(design, TMR):.3f} (band {between(*band(design, TMR))})"
        for design in shipped_designs()
        if design.craft == vehicle
    ]
    here = f"by the model, calibrated to this value after the fact: {'; '.join(ratios)}"
    return Evidence(here, None, supports=True)


def _of_redundancy() -> Iterable[Claim]:
    """Claims on flight time with redundant processors."""
    claim = partial(Claim, section="VI-C", campaign=PLATFORMS, method="none: a model without chance")
    for name, vehicle in (("redundancy_airsim", "airsim_uav"), ("redundancy_spark", "dji_spark")):
        times = paper.figure("redundancy_time", vehicle=vehicle, scheme=TMR)
        text = f"TMR makes flights of {vehicle} {times:g} times as long as detection does"
        yield claim(name, text, test=partial(_redundant, vehicle=vehicle))


def _of_platforms() -> Iterable[Claim]:
    """Claims on golden flights, on the effect of a fault, and on recovery, on the slow platform and the fast one."""
    claim = partial(Claim, section="VI-D", campaign=PLATFORMS, method=WITHIN)
    # golden flights
    yield claim(
        "slow_platform_time",
        "Flights on the Cortex-A57 take longer (115 s : 322 s)",
        test=partial(_of_golden, column="flight_time_s", what="mean flight time", unit=_SECONDS),
    )
    yield claim(
        "slow_platform_energy",
        "Flights on the Cortex-A57 need more energy (61.7 kJ : 177.1 kJ)",
        test=partial(_of_golden, column="energy_j", what="mean energy", unit=_KILOJOULES),
    )

    # flights with a fault
    factor = float(paper.figure("platforms_worst", quantity="flight_time_ratio"))
    yield claim(
        "slow_platform_ratio",
        f"With a fault, flights on the Cortex-A57 take at least {factor:g} times as long (the paper: the worst)",
        test=partial(_times_as_long, factor=factor),
    )
    yield claim("platforms_alike", "Faults harm alike on both platforms", test=partial(_equality, test=_same_trend))

    # what detectors recover
    shorter = partial(_shortens, environment=SLOW)
    for arm, short in (("gaussian", "GAD"), ("autoencoder", "AAD")):
        setting = f"dr_{arm}"
        share = paper.figure("platforms_recovered", setting=setting)
        text = f"On the Cortex-A57 {short} recovers flight time (by {100 * share:.1f} % of the worst)"
        yield claim(f"{arm}_recovers_slow_platform", text, test=partial(shorter, setting=setting, other=FI))
    yield claim(
        "autoencoder_beats_gaussian_slow_platform",
        "On the Cortex-A57 AAD recovers more flight time than GAD",
        test=partial(shorter, setting=_AUTOENCODER, other=_GAUSSIAN),
    )


_CLAIMS = (
    *_of_kernels(),
    *_of_states(),
    *_of_success(INSTRUCTIONS, "faults in instructions", ""),
    *_of_success(VALUES, "faults in states", "_in_states"),
    *_of_success(AS_PUBLISHED, "the reading that fits the published table best", "_as_published"),
    Claim(
        "dense_most_missed_in_states",
        "Table I, faults in states: in Dense most faults go undetected",
        "VI-A",
        VALUES,
        _BETWEEN,
        _most_missed,
    ),
    *_of_overhead(),
    *_of_redundancy(),
    *_of_platforms(),
)
CLAIMS = {claim.name: claim for claim in _CLAIMS}
"""By name."""
