"""Claims of the paper's text, each with a test on runs (see `claims`); all tests treat worlds as independent."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import polars as pl

from mavfi.analysis import measures as m
from mavfi.analysis.rows import ACTIVATED
from mavfi.analysis.runs import Runs
from mavfi.campaign.plan import FI
from mavfi.extras.paper.claims import Claim, Evidence
from mavfi.extras.paper.views import by_bits
from mavfi.extras.paper.worlds import Difference, Mean, between_worlds, within_worlds
from mavfi.plugins import Chapter

KERNELS, STATES, INSTRUCTIONS, VALUES = "kernels", "states", "table1_instructions", "table1"
"""Names of the campaigns used in the tests."""
HURT, SUCCESS = m.FAILS_OR_SLOWER, pl.col("success")
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
    select: Callable[[Runs], Runs], first: tuple[str, pl.Expr], second: tuple[str, pl.Expr], value: pl.Expr, *,
    more: bool, what: str,
) -> Callable[[Runs], Evidence]:  # fmt: skip
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


def paired(
    setting: str, other: str, column: str, *, more: bool, what: str, **where: str
) -> Callable[[Runs], Evidence]:  # fmt: skip
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
    dense, others = own.where(environment="dense"), own.where(pl.col("environment") != "dense")
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


_BITS = {name: (words, _of("bits", *bits)) for name, words, bits in (
    ("high", "sign and exponent", ("sign", "exponent")), ("low", "mantissa", ("mantissa",)))}  # fmt: skip


Row = tuple[str, str, Callable[[Runs], Evidence]]
"""Name, statement and test of a claim."""


def _claims(section: str, campaign: str, *rows: Row, method: str = WITHIN) -> list[Claim]:
    """Claims of one section of the paper that are tested on one campaign by one method."""
    return [Claim(name, statement, section, campaign, method, test) for name, statement, test in rows]


def _of_kernels() -> list[Claim]:
    check, before = _of("kernel", "collision_check"), _of("kernel", "point_cloud", "octomap")
    critical = _compared(
        _faults, ("collision check", check), ("point cloud and OctoMap", before), HURT, more=True, what=_HURT
    )
    wider = _compared(_faults, _LATER, _PERCEPTION, ALTERED, more=True, what="flight time changed by > 5 %")
    return _claims(
        "III-A", KERNELS,
        (
            "perception_least_critical", "The perception stage is the least critical",
            _compared(_faults, _PERCEPTION, _LATER, HURT, more=False, what=_HURT),
        ),
        ("collision_check_critical", "Collision check is the critical kernel within perception", critical),
        (
            "planning_control_flight_time", "Flight time ranges wider with faults in planning and control", wider,
        ),
        (
            "clouds_and_maps_negligible",
            "Faults in point cloud and OctoMap lose no missions (little to negligible impact)", equality(_lost(before)),
        ),
        (
            "planning_control_success", "Faults in planning and control lower the success rate (by up to 8 %)",
            _lost(_LATER[1]),
        ),
    )  # fmt: skip


def _of_states() -> list[Claim]:
    sequence, time = "future_collision_seq", "time_to_collision"
    robust = _compared(
        _faults, (sequence, _of("target", sequence)), (time, _of("target", time)), HURT, more=False, what=_HURT
    )
    waypoints = _of("target", "waypoint position", "waypoint yaw", "waypoint velocity")

    def by_class(value: pl.Expr, what: str) -> Callable[[Runs], Evidence]:
        return _compared(by_bits, _BITS["high"], _BITS["low"], value, more=True, what=what)

    more = "Faults in sign and exponent fields increase"
    return _claims(
        "III-B", STATES,
        ("collision_seq_robust", f"{sequence} is much more robust than {time}", robust),
        (
            "sign_exponent_matter_most", "Faults in sign and exponent fields have a greater impact",
            by_class(HURT, _HURT),
        ),
        (
            "sign_exponent_flight_time", f"{more} flight time more",
            by_class(pl.col("inflation"), "flight time over golden"),
        ),
        ("sign_exponent_energy", f"{more} energy more", by_class(pl.col("energy_inflation"), "energy over golden")),
        ("sign_exponent_failures", f"{more} failures more", by_class(~SUCCESS, "fails")),
        (
            "waypoints_harm",
            "Faults in position, yaw and velocity of way-points lead to crashes or longer flights (cannot be "
            "contradicted)", _above_golden(HURT, _HURT, waypoints),
        ),
    )  # fmt: skip


def _of_success(campaign: str, level: str, end: str) -> list[Claim]:
    """Claims of Table I on the effects of faults of one level, and on what the detectors recover."""
    table, longer = f"Table I, faults in {level}", "flight time over golden"
    gaussian, autoencoder = "dr_gaussian", "dr_autoencoder"
    within = _claims(
        "VI-A", campaign,
        (f"fault_loses_missions{end}", f"{table}: one fault lowers the success rate", _lost()),
        (
            f"fault_lengthens_flights{end}", f"{table}: flights that succeed take longer (the worst by 63 to 93 %)",
            _above_golden(pl.when("success").then("inflation"), longer),
        ),
        (
            f"gaussian_recovers{end}", f"{table}: GAD recovers failed missions",
            paired(gaussian, FI, "success", more=True, what="success"),
        ),
        (
            f"autoencoder_recovers{end}", f"{table}: AAD recovers failed missions",
            paired(autoencoder, FI, "success", more=True, what="success"),
        ),
        (
            f"autoencoder_beats_gaussian{end}", f"{table}: AAD recovers more than GAD",
            paired(autoencoder, gaussian, "success", more=True, what="success"),
        ),
        (
            f"autoencoder_like_golden{end}", f"{table}: with AAD as many missions succeed as without a fault",
            equality(_lost(setting=autoencoder)),
        ),
        (
            f"autoencoder_shortens_more{end}", f"{table}: AAD recovers more flight time than GAD",
            paired(autoencoder, gaussian, "inflation", more=False, what=longer),
        ),
        (
            f"gaussian_shortens_flights{end}", f"{table}: GAD recovers flight time",
            paired(gaussian, FI, "inflation", more=False, what=longer),
        ),
        (
            f"autoencoder_shortens_flights{end}", f"{table}: AAD recovers flight time",
            paired(autoencoder, FI, "inflation", more=False, what=longer),
        ),
    )  # fmt: skip
    between = _claims(
        "VI-A", campaign,
        (f"dense_hardest{end}", f"{table}: Dense loses most missions (9.7 points)", _hardest),
        (f"dense_hardest_to_recover{end}", f"{table}: Dense is the hardest to recover", _hardest_to_recover),
        method=_BETWEEN,
    )  # fmt: skip
    return within + between


_MISSED = "Table I, faults in states: in Dense most faults go undetected"
MISSIONS = Chapter(10, (
    *_of_kernels(), *_of_states(), *_of_success(INSTRUCTIONS, "instructions", ""),
    *_of_success(VALUES, "states", "_in_states"),
    *_claims("VI-A", VALUES, ("dense_most_missed_in_states", _MISSED, _most_missed), method=_BETWEEN),
))  # fmt: skip
