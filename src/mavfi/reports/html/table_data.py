"""Tables as a page shows them: cells as text, each with a link to the runs behind it."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from mavfi.campaign.analysis.table import TEXT, Table
from mavfi.reports.text import ABSENT, cell

_INTERVAL = re.compile(r"^(\S+) (\[.*)$")


@dataclass(slots=True)
class RunSets:
    """Sets of runs that cells link to, each stored once.

    Attributes:
        places: Place of each run in the list of runs, by id.
    """

    places: Mapping[str, int]
    texts: dict[str, int] = field(default_factory=dict)

    def link(self, run_ids: Sequence[str]) -> str:
        """Address of a set within the page; "" = no run."""
        places = sorted(self.places[run_id] for run_id in run_ids if run_id in self.places)
        return f"#runs?set={self.texts.setdefault(_ranges(places), len(self.texts))}" if places else ""


def _ranges(places: Sequence[int]) -> str:
    """Ascending numbers as ranges: "0-29 45"."""
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
    behind = table.behind or [((),) * len(table.columns)] * len(table.rows)
    rows = []
    before: list[str] = []
    for row, ids in zip(table.rows, behind, strict=True):
        cells = []
        for place in shown:
            column = table.columns[place]
            text = cell(row[place], column.form)
            is_key = place < table.keys
            value, interval = _split(text)
            link = "" if is_key or text == ABSENT or column.form == TEXT else sets.link(ids[place])
            cells.append({"key": is_key, "value": value, "interval": interval, "link": link})
        texts = [entry["value"] for entry in cells]
        repeated = bool(before) and table.keys > 1 and texts[0] == before[0]
        rows.append({"cells": cells, "repeated": repeated})
        before = texts
    columns = [{"heading": table.columns[place].heading, "key": place < table.keys} for place in shown]
    return {
        "name": table.name, "title": table.title, "columns": columns, "rows": rows, "notes": table.notes,
        "csv": table.to_csv(),
    }  # fmt: skip


def _split(text: str) -> tuple[str, str]:
    """A rate and the rest: interval and n."""
    found = _INTERVAL.match(text)
    return (found[1], found[2]) if found else (text, "")
