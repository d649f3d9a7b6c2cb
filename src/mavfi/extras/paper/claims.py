"""Claims: statements of the paper, each tested on the runs of a campaign."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import polars as pl
from scipy.stats import binomtest

from mavfi.analysis import measures as m
from mavfi.analysis import published as paper
from mavfi.analysis.measures import leading_faults, recomputed_share
from mavfi.analysis.rows import ACTIVATED
from mavfi.analysis.runs import Runs
from mavfi.analysis.statistics import holm
from mavfi.analysis.table import TEXT, Column, Table
from mavfi.campaign.plan import FI, GOLDEN
from mavfi.errors import BadInputError, not_known
from mavfi.extras.paper.overhead_views import ALL
from mavfi.extras.paper.redundancy import TMR, band, between, ratio, shipped_designs
from mavfi.extras.paper.views import by_bits, compared
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
    results = [_test(claim, runs_by_campaign.get(claim.campaign)) for claim in claims]

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
            *_left_to_other_scales(untested or {}),
        ),
        behind=[_behind_cells(evidence) for evidence in results],
    )


def _left_to_other_scales(untested: Mapping[str, Sequence[str]]) -> Iterable[str]:
    """A note for each scale that tests further claims."""
    for scale, names in untested.items():
        statements = "; ".join(CLAIMS[name].statement for name in names)
        yield f"{NOT_TESTED}, where flights are too few to decide; tested at scale {scale}: {statements}"


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
_KEYS = tuple(column.key for column in _COLUMNS)
_LINKED = ("verdict", "p", "holm_p")
"""Columns, and those whose cells open the tested runs."""


def _behind_cells(evidence: Evidence) -> tuple[tuple[str, ...], ...]:
    """Ids of the runs that each cell of a row opens."""
    cells = []
    for key in _KEYS:
        ids: tuple[str, ...] = ()
        if key in _LINKED:
            ids = evidence.behind
        cells.append(ids)
    return tuple(cells)


def _test(claim: Claim, runs: Runs | None) -> Evidence:
    if runs is None or not len(runs):
        return Evidence(f"no runs of campaign {claim.campaign}", None, supports=False)
    return claim.test(runs)


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
SUCCESS = pl.col("success")
TIME_CHANGED = pl.when("success").then(pl.col("inflation").abs() > m.SLOWER)
"""Whether flight time changes by more than 5 %; null for failures."""
SUCCESS_LOST = pl.col("golden_success").cast(pl.Float64) - pl.col("success").cast(pl.Float64)
"""Success lost to the fault: success without it - success with it."""
WITHIN = "random signs of the differences of worlds"
_BETWEEN = "worlds shuffled between the groups"


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


PERCENT = MeanFormat("%", 100.0)


def evidence_of(
    difference: MeanDifference | None, first: str, second: str, *, more: bool, what: str, unit: MeanFormat = PERCENT
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


def equality(test: Callable[[Runs], Evidence]) -> Callable[[Runs], Evidence]:
    """A claim of equality, which can be contradicted, but not confirmed."""
    return lambda runs: replace(test(runs), supports=False)


def _faults(runs: Runs) -> Runs:
    return m.leading_faults(runs).where(setting=FI)


def _is_one_of(column: str, *names: str) -> pl.Expr:
    return pl.col(column).is_in(names)


def _compare_faults(
    select: Callable[[Runs], Runs],
    first: tuple[str, pl.Expr],
    second: tuple[str, pl.Expr],
    value: pl.Expr,
    *,
    more: bool,
    what: str,
) -> Callable[[Runs], Evidence]:
    """Test of two kinds of faults, each with its name and the condition on its runs, in the same worlds."""
    first_name, is_first = first
    second_name, is_second = second

    def test(runs: Runs) -> Evidence:
        faults = select(runs)
        difference = within_worlds(faults.where(is_first), faults.where(is_second), value)
        return evidence_of(difference, first_name, second_name, more=more, what=what)

    return test


_PERCEPTION = ("perception", _is_one_of("stage", "perception"))
_PLANNING_CONTROL = ("planning and control", _is_one_of("stage", "planning", "control"))
_HARMED_WORDS = "fails or > 5 % longer"
_SETTING_WORDS = {FI: "fault", "dr_gaussian": "fault with GAD", "dr_autoencoder": "fault with AAD"}
"""Settings of paired tests."""


def _lost(select: pl.Expr | None = None, setting: str = FI) -> Callable[[Runs], Evidence]:
    """Test of golden runs against the same missions with a fault."""

    def test(runs: Runs) -> Evidence:
        faults = m.leading_faults(runs).where(pl.col("golden_success").is_not_null(), setting=setting)
        if select is not None:
            faults = faults.where(select)
        # a world has a single golden run, however many faults were injected in it
        first_faults = replace(faults, frame=faults.frame.unique("world", maintain_order=True))
        golden = first_faults.adding(value=pl.col("golden_success"))
        difference = within_worlds(golden, faults.adding(value=SUCCESS), pl.col("value"))
        return evidence_of(difference, "golden", _SETTING_WORDS[setting], more=True, what="success")

    return test


def _above_golden(value: pl.Expr, what: str, select: pl.Expr | None = None) -> Callable[[Runs], Evidence]:
    """Test of a value that is 0 in golden runs by definition."""

    def test(runs: Runs) -> Evidence:
        faults = _faults(runs).where("golden_success")
        if select is not None:
            faults = faults.where(select)
        faults = faults.adding(value=value).where(pl.col("value").is_not_null())
        difference = within_worlds(faults, faults.adding(value=pl.lit(0.0)), pl.col("value"))
        return evidence_of(difference, "fault", "", more=True, what=what)

    return test


def paired(setting: str, other: str, column: str, *, more: bool, what: str, **where: str) -> Callable[[Runs], Evidence]:
    """Paired test of two settings with the same faults; pairs with a null value in either setting are excluded."""

    def test(runs: Runs) -> Evidence:
        flights = m.leading_faults(runs).where(pl.col("setting").is_in((setting, other)), **where)
        pair = ("environment", "target", "index")
        complete = (pl.len().over(pair) == 2) & pl.col(column).is_not_null().all().over(pair)
        flights = flights.where(complete)
        difference = within_worlds(flights.where(setting=setting), flights.where(setting=other), pl.col(column))
        return evidence_of(difference, _SETTING_WORDS[setting], _SETTING_WORDS[other], more=more, what=what)

    return test


def _in_dense(runs: Runs, value: pl.Expr, *, more: bool, what: str) -> Evidence:
    """Evidence from flights in Dense and in the other environments."""
    flights = runs.adding(value=value)
    dense = flights.where(environment="dense")
    others = flights.where(pl.col("environment") != "dense")
    difference = between_worlds(dense, others, pl.col("value"))
    return evidence_of(difference, "Dense", "other environments", more=more, what=what)


def _hardest(runs: Runs) -> Evidence:
    faults = _faults(runs).where(pl.col("golden_success").is_not_null())
    return _in_dense(faults, SUCCESS_LOST, more=True, what="success lost to a fault")


def _hardest_to_recover(runs: Runs) -> Evidence:
    lost = m.against_fi(m.leading_faults(runs)).where("golden_success", ~pl.col("fi_success"))
    return _in_dense(lost, pl.col("dr_success"), more=False, what="lost missions that GAD or AAD bring back")


def _most_missed(runs: Runs) -> Evidence:
    faults = m.leading_faults(runs).where(pl.col("detector") != "", site_outcome=ACTIVATED)
    return _in_dense(faults, pl.col("detected_at_site"), more=False, what="faults detected at their site by GAD or AAD")


_HIGH_BITS = ("sign and exponent", _is_one_of("bits", "sign", "exponent"))
_LOW_BITS = ("mantissa", _is_one_of("bits", "mantissa"))


Row = tuple[str, str, Callable[[Runs], Evidence]]
"""Name, statement and test of a claim."""


def _claims(section: str, campaign: str, *rows: Row, method: str = WITHIN) -> list[Claim]:
    """Claims of one section of the paper that are tested on one campaign by one method."""
    return [Claim(name, statement, section, campaign, method, test) for name, statement, test in rows]


def _of_kernels() -> list[Claim]:
    """Claims on the effect of a fault by the kernel that it hits."""
    # within perception, and the spread of flight times
    collision_check = ("collision check", _is_one_of("kernel", "collision_check"))
    clouds_and_maps = ("point cloud and OctoMap", _is_one_of("kernel", "point_cloud", "octomap"))
    critical = _compare_faults(_faults, collision_check, clouds_and_maps, HARMED, more=True, what=_HARMED_WORDS)
    wider = _compare_faults(
        _faults, _PLANNING_CONTROL, _PERCEPTION, TIME_CHANGED, more=True, what="flight time changed by > 5 %"
    )
    return _claims(
        "III-A",
        KERNELS,
        (
            "perception_least_critical",
            "The perception stage is the least critical",
            _compare_faults(_faults, _PERCEPTION, _PLANNING_CONTROL, HARMED, more=False, what=_HARMED_WORDS),
        ),
        ("collision_check_critical", "Collision check is the critical kernel within perception", critical),
        (
            "planning_control_flight_time",
            "Flight time ranges wider with faults in planning and control",
            wider,
        ),
        (
            "clouds_and_maps_negligible",
            "Faults in point cloud and OctoMap lose no missions (little to negligible impact)",
            equality(_lost(clouds_and_maps[1])),
        ),
        (
            "planning_control_success",
            "Faults in planning and control lower the success rate (by up to 8 %)",
            _lost(_PLANNING_CONTROL[1]),
        ),
    )


def _of_states() -> list[Claim]:
    """Claims on the effect of a fault by the state and the bit that it hits."""
    # the two states that the paper compares
    sequence = "future_collision_seq"
    time = "time_to_collision"
    robust = _compare_faults(
        _faults,
        (sequence, _is_one_of("target", sequence)),
        (time, _is_one_of("target", time)),
        HARMED,
        more=False,
        what=_HARMED_WORDS,
    )

    # the other states, and classes of bits
    waypoints = _is_one_of("target", "waypoint position", "waypoint yaw", "waypoint velocity")

    def by_class(value: pl.Expr, what: str) -> Callable[[Runs], Evidence]:
        return _compare_faults(by_bits, _HIGH_BITS, _LOW_BITS, value, more=True, what=what)

    more = "Faults in sign and exponent fields increase"
    return _claims(
        "III-B",
        STATES,
        ("collision_seq_robust", f"{sequence} is much more robust than {time}", robust),
        (
            "sign_exponent_matter_most",
            "Faults in sign and exponent fields have a greater impact",
            by_class(HARMED, _HARMED_WORDS),
        ),
        (
            "sign_exponent_flight_time",
            f"{more} flight time more",
            by_class(pl.col("inflation"), "flight time over golden"),
        ),
        ("sign_exponent_energy", f"{more} energy more", by_class(pl.col("energy_inflation"), "energy over golden")),
        ("sign_exponent_failures", f"{more} failures more", by_class(~SUCCESS, "fails")),
        (
            "waypoints_harm",
            "Faults in position, yaw and velocity of way-points lead to crashes or longer flights (cannot be "
            "contradicted)",
            _above_golden(HARMED, _HARMED_WORDS, waypoints),
        ),
    )


def _of_success(campaign: str, level: str, end: str) -> list[Claim]:
    """Claims of Table I on the effects of faults of one level, and on what the detectors recover."""
    table = f"Table I, {level}"
    longer = "flight time over golden"
    gaussian = "dr_gaussian"
    autoencoder = "dr_autoencoder"

    # what a fault does, then what each detector recovers, on the same missions
    within = _claims(
        "VI-A",
        campaign,
        (f"fault_loses_missions{end}", f"{table}: one fault lowers the success rate", _lost()),
        (
            f"fault_lengthens_flights{end}",
            f"{table}: flights that succeed take longer (the worst by 63 to 93 %)",
            _above_golden(pl.when("success").then("inflation"), longer),
        ),
        (
            f"gaussian_recovers{end}",
            f"{table}: GAD recovers failed missions",
            paired(gaussian, FI, "success", more=True, what="success"),
        ),
        (
            f"autoencoder_recovers{end}",
            f"{table}: AAD recovers failed missions",
            paired(autoencoder, FI, "success", more=True, what="success"),
        ),
        (
            f"autoencoder_beats_gaussian{end}",
            f"{table}: AAD recovers more than GAD",
            paired(autoencoder, gaussian, "success", more=True, what="success"),
        ),
        (
            f"autoencoder_like_golden{end}",
            f"{table}: with AAD as many missions succeed as without a fault",
            equality(_lost(setting=autoencoder)),
        ),
        (
            f"autoencoder_shortens_more{end}",
            f"{table}: AAD recovers more flight time than GAD",
            paired(autoencoder, gaussian, "inflation", more=False, what=longer),
        ),
        (
            f"gaussian_shortens_flights{end}",
            f"{table}: GAD recovers flight time",
            paired(gaussian, FI, "inflation", more=False, what=longer),
        ),
        (
            f"autoencoder_shortens_flights{end}",
            f"{table}: AAD recovers flight time",
            paired(autoencoder, FI, "inflation", more=False, what=longer),
        ),
    )

    # Dense against the other environments
    between = _claims(
        "VI-A",
        campaign,
        (f"dense_hardest{end}", f"{table}: Dense loses most missions (9.7 points)", _hardest),
        (f"dense_hardest_to_recover{end}", f"{table}: Dense is the hardest to recover", _hardest_to_recover),
        method=_BETWEEN,
    )
    return within + between


_FITTED = "the reading that fits the published table best"
_MISSED = "Table I, faults in states: in Dense most faults go undetected"
_MISSIONS = (
    *_of_kernels(),
    *_of_states(),
    *_of_success(INSTRUCTIONS, "faults in instructions", ""),
    *_of_success(VALUES, "faults in states", "_in_states"),
    *_of_success(AS_PUBLISHED, _FITTED, "_as_published"),
    *_claims("VI-A", VALUES, ("dense_most_missed_in_states", _MISSED, _most_missed), method=_BETWEEN),
)


# ---- claims of the paper's section VI-C on the overhead of detection and of recovery, modelled and measured --------

_FLIGHTS = "sign test of flights"
_NOT_MEASURED = "not measured by flight"
_OVERHEAD_SHARE = MeanFormat("% of compute time", 100.0, ".3g")


def _overhead(setting: str, bound: float) -> Callable[[Runs], Evidence]:
    """Test of the overhead (recomputation / compute time, by run, in modelled time) against an upper bound."""

    def test(runs: Runs) -> Evidence:
        shares = _shares(runs, setting)
        difference = within_worlds(shares, shares.adding(value=pl.lit(bound)), pl.col("value"))
        if difference is None:
            return Evidence("no runs", None, supports=False)
        here = f"{MeanFormat('%', 100.0, '.3g').text(difference.first)} of compute time, {difference.worlds} worlds"
        return Evidence(here, difference.p_value, difference.difference < 0, difference.behind)

    return test


def _measured_overhead(arm: str, bound: float) -> Callable[[Runs], Evidence]:
    """Test of measured detection and recovery of golden flights, as shares of their kernels' time."""

    def test(runs: Runs) -> Evidence:
        flights = _measured_times(runs, arm)
        if not flights:
            return Evidence(_NOT_MEASURED, None, supports=False)
        spent = [detection + recovery for detection, recovery in flights.values()]
        above = sum(share > bound for share in spent)
        count = len(spent)
        here = f"{100 * sum(spent) / count:.3g} % of the kernels' time, mean of {count} flights; above it in {above}"
        return Evidence(here, float(binomtest(above, count).pvalue), supports=2 * above < count)

    return test


def _measured_times(runs: Runs, arm: str) -> dict[tuple[str, int], tuple[float, float]]:
    """Measured detection and recovery of an arm's golden flights, by environment and number of the flight."""
    rows = runs.campaign.get("overheads", {}).get("rows", ())
    return {
        (row["environment"], flight): (shares[0], shares[1])
        for row in rows
        if row["arm"] == arm and row["stage"] == ALL
        for flight, shares in enumerate(row.get("flights", ()))
    }


def _shares(runs: Runs, setting: str, *stages: Stage) -> Runs:
    """Runs of a setting, with the recomputation of stages (all by default) / compute time, modelled, as `value`."""
    flown = runs.where("judged", setting=setting)
    shares = {run_id: recomputed_share([runs.records[run_id]], stages) for run_id in flown["run_id"]}
    return flown.adding(value=pl.col("run_id").replace_strict(shares, return_dtype=pl.Float64))


def _less(runs: Runs) -> Evidence:
    """Test of the modelled recomputation of both detectors, on the same missions."""
    difference = within_worlds(_shares(runs, "dr_autoencoder"), _shares(runs, "dr_gaussian"), pl.col("value"))
    return evidence_of(difference, "AAD", "GAD", more=False, what="recomputation", unit=_OVERHEAD_SHARE)


def _of_early_stages(runs: Runs) -> Evidence:
    """Test of the modelled recomputation by stage."""
    early = _shares(runs, "dr_gaussian", Stage.PERCEPTION, Stage.PLANNING)
    difference = within_worlds(early, _shares(runs, "dr_gaussian", Stage.CONTROL), pl.col("value"))
    words = "perception and planning", "control"
    return evidence_of(difference, *words, more=True, what="recomputation of GAD", unit=_OVERHEAD_SHARE)


_DETECTION = 0
_RECOVERY = 1
"""Parts of the measured times of a flight."""


def _measured_against(*parts: int, more: bool) -> Callable[[Runs], Evidence]:
    """Sign test of the sum of some parts of the measured times of both detectors, on the same golden flights."""

    def test(runs: Runs) -> Evidence:
        aad = _sums_of(_measured_times(runs, "autoencoder"), parts)
        gad = _sums_of(_measured_times(runs, "gaussian"), parts)
        shared = [flight for flight in aad if flight in gad]
        if not shared:
            return Evidence(_NOT_MEASURED, None, supports=False)

        # sign test: flights with equal times are left out
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

    return test


def _sums_of(
    flights: Mapping[tuple[str, int], tuple[float, float]], parts: Sequence[int]
) -> dict[tuple[str, int], float]:
    """Sum of some parts of the measured times of each flight."""
    return {flight: sum(shares[part] for part in parts) for flight, shares in flights.items()}


def _largest(name: str, setting: str) -> float:
    """The paper's largest recomputation overhead of a detector over environments, summed over stages."""
    sums = []
    for environment in ("factory", "farm", "sparse", "dense"):
        stages = [
            paper.figure(name, environment=environment, setting=setting, stage=stage)
            for stage in ("perception", "planning", "control")
        ]
        sums.append(float(sum(stages)))
    return max(sums)


def _of_overhead() -> Iterable[Claim]:
    """Claims on the compute time of detection and recovery."""
    for arm, short in (("gaussian", "GAD"), ("autoencoder", "AAD")):
        if arm == "gaussian":
            bound = _largest("recompute_overhead", "dr_gaussian")
        else:
            bound = paper.figure("detection_overhead", setting="dr_autoencoder", environment="dense")
        text = f"Recomputation of {short} takes at most {100 * bound:.4g} % of compute time, both modelled"
        yield Claim(f"{arm}_overhead", text, "VI-C", INSTRUCTIONS, WITHIN, _overhead(f"dr_{arm}", bound))
        text = f"Detection and recovery by {short} take at most {100 * bound:.4g} % of compute time, measured here"
        yield Claim(f"{arm}_overhead_measured", text, "VI-C", VALUES, _FLIGHTS, _measured_overhead(arm, bound))
    text = "The overhead of AAD is smaller than GAD's"
    yield Claim("autoencoder_overhead_smaller", f"{text}: recomputation, modelled", "VI-C", INSTRUCTIONS, WITHIN, _less)
    test = _measured_against(_DETECTION, _RECOVERY, more=False)
    yield Claim("autoencoder_overhead_smaller_measured", f"{text}, measured here", "VI-C", VALUES, _FLIGHTS, test)
    text = "AAD's detection takes more time than GAD's, measured here"
    test = _measured_against(_DETECTION, more=True)
    yield Claim("autoencoder_detection_slower", text, "VI-C", VALUES, _FLIGHTS, test)
    text = "GAD's recovery is dominated by perception and planning, modelled"
    yield Claim("gaussian_recovery_of_early_stages", text, "VI-C", INSTRUCTIONS, WITHIN, _of_early_stages)


# ---- claims of the paper's sections VI-C and VI-D: computing platforms on flights, redundant processors by a model -

PLATFORMS = "platforms"
FAST = "i9-9940x"
SLOW = "cortex-a57"
"""Parts of the campaign, with the same worlds."""
_MODEL = "none: a model without chance"


_SECONDS = MeanFormat("s")
_KILOJOULES = MeanFormat("kJ", 1e-3)


def _of_golden(column: str, what: str, unit: MeanFormat) -> Callable[[Runs], Evidence]:
    """Test of successful golden flights on both platforms."""

    def test(runs: Runs) -> Evidence:
        flights = compared(runs).where(setting=GOLDEN)
        difference = within_worlds(
            flights.where(environment=SLOW), flights.where(environment=FAST), pl.col(column), by="seed"
        )
        return evidence_of(difference, SLOW, FAST, more=True, what=what, unit=unit)

    return test


def _times_as_long(factor: float) -> Callable[[Runs], Evidence]:
    """Test of successful flights with a fault: mean time on the slow platform - factor x mean time on the fast one."""

    def test(runs: Runs) -> Evidence:
        flights = compared(runs).where(setting=FI)
        scaled = flights.where(environment=FAST).adding(flight_time_s=factor * pl.col("flight_time_s"))
        difference = within_worlds(flights.where(environment=SLOW), scaled, pl.col("flight_time_s"), by="seed")
        return evidence_of(difference, SLOW, f"{factor:g} x {FAST}", more=True, what="mean flight time", unit=_SECONDS)

    return test


def _same_trend(runs: Runs) -> Evidence:
    """Test of the share of faults that harm."""
    faults = leading_faults(runs).where(setting=FI)
    difference = within_worlds(faults.where(environment=SLOW), faults.where(environment=FAST), HARMED, by="seed")
    return evidence_of(difference, SLOW, FAST, more=True, what="fails or > 5 % longer")


def _redundant(vehicle: str) -> Callable[[Runs], Evidence]:
    """Flight time with TMR by the model; its inputs were calibrated to the claim, so it tests nothing."""

    def test(_: Runs) -> Evidence:
        ratios = [
            f"{design.calibration}: {ratio(design, TMR):.3f} (band {between(*band(design, TMR))})"
            for design in shipped_designs()
            if design.craft == vehicle
        ]
        here = f"by the model, calibrated to this value after the fact: {'; '.join(ratios)}"
        return Evidence(here, None, supports=True)

    return test


def _of_redundancy() -> Iterable[Claim]:
    """Claims on flight time with redundant processors."""
    for name, vehicle in (("redundancy_airsim", "airsim_uav"), ("redundancy_spark", "dji_spark")):
        times = paper.figure("redundancy_time", vehicle=vehicle, scheme=TMR)
        text = f"TMR makes flights of {vehicle} {times:g} times as long as detection does"
        yield Claim(name, text, "VI-C", PLATFORMS, _MODEL, _redundant(vehicle))


def _of_platforms() -> Iterable[Claim]:
    """Claims on golden flights, on the effect of a fault, and on recovery, on the slow platform and the fast one."""
    # golden flights
    yield Claim(
        "slow_platform_time",
        "Flights on the Cortex-A57 take longer (115 s : 322 s)",
        "VI-D",
        PLATFORMS,
        WITHIN,
        _of_golden("flight_time_s", "mean flight time", _SECONDS),
    )
    yield Claim(
        "slow_platform_energy",
        "Flights on the Cortex-A57 need more energy (61.7 kJ : 177.1 kJ)",
        "VI-D",
        PLATFORMS,
        WITHIN,
        _of_golden("energy_j", "mean energy", _KILOJOULES),
    )

    # flights with a fault
    factor = float(paper.figure("platforms_worst", quantity="flight_time_ratio"))
    text = f"With a fault, flights on the Cortex-A57 take at least {factor:g} times as long (the paper: the worst)"
    yield Claim("slow_platform_ratio", text, "VI-D", PLATFORMS, WITHIN, _times_as_long(factor))
    yield Claim(
        "platforms_alike", "Faults harm alike on both platforms", "VI-D", PLATFORMS, WITHIN, equality(_same_trend)
    )

    # what detectors recover
    def shorter(setting: str, other: str) -> Callable[[Runs], Evidence]:
        return paired(setting, other, "inflation", more=False, what="flight time over golden", environment=SLOW)

    for arm, short in (("gaussian", "GAD"), ("autoencoder", "AAD")):
        share = paper.figure("platforms_recovered", setting=f"dr_{arm}")
        text = f"On the Cortex-A57 {short} recovers flight time (by {100 * share:.1f} % of the worst)"
        test = shorter(f"dr_{arm}", FI)
        yield Claim(f"{arm}_recovers_slow_platform", text, "VI-D", PLATFORMS, WITHIN, test)
    yield Claim(
        "autoencoder_beats_gaussian_slow_platform",
        "On the Cortex-A57 AAD recovers more flight time than GAD",
        "VI-D",
        PLATFORMS,
        WITHIN,
        shorter("dr_autoencoder", "dr_gaussian"),
    )


CLAIMS = {claim.name: claim for claim in (*_MISSIONS, *_of_overhead(), *_of_redundancy(), *_of_platforms())}
"""By name."""
