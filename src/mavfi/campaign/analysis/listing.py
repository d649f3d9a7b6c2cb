"""The runs of a campaign as a table: one row for each, with filters."""

from collections.abc import Sequence

import polars as pl

from mavfi.campaign.analysis.runs import Runs
from mavfi.campaign.analysis.table import NUMBER, SIGNED, TEXT, Column, Table
from mavfi.errors import BadInputError

_COLUMNS = (
    Column("run_id", "run"), Column("site", "site"), Column("bit", "bit", NUMBER),
    Column("site_outcome", "injection"), Column("effect", "effect"), Column("status", "status"),
    Column("flight_time_s", "flight time", "number .1f s"), Column("inflation", "against golden", SIGNED),
    Column("alarms_total", "alarms", NUMBER),
)  # fmt: skip
_NAMES = {column.key for column in _COLUMNS}
_FLAGS = {"yes": "true", "True": "true", "no": "false", "False": "false"}  # truth values as polars writes them


def listing(runs: Runs, where: Sequence[str] = (), *, failed: bool = False) -> Table:
    """Runs in the order of the plan.  All columns of the frame are in CSV and JSON.

    Runs meet all conditions `column=value`; values separated by commas are alternatives.  `failed` selects missions
    that did not succeed, and runs that could not be judged.

    Raises:
        BadInputError: A text is no condition, or there is no such column.
    """
    tests = [_test(runs, text) for text in where]
    if failed:
        tests.append(~pl.col("success"))
    own = runs.where(*tests)
    hidden = [Column(name, name, TEXT, hidden=True) for name in own.frame.columns if name not in _NAMES]
    columns = (*_COLUMNS, *hidden)
    rows = own.frame.select(column.key for column in columns).rows()
    return Table("runs", f"{len(own)} of {len(runs)} runs", columns, rows)


def _test(runs: Runs, text: str) -> pl.Expr:
    column, is_condition, values = text.partition("=")
    if not is_condition:
        raise BadInputError(f"--where: {text!r}: allowed: column=value, e.g. stage=planning")
    if column not in runs.frame.columns:
        raise BadInputError(f"--where: column {column!r}: not known; allowed: {', '.join(runs.frame.columns)}")
    return pl.col(column).cast(pl.String).is_in([_FLAGS.get(value, value) for value in values.split(",")])
