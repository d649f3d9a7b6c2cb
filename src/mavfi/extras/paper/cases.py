"""Fig. 7: rule-based selection of the runs of a ledger whose paths are drawn, which excludes hand-picking."""

from dataclasses import dataclass
from typing import Any

import polars as pl

from mavfi.analysis.measures import against_fi
from mavfi.analysis.rows import ACTIVATED
from mavfi.analysis.runs import Runs
from mavfi.campaign.plan import FI

ENVIRONMENT = "dense"
LEAST = 0.01
"""Smallest reduction that counts as shortened, as a fraction of the golden run's flight time."""
STAGES = ("perception", "planning")
RULE = (
    "Of the activated faults of a stage with which the mission succeeds and a detector's flight does, too, the one of "
    "whose added flight time a detector saves most; where it is below 1 %, of the missions that a detector saves the "
    "one with the longest way; else, of the missions lost, that one; else the fault that adds most flight time."
)


@dataclass(frozen=True, slots=True)
class Case:
    """Run ids of one fault: golden run, run with the fault, and run with the fault and a detector."""

    stage: str
    environment: str
    golden: str
    fault: str
    recovered: str  # "" = no detector flew
    arm: str  # of `recovered`
    inflation: float | None  # relative increase of flight time with the fault; None = the mission failed
    recovered_inflation: float | None


def path_cases(runs: Runs) -> list[Case]:
    """Select one case per stage by `RULE`, in Dense or else the last environment."""
    environments = runs.values("environment")
    if not environments:
        return []
    own = runs.where(environment=ENVIRONMENT if ENVIRONMENT in environments else environments[-1])
    return [case for stage in STAGES if (case := _case(own, stage)) is not None]


def _case(own: Runs, stage: str) -> Case | None:
    faults = own.where("judged", "golden_success", stage=stage, site_outcome=ACTIVATED)
    alone = faults.where(setting=FI)
    if not len(alone):
        return None
    watched = against_fi(faults).frame.filter("dr_success")
    # at most what the fault adds: a false alarm can lead to another, shorter way
    gain = pl.col("inflation") - pl.col("dr_inflation").clip(lower_bound=0.0)
    shortened = watched.filter("fi_success", gain >= LEAST).sort(-gain, "run_id", "arm")
    saved = watched.filter(~pl.col("fi_success")).sort(-pl.col("distance_m"), "run_id", "arm")
    row: dict[str, Any] | None = next((found.row(0, named=True) for found in (shortened, saved) if len(found)), None)
    if row is None:
        lost = alone.frame.filter(~pl.col("success")).sort(-pl.col("distance_m"), "run_id")
        slowest = alone.frame.sort("inflation", "run_id", descending=[True, False], nulls_last=True)
        arm = next((arm for arm in faults.values("arm") if arm), "")
        row = {**(lost if len(lost) else slowest).row(0, named=True), "dr_inflation": None, "arm": arm}
    arm = str(row["arm"])
    golden = own.golden.where(arm="", world=row["world"])
    again = faults.where(arm=arm, target=row["target"], index=row["index"]) if arm else None
    recovered = again.first("run_id") if again is not None and len(again) else ""
    return Case(
        stage, own.first("environment"), golden.first("run_id"), str(row["run_id"]), recovered, arm,
        row["inflation"], row["dr_inflation"],
    )  # fmt: skip
