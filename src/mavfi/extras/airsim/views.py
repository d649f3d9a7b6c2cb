"""View of a client program: what faults in its calls do."""

import polars as pl

from mavfi.analysis import measures as m
from mavfi.analysis.runs import Runs
from mavfi.analysis.views import View
from mavfi.plugins import Chapter

_OF_CALLS = pl.col("effect").is_in(["masked", "sdc", "exception", "hang"])
"""Activated faults in calls whose effect is known."""
_SILENT = pl.col("effect") == "sdc"
_COLLIDED = pl.col("status") == "collision"


def _of_programs(runs: Runs) -> Runs:
    """Runs with a fault in a call."""
    return runs.injected.where(pl.col("target").is_in(["arguments", "return"]), level="message")


CHAPTER = Chapter(
    35,
    (
        View(
            "boundary_effects",
            "What one bit in a call does to a program",
            ("side",),
            (
                m.count("n", "runs", _OF_CALLS),
                m.rate("masked", "masked", pl.col("effect") == "masked", _OF_CALLS),
                m.rate("deviates", "deviates", _SILENT & ~_COLLIDED, _OF_CALLS),
                m.rate("collides", "collision", _SILENT & _COLLIDED, _OF_CALLS),
                m.rate("exception", "program crash", pl.col("effect") == "exception", _OF_CALLS),
                m.rate("hang", "hang", pl.col("effect") == "hang", _OF_CALLS),
                m.count("not_activated", "not activated", effect="not_activated"),
                m.count("unknown", "not judged", effect="unknown"),
            ),
            where=lambda runs: _of_programs(runs).adding(side=pl.col("target")),
            total=("side", "both"),
            applies=lambda runs: len(_of_programs(runs)) > 0,
            notes=lambda _: (
                "per cent of the runs whose fault was activated, [95 % interval: Wilson, n reduced by the design "
                "effect of worlds], count",
            ),
        ),
    ),
)
