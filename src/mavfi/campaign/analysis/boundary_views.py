"""Views of faults in the calls of a client program: effects by side and by call."""

import polars as pl

from mavfi.campaign.analysis import measures as m
from mavfi.campaign.analysis.measures import Measure
from mavfi.campaign.analysis.runs import Runs
from mavfi.campaign.analysis.table import NUMBER
from mavfi.campaign.analysis.views import View, has, register

_EFFECTS = {
    "masked": ("masked", pl.col("effect") == "masked"),
    "deviates": ("deviates", (pl.col("effect") == "sdc") & (pl.col("status") != "collision")),
    "collides": ("collision", (pl.col("effect") == "sdc") & (pl.col("status") == "collision")),
    "exception": ("program crash", pl.col("effect") == "exception"),
    "hang": ("hang", pl.col("effect") == "hang"),
}
_INTERVALS = "per cent of the runs whose fault was activated, [95 % interval, Wilson], count"
_MOST = 20
_JUDGED = pl.col("effect").is_in(["masked", "sdc", "exception", "hang"])


def _applies(runs: Runs) -> bool:
    return has(runs.injected, level="message")


def _runs(runs: Runs) -> Runs:
    return runs.injected.where(level="message").adding(side=pl.col("target"), call=pl.col("state"))


_COLUMNS = (
    Measure("n", "runs", NUMBER, lambda own: len(own.where(_JUDGED))),
    *(m.wilson_rate(key, heading, test, _JUDGED) for key, (heading, test) in _EFFECTS.items()),
    m.count("not_activated", "not activated", effect="not_activated"),
    m.count("unknown", "not judged", effect="unknown"),
)

register(
    View(
        "boundary_effects", "What one bit in a call does to a program", ("side",), _COLUMNS,
        where=_runs, total=("side", "both"), notes=lambda runs: (_INTERVALS,), applies=_applies,
    ),
    View(
        "boundary_calls", "By call", ("call", "side"), _COLUMNS, where=_runs, limit=_MOST, largest="n",
        applies=_applies,
    ),
)  # fmt: skip
