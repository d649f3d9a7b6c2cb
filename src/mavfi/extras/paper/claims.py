"""Claims: statements of the paper, each tested on the runs of a campaign."""

from collections.abc import Callable, Iterable, Sequence
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
from mavfi.errors import BadInputError
from mavfi.extras.paper.overhead_views import ALL
from mavfi.extras.paper.redundancy import TMR, band, between, ratio, shipped_designs
from mavfi.extras.paper.views import by_bits, compared
from mavfi.extras.paper.worlds import Difference, Mean, between_worlds, within_worlds
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


def claims_table(names: Sequence[str], campaigns: Iterable[Runs]) -> Table:
    """Test each claim on its campaign, and tabulate the verdicts with Holm's correction over all claims.

    Raises:
        BadInputError: A name is not known.
    """
    unknown = next((name for name in names if name not in CLAIMS), None)
    if unknown is not None:
        raise BadInputError(f"claim {unknown!r}: not known; allowed: {', '.join(CLAIMS)}")
    runs = {own.campaign["name"]: own for own in campaigns}
    claims = [CLAIMS[name] for name in names]
    tested = [_tested(claim, runs.get(claim.campaign)) for claim in claims]
    adjusted = holm([one.p_value for one in tested])
    rows = [
        (
            claim.name,
            claim.statement,
            verdict(one, corrected),
            claim.section,
            one.here,
            one.p_value,
            corrected,
            claim.method,
            claim.campaign,
        )
        for claim, one, corrected in zip(claims, tested, adjusted, strict=True)
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
        ),
        behind=[tuple(one.behind if key in _LINKED else () for key in _KEYS) for one in tested],
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
_KEYS = tuple(column.key for column in _COLUMNS)
_LINKED = ("verdict", "p", "holm_p")
"""Columns, and those whose cells open the tested runs."""


def _tested(claim: Claim, runs: Runs | None) -> Evidence:
    if runs is None or not len(runs):
        return Evidence(f"no runs of campaign {claim.campaign}", None, supports=False)
    return claim.test(runs)


def verdict(one: Evidence, corrected: float | None) -> str:
    """Verdict (confirmed, contradicted or undecided) from the corrected p value."""
    if corrected is None or corrected >= LEVEL:
        return UNDECIDED
    if one.supports:
        return CONFIRMED
    return CONTRADICTED


# ---- claims of the paper's text, each with a test on runs (see `claims`); all tests treat worlds as independent ----

KERNELS = "kernels"
STATES = "states"
INSTRUCTIONS = "table1_instructions"
VALUES = "table1"
"""Names of the campaigns used in the tests."""
HURT = m.FAILS_OR_SLOWER
SUCCESS = pl.col("success")
ALTERED = pl.when("success").then(pl.col("inflation").abs() > m.SLOWER)
"""Whether flight time changes by more than 5 %; null for failures."""
LOSS = pl.col("golden_success").cast(pl.Float64) - pl.col("success").cast(pl.Float64)
"""Success lost to the fault: success without it - success with it."""
WITHIN = "random signs of the differences of worlds"
_BETWEEN = "worlds shuffled between the groups"


@dataclass(frozen=True, slots=True)
class Unit:
    """How means are written: value x factor before the name."""

    name: str
    factor: float = 1.0
    form: str = ".1f"

    def text(self, mean: Mean, own: str = "") -> str:
        """E.g. "97.0 s [95.1, 99.2] (n = 100)"; `own`: of what."""
        value, *bounds = (f"{self.factor * one:{self.form}}" for one in (mean.value, *(mean.bounds or ())))
        interval = f" [{', '.join(bounds)}]" if bounds else ""
        return f"{own} {value} {self.name}{interval} (n = {mean.n})".lstrip()


PERCENT = Unit("%", 100.0)


def tested(found: Difference | None, one: str, other: str, *, more: bool, what: str, unit: Unit = PERCENT) -> Evidence:
    """Evidence from a difference, which the claim states to be positive (`more`) or negative.

    `one` and `other` name the groups in the text; "" = a constant, which is left out.
    """
    if found is None:
        return Evidence("no runs to compare", None, supports=False)
    means = ", ".join(unit.text(mean, own) for mean, own in ((found.first, one), (found.second, other)) if own)
    here = f"{what}: {means}, {found.worlds} worlds"
    return Evidence(here, found.p_value, (found.difference > 0) == more, found.behind)


def equality(test: Callable[[Runs], Evidence]) -> Callable[[Runs], Evidence]:
    """A claim of equality, which can be contradicted, but not confirmed."""
    return lambda runs: replace(test(runs), supports=False)


def _faults(runs: Runs) -> Runs:
    return m.leading_faults(runs).where(setting=FI)


def _of(column: str, *names: str) -> pl.Expr:
    return pl.col(column).is_in(names)


def _compared(
    select: Callable[[Runs], Runs],
    first: tuple[str, pl.Expr],
    second: tuple[str, pl.Expr],
    value: pl.Expr,
    *,
    more: bool,
    what: str,
) -> Callable[[Runs], Evidence]:
    """Test of two kinds of faults in the same worlds."""

    def test(runs: Runs) -> Evidence:
        own = select(runs)
        found = within_worlds(own.where(first[1]), own.where(second[1]), value)
        return tested(found, first[0], second[0], more=more, what=what)

    return test


_PERCEPTION = ("perception", _of("stage", "perception"))
_LATER = ("planning and control", _of("stage", "planning", "control"))
_HURT = "fails or > 5 % longer"
_WORDS = {FI: "fault", "dr_gaussian": "fault with GAD", "dr_autoencoder": "fault with AAD"}
"""Settings of paired tests."""


def _lost(select: pl.Expr | None = None, setting: str = FI) -> Callable[[Runs], Evidence]:
    """Test of golden runs against the same missions with a fault."""

    def test(runs: Runs) -> Evidence:
        own = m.leading_faults(runs).where(pl.col("golden_success").is_not_null(), setting=setting)
        own = own if select is None else own.where(select)
        once = replace(own, frame=own.frame.unique("world", maintain_order=True))  # a world has one golden run
        golden = once.adding(value=pl.col("golden_success"))
        found = within_worlds(golden, own.adding(value=SUCCESS), pl.col("value"))
        return tested(found, "golden", _WORDS[setting], more=True, what="success")

    return test


def _above_golden(value: pl.Expr, what: str, select: pl.Expr | None = None) -> Callable[[Runs], Evidence]:
    """Test of a value that is 0 in golden runs by definition."""

    def test(runs: Runs) -> Evidence:
        own = _faults(runs).where("golden_success", *(() if select is None else (select,))).adding(value=value)
        known = own.where(pl.col("value").is_not_null())
        found = within_worlds(known, known.adding(value=pl.lit(0.0)), pl.col("value"))
        return tested(found, "fault", "", more=True, what=what)

    return test


def paired(setting: str, other: str, column: str, *, more: bool, what: str, **where: str) -> Callable[[Runs], Evidence]:
    """Paired test of two settings with the same faults; pairs with a null value in either setting are excluded."""

    def test(runs: Runs) -> Evidence:
        own = m.leading_faults(runs).where(pl.col("setting").is_in((setting, other)), **where)
        pair = ("environment", "target", "index")
        complete = (pl.len().over(pair) == 2) & pl.col(column).is_not_null().all().over(pair)
        own = own.where(complete)
        found = within_worlds(own.where(setting=setting), own.where(setting=other), pl.col(column))
        return tested(found, _WORDS[setting], _WORDS[other], more=more, what=what)

    return test


def _in_dense(runs: Runs, value: pl.Expr | str, *, more: bool, what: str) -> Evidence:
    """Evidence from flights in Dense and in the other environments."""
    own = runs.adding(value=pl.col(value) if isinstance(value, str) else value)
    dense = own.where(environment="dense")
    others = own.where(pl.col("environment") != "dense")
    return tested(between_worlds(dense, others, pl.col("value")), "Dense", "other environments", more=more, what=what)


def _hardest(runs: Runs) -> Evidence:
    own = _faults(runs).where(pl.col("golden_success").is_not_null())
    return _in_dense(own, LOSS, more=True, what="success lost to a fault")


def _hardest_to_recover(runs: Runs) -> Evidence:
    lost = m.against_fi(m.leading_faults(runs)).where("golden_success", ~pl.col("fi_success"))
    return _in_dense(lost, "dr_success", more=False, what="lost missions that GAD or AAD bring back")


def _most_missed(runs: Runs) -> Evidence:
    own = m.leading_faults(runs).where(pl.col("detector") != "", site_outcome=ACTIVATED)
    return _in_dense(own, "detected_at_site", more=False, what="faults detected at their site by GAD or AAD")


_BITS = {
    name: (words, _of("bits", *bits))
    for name, words, bits in (("high", "sign and exponent", ("sign", "exponent")), ("low", "mantissa", ("mantissa",)))
}


Row = tuple[str, str, Callable[[Runs], Evidence]]
"""Name, statement and test of a claim."""


def _claims(section: str, campaign: str, *rows: Row, method: str = WITHIN) -> list[Claim]:
    """Claims of one section of the paper that are tested on one campaign by one method."""
    return [Claim(name, statement, section, campaign, method, test) for name, statement, test in rows]


def _of_kernels() -> list[Claim]:
    check = _of("kernel", "collision_check")
    before = _of("kernel", "point_cloud", "octomap")
    critical = _compared(
        _faults, ("collision check", check), ("point cloud and OctoMap", before), HURT, more=True, what=_HURT
    )
    wider = _compared(_faults, _LATER, _PERCEPTION, ALTERED, more=True, what="flight time changed by > 5 %")
    return _claims(
        "III-A",
        KERNELS,
        (
            "perception_least_critical",
            "The perception stage is the least critical",
            _compared(_faults, _PERCEPTION, _LATER, HURT, more=False, what=_HURT),
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
            equality(_lost(before)),
        ),
        (
            "planning_control_success",
            "Faults in planning and control lower the success rate (by up to 8 %)",
            _lost(_LATER[1]),
        ),
    )


def _of_states() -> list[Claim]:
    sequence = "future_collision_seq"
    time = "time_to_collision"
    robust = _compared(
        _faults, (sequence, _of("target", sequence)), (time, _of("target", time)), HURT, more=False, what=_HURT
    )
    waypoints = _of("target", "waypoint position", "waypoint yaw", "waypoint velocity")

    def by_class(value: pl.Expr, what: str) -> Callable[[Runs], Evidence]:
        return _compared(by_bits, _BITS["high"], _BITS["low"], value, more=True, what=what)

    more = "Faults in sign and exponent fields increase"
    return _claims(
        "III-B",
        STATES,
        ("collision_seq_robust", f"{sequence} is much more robust than {time}", robust),
        (
            "sign_exponent_matter_most",
            "Faults in sign and exponent fields have a greater impact",
            by_class(HURT, _HURT),
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
            _above_golden(HURT, _HURT, waypoints),
        ),
    )


def _of_success(campaign: str, level: str, end: str) -> list[Claim]:
    """Claims of Table I on the effects of faults of one level, and on what the detectors recover."""
    table = f"Table I, faults in {level}"
    longer = "flight time over golden"
    gaussian = "dr_gaussian"
    autoencoder = "dr_autoencoder"
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
    between = _claims(
        "VI-A",
        campaign,
        (f"dense_hardest{end}", f"{table}: Dense loses most missions (9.7 points)", _hardest),
        (f"dense_hardest_to_recover{end}", f"{table}: Dense is the hardest to recover", _hardest_to_recover),
        method=_BETWEEN,
    )
    return within + between


_MISSED = "Table I, faults in states: in Dense most faults go undetected"
_MISSIONS = (
    *_of_kernels(),
    *_of_states(),
    *_of_success(INSTRUCTIONS, "instructions", ""),
    *_of_success(VALUES, "states", "_in_states"),
    *_claims("VI-A", VALUES, ("dense_most_missed_in_states", _MISSED, _most_missed), method=_BETWEEN),
)


# ---- claims of the paper's section VI-C on the overhead of detection and of recovery, modelled and measured --------

_FLIGHTS = "sign test of flights"
_NOT_MEASURED = "not measured by flight"
_SHARE = Unit("% of compute time", 100.0, ".3g")


def _overhead(setting: str, bound: float) -> Callable[[Runs], Evidence]:
    """Test of the overhead (recomputation / compute time, by run, in modelled time) against an upper bound."""

    def test(runs: Runs) -> Evidence:
        known = _shares(runs, setting)
        found = within_worlds(known, known.adding(value=pl.lit(bound)), pl.col("value"))
        if found is None:
            return Evidence("no runs", None, supports=False)
        here = f"{Unit('%', 100.0, '.3g').text(found.first)} of compute time, {found.worlds} worlds"
        return Evidence(here, found.p_value, found.difference < 0, found.behind)

    return test


def _measured_overhead(arm: str, bound: float) -> Callable[[Runs], Evidence]:
    """Test of measured detection and recovery of golden flights, as shares of their kernels' time."""

    def test(runs: Runs) -> Evidence:
        shares = list(_timed(runs, arm).values())
        if not shares:
            return Evidence(_NOT_MEASURED, None, supports=False)
        spent = [detection + recovery for detection, recovery in shares]
        above = sum(share > bound for share in spent)
        count = len(spent)
        here = f"{100 * sum(spent) / count:.3g} % of the kernels' time, mean of {count} flights; above it in {above}"
        return Evidence(here, float(binomtest(above, count).pvalue), supports=2 * above < count)

    return test


def _timed(runs: Runs, arm: str) -> dict[tuple[str, int], tuple[float, float]]:
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
    own = runs.where("judged", setting=setting)
    shares = {run_id: recomputed_share([runs.records[run_id]], stages) for run_id in own["run_id"]}
    return own.adding(value=pl.col("run_id").replace_strict(shares, return_dtype=pl.Float64))


def _less(runs: Runs) -> Evidence:
    """Test of the modelled recomputation of both detectors, on the same missions."""
    found = within_worlds(_shares(runs, "dr_autoencoder"), _shares(runs, "dr_gaussian"), pl.col("value"))
    return tested(found, "AAD", "GAD", more=False, what="recomputation", unit=_SHARE)


def _of_early_stages(runs: Runs) -> Evidence:
    """Test of the modelled recomputation by stage."""
    early = _shares(runs, "dr_gaussian", Stage.PERCEPTION, Stage.PLANNING)
    found = within_worlds(early, _shares(runs, "dr_gaussian", Stage.CONTROL), pl.col("value"))
    words = "perception and planning", "control"
    return tested(found, *words, more=True, what="recomputation of GAD", unit=_SHARE)


def _measured_against(*parts: int, more: bool) -> Callable[[Runs], Evidence]:
    """Sign test of both detectors on the same golden flights, measured; parts: 0 = detection, 1 = recovery."""

    def test(runs: Runs) -> Evidence:
        aad, gad = (
            {flight: sum(shares[part] for part in parts) for flight, shares in _timed(runs, arm).items()}
            for arm in ("autoencoder", "gaussian")
        )
        shared = [flight for flight in aad if flight in gad]
        if not shared:
            return Evidence(_NOT_MEASURED, None, supports=False)
        above, below = (sum(sign * aad[one] > sign * gad[one] for one in shared) for sign in (1, -1))
        if above + below:
            p_value = float(binomtest(above, above + below).pvalue)
        else:
            p_value = 1.0
        means = (
            f"{name} {100 * sum(own[one] for one in shared) / len(shared):.3g} %"
            for name, own in (("AAD", aad), ("GAD", gad))
        )
        here = f"{', '.join(means)} of the kernels' time; AAD's is higher in {above} and lower in {below} of "
        return Evidence(f"{here}{len(shared)} flights", p_value, supports=above > below if more else above < below)

    return test


def _largest(name: str, setting: str) -> float:
    """The paper's largest recomputation overhead of a detector over environments, summed over stages."""
    stages = [
        paper.figure(name, environment=place, setting=setting, stage=stage)
        for place in ("factory", "farm", "sparse", "dense")
        for stage in ("perception", "planning", "control")
    ]
    return max(float(sum(stages[place : place + 3])) for place in range(0, len(stages), 3))


def _of_overhead() -> Iterable[Claim]:
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
    test = _measured_against(0, 1, more=False)
    yield Claim("autoencoder_overhead_smaller_measured", f"{text}, measured here", "VI-C", VALUES, _FLIGHTS, test)
    text = "AAD's detection takes more time than GAD's, measured here"
    test = _measured_against(0, more=True)
    yield Claim("autoencoder_detection_slower", text, "VI-C", VALUES, _FLIGHTS, test)
    text = "GAD's recovery is dominated by perception and planning, modelled"
    yield Claim("gaussian_recovery_of_early_stages", text, "VI-C", INSTRUCTIONS, WITHIN, _of_early_stages)


# ---- claims of the paper's sections VI-C and VI-D: computing platforms on flights, redundant processors by a model -

PLATFORMS = "platforms"
FAST = "i9-9940x"
SLOW = "cortex-a57"
"""Parts of the campaign, with the same worlds."""
_MODEL = "none: a model without chance"


_SECONDS = Unit("s")
_KILOJOULES = Unit("kJ", 1e-3)


def _of_golden(column: str, what: str, unit: Unit) -> Callable[[Runs], Evidence]:
    """Test of successful golden flights on both platforms."""

    def test(runs: Runs) -> Evidence:
        own = compared(runs).where(setting=GOLDEN)
        found = within_worlds(own.where(environment=SLOW), own.where(environment=FAST), pl.col(column), by="seed")
        return tested(found, SLOW, FAST, more=True, what=what, unit=unit)

    return test


def _times_as_long(factor: float) -> Callable[[Runs], Evidence]:
    """Test of successful flights with a fault: mean time on the slow platform - factor x mean time on the fast one."""

    def test(runs: Runs) -> Evidence:
        own = compared(runs).where(setting=FI)
        scaled = own.where(environment=FAST).adding(flight_time_s=factor * pl.col("flight_time_s"))
        found = within_worlds(own.where(environment=SLOW), scaled, pl.col("flight_time_s"), by="seed")
        return tested(found, SLOW, f"{factor:g} x {FAST}", more=True, what="mean flight time", unit=_SECONDS)

    return test


def _same_trend(runs: Runs) -> Evidence:
    """Test of the share of faults that harm."""
    own = leading_faults(runs).where(setting=FI)
    found = within_worlds(own.where(environment=SLOW), own.where(environment=FAST), HURT, by="seed")
    return tested(found, SLOW, FAST, more=True, what="fails or > 5 % longer")


def _redundant(vehicle: str) -> Callable[[Runs], Evidence]:
    """Flight time with TMR by the model; its inputs were calibrated to the claim, so it tests nothing."""

    def test(_: Runs) -> Evidence:
        designs = [design for design in shipped_designs() if design.craft == vehicle]
        found = []
        for design in designs:
            found.append(f"{design.calibration}: {ratio(design, TMR):.3f} (band {between(*band(design, TMR))})")
        return Evidence(
            f"by the model, calibrated to this value after the fact: {'; '.join(found)}", None, supports=True
        )

    return test


def _of_redundancy() -> Iterable[Claim]:
    for name, vehicle in (("redundancy_airsim", "airsim_uav"), ("redundancy_spark", "dji_spark")):
        times = paper.figure("redundancy_time", vehicle=vehicle, scheme=TMR)
        text = f"TMR makes flights of {vehicle} {times:g} times as long as detection does"
        yield Claim(name, text, "VI-C", PLATFORMS, _MODEL, _redundant(vehicle))


def _of_platforms() -> Iterable[Claim]:
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
    factor = float(paper.figure("platforms_worst", quantity="flight_time_ratio"))
    text = f"With a fault, flights on the Cortex-A57 take at least {factor:g} times as long (the paper: the worst)"
    yield Claim("slow_platform_ratio", text, "VI-D", PLATFORMS, WITHIN, _times_as_long(factor))
    yield Claim(
        "platforms_alike", "Faults harm alike on both platforms", "VI-D", PLATFORMS, WITHIN, equality(_same_trend)
    )

    def shorter(setting: str, other: str) -> Callable[[Runs], Evidence]:
        return paired(setting, other, "inflation", more=False, what="flight time over golden", environment=SLOW)

    for arm, short in (("gaussian", "GAD"), ("autoencoder", "AAD")):
        share = paper.figure("platforms_recovered", setting=f"dr_{arm}")
        text = f"On the Cortex-A57 {short} recovers flight time (by {100 * share:.1f} % of the worst)"
        yield Claim(
            f"{arm}_recovers_slow_platform",
            text,
            "VI-D",
            PLATFORMS,
            WITHIN,
            shorter(f"dr_{arm}", FI),
        )
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
