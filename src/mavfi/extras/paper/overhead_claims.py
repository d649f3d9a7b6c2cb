"""Claims of the paper's section VI-C on the overhead of detection and of recovery, modelled and measured."""

from collections.abc import Callable, Iterable

import polars as pl
from scipy.stats import binomtest

from mavfi.analysis import published as paper
from mavfi.analysis.measures import recomputed_share
from mavfi.analysis.runs import Runs
from mavfi.extras.paper.claims import Claim, Evidence
from mavfi.extras.paper.mission_claims import INSTRUCTIONS, VALUES, WITHIN, Unit, tested
from mavfi.extras.paper.overhead_views import ALL
from mavfi.extras.paper.worlds import within_worlds
from mavfi.plugins import Chapter
from mavfi.states import Stage

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
        above, count = sum(share > bound for share in spent), len(spent)
        here = f"{100 * sum(spent) / count:.3g} % of the kernels' time, mean of {count} flights; above it in {above}"
        return Evidence(here, float(binomtest(above, count).pvalue), supports=2 * above < count)

    return test


def _timed(runs: Runs, arm: str) -> dict[tuple[str, int], tuple[float, float]]:
    """Measured detection and recovery of an arm's golden flights, by environment and number of the flight."""
    rows = runs.campaign.get("overheads", {}).get("rows", ())
    return {
        (row["environment"], flight): (shares[0], shares[1])
        for row in rows if row["arm"] == arm and row["stage"] == ALL
        for flight, shares in enumerate(row.get("flights", ()))
    }  # fmt: skip


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
        p_value = float(binomtest(above, above + below).pvalue) if above + below else 1.0
        means = (f"{name} {100 * sum(own[one] for one in shared) / len(shared):.3g} %"
                 for name, own in (("AAD", aad), ("GAD", gad)))  # fmt: skip
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
    return max(float(sum(stages[place : place + 3])) for place in range(0, len(stages), 3))  # fmt: skip


def _of_overhead() -> Iterable[Claim]:
    for arm, short in (("gaussian", "GAD"), ("autoencoder", "AAD")):
        bound = _largest("recompute_overhead", "dr_gaussian") if arm == "gaussian" else paper.figure(
            "detection_overhead", setting="dr_autoencoder", environment="dense")  # fmt: skip
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


OVERHEADS = Chapter(20, tuple(_of_overhead()))
