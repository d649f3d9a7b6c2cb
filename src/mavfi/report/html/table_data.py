"""Tables as data for a page: cells as text, with links to the runs behind them."""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from mavfi.analysis.table import TEXT, Table
from mavfi.report.style import setting_label
from mavfi.report.text import ABSENT, cell

LONGEST_NAME = 40
"""Longest text of a cell that is shown on one line (characters)."""

_SETTINGS = ("setting", "row")
"""Columns with names of settings, which are shown in words; CSV keeps the names."""
_INTERVAL = re.compile(r"^(\S+) (\[.*)$")


@dataclass(slots=True)
class RunSets:
    """Deduplicated sets of runs to which cells and figures link.

    Attributes:
        places: Index of each run in the list of runs, by id.
        texts: Number of each set, by its text of index ranges.
    """

    places: Mapping[str, int]
    texts: dict[str, int] = field(default_factory=dict)

    def link(self, run_ids: Sequence[str]) -> str:
        """Link to a set of runs within the page; "" = no runs."""
        places = sorted(self.places[run_id] for run_id in run_ids if run_id in self.places)
        return f"#runs?set={self.texts.setdefault(_ranges(places), len(self.texts))}" if places else ""

    def ordered(self, run_ids: Iterable[str]) -> str:
        """Indices of runs in the list of runs, in the given order, as text of ranges.

        Raises:
            KeyError: A run is not listed.
        """
        return _ranges([self.places[run_id] for run_id in run_ids])


def _ranges(places: Sequence[int]) -> str:
    """Format numbers as ranges of ascending ones, in order: "0-29 45"."""
    found: list[list[int]] = []
    for place in places:
        if found and place == found[-1][1] + 1:
            found[-1][1] = place
        else:
            found.append([place, place])
    return " ".join(f"{low}" if low == high else f"{low}-{high}" for low, high in found)


def table_data(table: Table, sets: RunSets) -> dict[str, Any]:
    """Headings, rows of cells (text, interval, link), notes and CSV of a table."""
    shown = [place for place, column in enumerate(table.columns) if not column.hidden]
    kinds = {place: _kind(table, place) for place in shown}
    behind = table.behind or [((),) * len(table.columns)] * len(table.rows)
    rows = []
    for place, (row, ids) in enumerate(zip(table.rows, behind, strict=True)):
        cells = []
        for column in shown:
            text = cell(row[column], table.columns[column].form)
            if table.columns[column].key in _SETTINGS:
                text = setting_label(text)
            value, interval = _split(text)
            link = sets.link(ids[column]) if kinds[column] != "key" and text not in ("", ABSENT) else ""
            cells.append({"kind": kinds[column], "value": value, "interval": interval, "link": link})
        rows.append({"cells": cells, "repeated": place > 0 and row[0] == table.rows[place - 1][0]})
    columns = [
        {"heading": table.columns[place].heading, "kind": kinds[place], "prose": _is_prose(table, place)}
        for place in shown
    ]
    return {
        "name": table.name, "title": table.title, "columns": columns, "rows": rows, "notes": table.notes,
        "csv": table.to_csv(),
    }  # fmt: skip


def _kind(table: Table, place: int) -> str:
    """Kind of a column: "key" identifies the row and has no links; "text" and "number" are aligned left and right."""
    if place < table.keys:
        return "key"
    return "text" if table.columns[place].form == TEXT else "number"


def _is_prose(table: Table, place: int) -> bool:
    """Whether a column holds sentences, which wrap."""
    return any(isinstance(row[place], str) and len(row[place]) > LONGEST_NAME for row in table.rows)


def _split(text: str) -> tuple[str, str]:
    """Split the text of a rate into the value and the rest (interval and n)."""
    found = _INTERVAL.match(text)
    return (found[1], found[2]) if found else (text, "")
