"""`Table`: the result of a view.  Cells hold numbers; `mavfi.report` renders them as text, HTML or files."""

import csv
import html
import io
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, is_dataclass
from typing import Any

import polars as pl

from mavfi.record import plain

RATE = "rate"
PERCENT = "percent"
SIGNED = "signed percent"
SMALL = "small percent"
PER_HOUR = "per hour"
POINTS = "points"
DIFFERENCE = "number difference"
ESTIMATE = "estimate"
NUMBER = "number"
TEXT = "text"
"""Display formats of a cell; a number may have a format specification and a unit: "number .1f s"."""
POINTS_TEST = "points with test"
PERCENT_TEST = "percent with test"
TIMES_TEST = "times with test"
"""Formats of a `worlds.Contrast`: with interval and p."""
UNKNOWN = "unknown"  # a cell whose measure raised an exception
Cell = Any  # None = empty; text, a number, or a dataclass of numbers such as `Rate`


@dataclass(frozen=True, slots=True)
class Column:
    """A column: key in CSV and JSON, heading for display."""

    key: str
    heading: str
    form: str = TEXT  # display format of its cells
    hidden: bool = False  # in CSV and JSON only


@dataclass(frozen=True, slots=True, repr=False)
class Table:
    """A table with headings, rows and notes."""

    name: str  # of its view
    title: str
    columns: tuple[Column, ...]
    rows: Sequence[tuple[Cell, ...]]
    keys: int = 1  # number of leading columns that identify the row
    notes: tuple[str, ...] = ()  # lines below it
    behind: Sequence[tuple[tuple[str, ...], ...]] = ()
    """Ids of the runs behind each cell, by row; () = not known."""

    @staticmethod
    def of_text(title: str, headings: Sequence[str], rows: Sequence[tuple[str, ...]], notes: Sequence[str]) -> "Table":
        """Create a table of text cells, named by its title."""
        columns = tuple(Column(heading, heading) for heading in headings)
        return Table(title, title, columns, rows, notes=tuple(notes))

    def column(self, key: str) -> list[Cell]:
        """Cells of a column.

        Raises:
            KeyError: The column does not exist.
        """
        indices = {column.key: index for index, column in enumerate(self.columns)}
        return [row[indices[key]] for row in self.rows]

    def entries(self) -> list[dict[str, Cell]]:
        """Rows as mappings from column key to cell."""
        keys = [column.key for column in self.columns]
        return [dict(zip(keys, row, strict=True)) for row in self.rows]

    def to_json(self) -> dict[str, Any]:
        """Plain data: name, title, notes, and rows by key; infinities and NaN as text."""
        rows = [{key: _parts(cell) for key, cell in entry.items()} for entry in self.entries()]
        data: dict[str, Any] = plain({"name": self.name, "title": self.title, "rows": rows, "notes": self.notes})
        return data

    @property
    def frame(self) -> pl.DataFrame:
        """The rows as a data frame; a `Rate` is split into columns, e.g. success, success_low, success_n."""
        return pl.DataFrame([_flat(entry) for entry in self.entries()], infer_schema_length=None, strict=False)

    def __repr__(self) -> str:
        return f"{self.title}\n{self.frame}"

    def _repr_html_(self) -> str:
        """The rows in a notebook."""
        return f"<p>{html.escape(self.title)}</p>{self.frame._repr_html_()}"

    def to_csv(self) -> str:
        """Comma-separated values with a header line and the columns of `frame`."""
        flat = [_flat(entry) for entry in self.entries()]
        keys = list(dict.fromkeys(key for entry in flat for key in entry)) or [column.key for column in self.columns]
        buffer = io.StringIO()
        writer = csv.DictWriter(buffer, keys, lineterminator="\n")
        writer.writeheader()
        writer.writerows(flat)
        return buffer.getvalue()


def _flat(entry: dict[str, Cell]) -> dict[str, Cell]:
    """A row with one entry per number: fields of a dataclass cell become columns KEY_FIELD, the rate itself KEY."""
    flat: dict[str, Cell] = {}
    for key, cell in entry.items():
        parts = _parts(cell)
        if parts is not cell:
            for part, value in parts.items():
                column = key if part == "rate" else f"{key}_{part}"
                flat[column] = value
        elif isinstance(cell, (list, tuple, dict)):
            flat[key] = json.dumps(plain(cell))
        else:
            flat[key] = cell
    return flat


def _parts(cell: Cell) -> Cell:
    """Fields of a dataclass cell by name; other cells unchanged."""
    if is_dataclass(cell) and not isinstance(cell, type):
        return asdict(cell)
    return cell
