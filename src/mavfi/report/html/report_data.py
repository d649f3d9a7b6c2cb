"""What a page shows of a campaign: tables, runs and figures, with links to the runs behind them."""

import io
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from html import escape, unescape
from typing import Any
from urllib.parse import parse_qsl

import polars as pl
from markupsafe import Markup
from matplotlib import rc_context
from matplotlib.figure import Figure

from mavfi.analysis.runs import Runs
from mavfi.analysis.table import TEXT, Table
from mavfi.report import links, style
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


# ---- runs, stored by column; text columns are dictionary-encoded -----------------------------------------------------

FILTERS = {
    "folder": "ledger", "environment": "environment", "setting": "arm", "status": "status", "effect": "effect",
    "level": "level", "stage": "stage", "place": "kernel or state", "field": "field", "bit": "bit",
    "bit_class": "bit class",
}  # fmt: skip
"""Filter columns with their labels."""
NUMBERS = {"flight_time_s": 2, "inflation": 4, "alarms_total": 0, "time_s": 3}
"""Numeric columns with their number of decimals."""


def run_list(ledgers: Mapping[str, Runs]) -> dict[str, Any]:
    """Ids and the columns in `FILTERS` and `NUMBERS` of all runs; `ledgers` is keyed by folder."""
    frames = [runs.frame.with_columns(folder=pl.lit(folder)) for folder, runs in ledgers.items()]
    frame = pl.concat(frames).with_columns(
        place=pl.when(pl.col("state") != "").then(pl.col("state")).otherwise(pl.col("kernel")),
        status=pl.col("status").str.replace_all("_", " "),
        bit=pl.col("bit").cast(pl.String).fill_null(""),
    )
    texts = {name: _coded(frame[name]) for name in FILTERS}
    numbers = {name: _rounded(frame[name], digits) for name, digits in NUMBERS.items()}
    return {"ids": frame["run_id"].to_list(), "texts": texts, "numbers": numbers, "filters": FILTERS}


def _coded(column: pl.Series) -> dict[str, Any]:
    values = column.unique(maintain_order=True).to_list()
    places = {value: place for place, value in enumerate(values)}
    return {"values": values, "codes": [places[value] for value in column]}


def _rounded(column: pl.Series, digits: int) -> list[float | None]:
    return [None if value is None else round(value, digits) if digits else int(value) for value in column]


# ---- figures as inline SVG: text remains text, colours follow the theme, points link to their runs -------------------

_COLOURS = {
    style.INK: "ink", style.GREY: "soft", style.PALE: "line", style.BLUE: "golden", style.ORANGE: "injected",
    style.GREEN: "recovered", style.PURPLE: "purple", style.AMBER: "amber", "#ffffff": "paper", "#000000": "ink",
}  # fmt: skip
"""Style sheet variables by colour."""


def svg_of(figure: Figure, name: str, caption: str, sets: RunSets) -> Markup:
    """Convert a figure to an SVG element.

    Args:
        figure: The figure.
        name: Prefix of ids, unique within the page.
        caption: Label for screen readers.
        sets: Sets of runs of the page, to which those behind points are added.
    """
    buffer = io.StringIO()
    with rc_context({"svg.fonttype": "none", "svg.hashsalt": "mavfi"}):
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None}, transparent=True)
    text = buffer.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = re.sub(
        rf'\bid="{links.DOTS}([^"]*)"', lambda found: f'class="dots" data-runs="{sets.ordered(found[1].split())}"', text
    )
    text = re.sub(r'(\bid="|url\(#|href="#)(?!runs\?|run/)', rf"\g<1>{name}-", text)
    for colour, variable in _COLOURS.items():
        text = re.sub(re.escape(colour), f"var(--{variable})", text, flags=re.IGNORECASE)
    text = re.sub(r'<a xlink:href="(#runs?[?/][^"]*)" target="_blank"', lambda found: _link(found[1], sets), text)
    # without its height it scales; the style sheet limits the scale, so that the text of all figures has one size
    text = re.sub(r'(<svg[^>]*?) height="[^"]*"', r"\1", text, count=1)
    text = re.sub(r'(<svg[^>]*?) width="([^"]*)"', r'\1 style="--drawn: \2"', text, count=1)
    label = escape(caption, quote=True)
    return Markup(text.replace("<svg ", f'<svg role="group" aria-label="{label}" ', 1))  # noqa: S704 - from matplotlib


def _link(link: str, sets: RunSets) -> str:
    """Rewrite a link of `figures.links` for the page, with a label for screen readers."""
    if link.startswith(links.RUN):
        return f'<a href="{link}" aria-label="run {link.removeprefix(links.RUN)}"'
    label = dict(parse_qsl(unescape(link).removeprefix(links.RUNS)))
    run_ids = label.pop(links.IDS).split()
    values = ", ".join(f"{key.replace('_', ' ')} {value}" for key, value in label.items())
    count = "1 run" if len(run_ids) == 1 else f"{len(run_ids)} runs"
    return f'<a href="{sets.link(run_ids)}" aria-label="{escape(f"{count}: {values}", quote=True)}"'
