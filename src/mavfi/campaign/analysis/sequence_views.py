"""View of campaigns that sample until their success rates reach a target half-width."""

from typing import Any

import polars as pl

from mavfi.campaign.analysis import measures as m
from mavfi.campaign.analysis.measures import Measure
from mavfi.campaign.analysis.runs import Runs
from mavfi.campaign.analysis.statistics import Rate
from mavfi.campaign.analysis.table import RATE
from mavfi.campaign.analysis.views import View, register

_SCHEMA: dict[str, Any] = {
    "environment": pl.String, "setting": pl.String, "target": pl.String, "stratum": pl.String, "n": pl.Int64,
    "mean": pl.Float64, "low": pl.Float64, "high": pl.Float64,
}  # fmt: skip


def _cells(runs: Runs) -> Runs:
    return Runs(pl.DataFrame(runs.campaign.get("sequence", []), schema=_SCHEMA), campaign=runs.campaign)


def _half_width(own: Runs) -> float:
    return float(own.first("high") - own.first("low")) / 2


def _notes(runs: Runs) -> tuple[str, ...]:
    target = 100 * runs.campaign["until_halfwidth"]
    return (
        f"an environment is flown until all of its half-widths are at most {target:g} points",
        "95 % confidence sequence (beta-binomial mixture, Howard et al. 2021) over missions: holds at every number of "
        "missions at once, so that stopping early does not bias it; intervals of other tables are for a fixed n",
        "n: missions; each counts with its share of successes",
    )


register(
    View(
        "sequence", "Success rates with intervals valid at any stopping time",
        ("environment", "setting", "target", "stratum"),
        (
            m.first("n", "n"),
            Measure("success", "success %", RATE,
                    lambda own: Rate(own.first("n"), own.first("mean"), own.first("low"), own.first("high"))),
            Measure("half_width", "± points", "points each way", _half_width),
        ),
        where=_cells,
        headings=("environment", "setting", "target", "bits"), notes=_notes,
        applies=lambda runs: bool(runs.campaign.get("sequence")), any_time=True,
    ),
)  # fmt: skip
