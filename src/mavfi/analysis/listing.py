"""The runs of a campaign as a table with one row per run."""

import polars as pl

from mavfi.analysis.rows import ACTIVATED
from mavfi.analysis.runs import Runs
from mavfi.analysis.table import NUMBER, SIGNED, TEXT, Column, Table

_COLUMNS = (
    Column("run_id", "run"), Column("status", "status"), Column("flight_time_s", "flight time", "number .1f s"),
    Column("inflation", "against golden", SIGNED), Column("effect", "effect"),
    Column("alarms_total", "alarms", NUMBER), Column("bit", "bit", NUMBER), Column("site", "site"),
    Column("site_outcome", "injection"), Column("kernel_effect", "kernel"), Column("reason", "reason", TEXT),
)  # fmt: skip
_USUAL = {"kernel_effect": {""}, "site_outcome": {"", ACTIVATED}, "reason": {""}}
"""Values of columns that are hidden if they have no others."""


def listing(runs: Runs, *, failed: bool = False) -> Table:
    """List runs in plan order.  CSV and JSON contain all columns of the frame.

    `failed` selects missions that did not succeed, and runs that could not be judged.
    """
    listed = runs.where(~pl.col("success")) if failed else runs
    frame = listed.frame
    empty = [key for key, usual in _USUAL.items() if set(frame[key]) <= usual]
    shown = [column for column in _COLUMNS if column.key not in empty]
    names = {column.key for column in shown}
    hidden = [Column(name, name, TEXT, hidden=True) for name in frame.columns if name not in names]
    columns = (*shown, *hidden)
    rows = frame.select(column.key for column in columns).rows()
    done, planned = (runs.campaign.get(key) for key in ("done", "total"))
    flown = "" if done == planned else f" flown so far, {planned} planned"
    return Table("runs", f"{len(listed)} of {len(runs)} runs{flown}", columns, rows)
