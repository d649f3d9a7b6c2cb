"""The runs of a campaign as a table with one row per run, with filters."""

from collections.abc import Sequence

import polars as pl

from mavfi.campaign.analysis.rows import ACTIVATED
from mavfi.campaign.analysis.runs import Runs
from mavfi.campaign.analysis.table import NUMBER, SIGNED, TEXT, Column, Table
from mavfi.errors import BadInputError

_COLUMNS = (
    Column("run_id", "run"), Column("status", "status"), Column("flight_time_s", "flight time", "number .1f s"),
    Column("inflation", "against golden", SIGNED), Column("effect", "effect"),
    Column("alarms_total", "alarms", NUMBER), Column("bit", "bit", NUMBER), Column("site", "site"),
    Column("site_outcome", "injection"), Column("kernel_effect", "kernel"), Column("reason", "reason", TEXT),
)  # fmt: skip
_USUAL = {"kernel_effect": {""}, "site_outcome": {"", ACTIVATED}, "reason": {""}}
"""Values of columns that are hidden if they have no others."""
_SHOWN = 12  # values listed where a condition names one that does not occur
_FLAGS = {"yes": "true", "True": "true", "no": "false", "False": "false"}  # truth values as polars writes them


def listing(runs: Runs, where: Sequence[str] = (), *, failed: bool = False, sort: Sequence[str] = ()) -> Table:
    """List runs in plan order or sorted by columns.  CSV and JSON contain all columns of the frame.

    Listed runs meet all conditions `column=value`; values separated by commas are alternatives.  `failed` selects
    missions that did not succeed, and runs that could not be judged.  `sort` names columns, the primary one first; a
    "-" before a name sorts in descending order, and rows without a value come last.

    Raises:
        BadInputError: A condition is malformed, or a column does not exist.
    """
    tests = [_test(runs, text) for text in where]
    if failed:
        tests.append(~pl.col("success"))
    own = runs.where(*tests)
    frame = _sorted(own.frame, sort)
    empty = [key for key, usual in _USUAL.items() if set(frame[key]) <= usual]
    shown = [column for column in _COLUMNS if column.key not in empty]
    names = {column.key for column in shown}
    hidden = [Column(name, name, TEXT, hidden=True) for name in frame.columns if name not in names]
    columns = (*shown, *hidden)
    rows = frame.select(column.key for column in columns).rows()
    notes = tuple(filter(None, (_absent(runs, text) for text in where)))
    done, planned = (runs.campaign.get(key) for key in ("done", "total"))
    flown = "" if done == planned else f" flown so far, {planned} planned"
    return Table("runs", f"{len(own)} of {len(runs)} runs{flown}", columns, rows, notes=notes)


def _sorted(frame: pl.DataFrame, sort: Sequence[str]) -> pl.DataFrame:
    names = [text.removeprefix("-") for text in sort]
    for name in names:
        if name not in frame.columns:
            raise BadInputError(f"--sort: column {name!r}: not known; allowed: {', '.join(frame.columns)}")
    falling = [text.startswith("-") for text in sort]
    return frame.sort(names, descending=falling, nulls_last=True, maintain_order=True) if names else frame


def _test(runs: Runs, text: str) -> pl.Expr:
    column, is_condition, values = text.partition("=")
    if not is_condition:
        raise BadInputError(f"--where: {text!r}: allowed: column=value, e.g. stage=planning")
    if column not in runs.frame.columns:
        raise BadInputError(f"--where: column {column!r}: not known; allowed: {', '.join(runs.frame.columns)}")
    return pl.col(column).cast(pl.String).is_in(_alternatives(values))


def _alternatives(values: str) -> list[str]:
    return [_FLAGS.get(value, value) for value in values.split(",")]


def _absent(runs: Runs, text: str) -> str:
    """A line on values of a condition that no run of the ledger has, e.g. mistyped ones; "" = none."""
    column, _, values = text.partition("=")
    held = runs.frame[column].cast(pl.String).drop_nulls().unique(maintain_order=True).to_list()
    absent = [value for value in _alternatives(values) if value not in held]
    if not absent:
        return ""
    held = [value for value in held if value]  # runs without a fault have an empty stage
    some = ", ".join(held[:_SHOWN]) + ", ..." * (len(held) > _SHOWN)
    return f"no run has {column} = {', '.join(absent)}; the ledger has: {some or 'none'}"
