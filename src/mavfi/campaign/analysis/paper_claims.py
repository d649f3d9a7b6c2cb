"""Claims of the paper's text, each with a test on runs (see `claims`); all tests treat worlds as independent."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import polars as pl
from scipy.stats import binomtest

from mavfi.campaign.analysis import measures as m
from mavfi.campaign.analysis import paper
from mavfi.campaign.analysis.claims import Claim, Evidence, register
from mavfi.campaign.analysis.paper_views import by_bits, leading_faults
from mavfi.campaign.analysis.runs import Runs
from mavfi.campaign.analysis.worlds import Difference, Mean, between_worlds, within_worlds
from mavfi.campaign.overheads import ALL
from mavfi.campaign.plan import FI

KERNELS, STATES, BITS, INSTRUCTIONS, VALUES = "kernels", "states", "bits", "table1_instructions", "table1"
"""Names of the campaigns used in the tests."""
HURT, SUCCESS = m.FAILS_OR_SLOWER, pl.col("success")
ALTERED = pl.when("success").then(pl.col("inflation").abs() > m.SLOWER)
"""Whether flight time changes by more than 5 %; null for failures."""
LOSS = pl.col("golden_success").cast(pl.Float64) - pl.col("success").cast(pl.Float64)
"""Success lost to the fault: success without it - success with it."""
_WITHIN = "random signs of the differences of worlds"
_SIGNS = "sign test of environments and stages"
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
    """Evidence from a difference, which the claim states to be positive (`more`) or negative."""
    if found is None:
        return Evidence("no runs to compare", None, supports=False)
    here = f"{what}: {unit.text(found.first, one)}, {unit.text(found.second, other)}, {found.worlds} worlds"
    return Evidence(here, found.p_value, (found.difference > 0) == more, found.behind)


def _faults(runs: Runs) -> Runs:
    return leading_faults(runs).where(setting=FI)


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


def _lost(select: pl.Expr | None = None) -> Callable[[Runs], Evidence]:
    """Test of golden runs against the same missions with a fault."""

    def test(runs: Runs) -> Evidence:
        own = _faults(runs).where(pl.col("golden_success").is_not_null())
        own = own if select is None else own.where(select)
        golden = pl.col("golden_success")
        found = within_worlds(own.adding(value=golden), own.adding(value=SUCCESS), pl.col("value"))
        return tested(found, "golden", "fault", more=True, what="success")

    return test


def paired(
    setting: str, other: str, column: str, *, more: bool, what: str, **where: str
) -> Callable[[Runs], Evidence]:  # fmt: skip
    """Paired test of two settings with the same faults; pairs with a null value in either setting are excluded."""

    def test(runs: Runs) -> Evidence:
        own = leading_faults(runs).where(pl.col("setting").is_in((setting, other)), **where)
        pair = ("environment", "target", "index")
        complete = (pl.len().over(pair) == 2) & pl.col(column).is_not_null().all().over(pair)
        own = own.where(complete)
        found = within_worlds(own.where(setting=setting), own.where(setting=other), pl.col(column))
        return tested(found, _WORDS[setting], _WORDS[other], more=more, what=what)

    return test


def _hardest(runs: Runs) -> Evidence:
    own = _faults(runs).where(pl.col("golden_success").is_not_null())
    dense, others = own.where(environment="dense"), own.where(pl.col("environment") != "dense")
    found = between_worlds(dense, others, LOSS)
    return tested(found, "Dense", "other environments", more=True, what="success lost to a fault")


def _overhead(setting: str, bound: float) -> Callable[[Runs], Evidence]:
    """Test of the overhead (recomputation / compute time, by run, in modelled time) against an upper bound."""

    def test(runs: Runs) -> Evidence:
        own = runs.where("judged", setting=setting)
        shares = {run_id: _recomputed(runs, run_id) for run_id in own["run_id"]}
        known = own.adding(value=pl.col("run_id").replace_strict(shares, return_dtype=pl.Float64))
        found = within_worlds(known, known.adding(value=pl.lit(bound)), pl.col("value"))
        if found is None:
            return Evidence("no runs", None, supports=False)
        here = f"{Unit('%', 100.0, '.3g').text(found.first)} of compute time, {found.worlds} worlds"
        return Evidence(here, found.p_value, found.difference < 0, found.behind)

    return test


def _measured_overhead(arm: str, bound: float) -> Callable[[Runs], Evidence]:
    """Test of measured detection and recovery, as shares of the kernels' time by stage, against an upper bound."""

    def test(runs: Runs) -> Evidence:
        rows = [row for row in runs.campaign.get("overheads", {}).get("rows", ()) if row["arm"] == arm]
        shares = [row["detection"] + row["recovery"] for row in rows if row["stage"] != ALL]
        if not shares:
            return Evidence("not measured", None, supports=False)
        above, places = sum(share > bound for share in shares), len({row["environment"] for row in rows})
        here = f"{100 * sum(shares) / places:.3g} % of the kernels' time, mean of {places} environments; in {above} of "
        here += f"{len(shares)} environments and stages one stage alone exceeds it"
        return Evidence(here, float(binomtest(above, len(shares)).pvalue), supports=2 * above < len(shares))

    return test


def _recomputed(runs: Runs, run_id: str) -> float | None:
    record = runs.records[run_id]
    spent = sum(record.recompute_us.values())
    compute = sum(record.compute_us.values()) - spent
    return spent / compute if compute else None


def _largest(name: str, setting: str) -> float:
    """The paper's largest recomputation overhead of a detector over environments, summed over stages."""
    stages = [
        paper.figure(name, environment=place, setting=setting, stage=stage)
        for place in ("factory", "farm", "sparse", "dense")
        for stage in ("perception", "planning", "control")
    ]
    return max(float(sum(stages[place : place + 3])) for place in range(0, len(stages), 3))  # fmt: skip


_BITS = {name: (words, _of("bits", *bits)) for name, words, bits in (
    ("high", "sign and exponent", ("sign", "exponent")), ("low", "mantissa", ("mantissa",)))}  # fmt: skip


def _of_kernels() -> Iterable[Claim]:
    yield Claim(
        "perception_least_critical",
        "The perception stage is the least critical",
        "III-A",
        KERNELS,
        _WITHIN,
        _compared(_faults, _PERCEPTION, _LATER, HURT, more=False, what=_HURT),
    )
    yield Claim(
        "collision_check_critical",
        "Collision check is the critical kernel within perception",
        "III-A",
        KERNELS,
        _WITHIN,
        _compared(
            _faults,
            ("collision check", _of("kernel", "collision_check")),
            ("point cloud and OctoMap", _of("kernel", "point_cloud", "octomap")),
            HURT,
            more=True,
            what=_HURT,
        ),
    )
    yield Claim(
        "planning_control_flight_time",
        "Flight time ranges wider with faults in planning and control",
        "III-A",
        KERNELS,
        _WITHIN,
        _compared(_faults, _LATER, _PERCEPTION, ALTERED, more=True, what="flight time changed by > 5 %"),
    )
    yield Claim(
        "planning_control_success",
        "Faults in planning and control lower the success rate (by up to 8 %)",
        "III-A",
        KERNELS,
        _WITHIN,
        _lost(_LATER[1]),
    )


def _of_states() -> Iterable[Claim]:
    yield Claim(
        "collision_seq_robust",
        "future_collision_seq is much more robust than time_to_collision",
        "III-B",
        STATES,
        _WITHIN,
        _compared(
            _faults,
            ("future_collision_seq", _of("target", "future_collision_seq")),
            ("time_to_collision", _of("target", "time_to_collision")),
            HURT,
            more=False,
            what=_HURT,
        ),
    )
    yield Claim(
        "sign_exponent_matter_most",
        "Faults in sign and exponent fields have a greater impact",
        "III-B",
        BITS,
        _WITHIN,
        _compared(by_bits, _BITS["high"], _BITS["low"], HURT, more=True, what=_HURT),
    )


def _of_success() -> Iterable[Claim]:
    for campaign, level, end in ((INSTRUCTIONS, "instructions", ""), (VALUES, "states", "_in_states")):
        words = f"Table I, faults in {level}"
        yield Claim(
            f"fault_loses_missions{end}",
            f"{words}: one fault lowers the success rate",
            "VI-A",
            campaign,
            _WITHIN,
            _lost(),
        )
        yield Claim(
            f"dense_hardest{end}",
            f"{words}: Dense loses most missions (9.7 points)",
            "VI-A",
            campaign,
            _BETWEEN,
            _hardest,
        )
        for arm, short in (("gaussian", "GAD"), ("autoencoder", "AAD")):
            yield Claim(
                f"{arm}_recovers{end}",
                f"{words}: {short} recovers failed missions",
                "VI-A",
                campaign,
                _WITHIN,
                paired(f"dr_{arm}", FI, "success", more=True, what="success"),
            )
        yield Claim(
            f"autoencoder_beats_gaussian{end}",
            f"{words}: AAD recovers more than GAD",
            "VI-A",
            campaign,
            _WITHIN,
            paired("dr_autoencoder", "dr_gaussian", "success", more=True, what="success"),
        )
        for arm, short in (("gaussian", "GAD"), ("autoencoder", "AAD")):
            yield Claim(
                f"{arm}_shortens_flights{end}",
                f"{words}: {short} recovers flight time",
                "VI-A",
                campaign,
                _WITHIN,
                paired(f"dr_{arm}", FI, "inflation", more=False, what="flight time over golden"),
            )


def _of_overhead() -> Iterable[Claim]:
    for arm, short in (("gaussian", "GAD"), ("autoencoder", "AAD")):
        bound = _largest("recompute_overhead", "dr_gaussian") if arm == "gaussian" else paper.figure(
            "detection_overhead", setting="dr_autoencoder", environment="dense")  # fmt: skip
        text = f"Recomputation of {short} takes at most {100 * bound:.4g} % of compute time, both modelled"
        yield Claim(f"{arm}_overhead", text, "VI-C", INSTRUCTIONS, _WITHIN, _overhead(f"dr_{arm}", bound))
        text = f"Detection and recovery by {short} take at most {100 * bound:.4g} % of compute time, measured here"
        yield Claim(f"{arm}_overhead_measured", text, "VI-C", VALUES, _SIGNS, _measured_overhead(arm, bound))


register(*_of_kernels(), *_of_states(), *_of_success(), *_of_overhead())
