"""Pages as text: the overview of a folder, a campaign, two campaigns side by side."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import quote

from markupsafe import Markup

from mavfi.analysis.comparison import compare as compare_runs
from mavfi.analysis.runs import Runs
from mavfi.analysis.statistics import Rate
from mavfi.analysis.table import RATE
from mavfi.errors import BadInputError
from mavfi.extras.serve.ledgers import CampaignAnswer, CampaignPace, ReadLedger, Recovered, Stamp
from mavfi.report.html import page
from mavfi.report.html.report_page import RunSets, table_data
from mavfi.report.text import ABSENT, cell

HTML = Path(__file__).parent / "html"
MAX_DETECTORS = 3
"""Detectors that the first screen names, the best ones."""


class ComparedCampaign(NamedTuple):
    """One of two campaigns side by side: its name, its progress, and what was read of it."""

    key: str
    pace: CampaignPace
    read: ReadLedger


class ShownDifferences(NamedTuple):
    """How the second of two campaigns differs from the first: sentences, a table, and keys with both values."""

    sentences: Sequence[str]
    table: Mapping[str, Any] | None
    keys: Mapping[str, tuple[Any, Any]]


class ComparedItem(NamedTuple):
    """A table or a figure of two campaigns; None = one of them has none."""

    kind: str
    title: str
    members: list[Mapping[str, Any] | None]


class Tile(NamedTuple):
    """A number on the first screen, with what it is a share of, its interval, and its counts."""

    heading: str
    value: str
    interval: str
    remark: str


def name_of(folder: Path, key: str) -> str:
    """Name of a campaign: its path in the served folder, or that of the folder itself."""
    return key or folder.resolve().name


def stamp_text(stamp: Stamp) -> str:
    """A stamp as text, for comparing."""
    return "-".join(map(str, stamp))


def tiles(answer: CampaignAnswer) -> list[Tile]:
    """What a campaign answers first; empty if its runs are not flights."""
    first_tiles = []
    if answer.without_fault.n:
        first_tiles.append(_tile("Without a fault", answer.without_fault, "missions succeed"))
    if answer.with_fault.n:
        first_tiles.append(_tile(answer.fault, answer.with_fault, "missions succeed"))
    return [*first_tiles, *map(_recovered_tile, answer.recovered[:MAX_DETECTORS])]


def _tile(heading: str, rate: Rate, noun: str) -> Tile:
    if rate.rate is None:
        return Tile(heading, ABSENT, "", f"0 {noun}")
    value, _, rest = cell(rate, RATE).partition(" ")
    interval, _, _ = rest.rpartition(" ")
    counts = f"{rate.n} {noun}"
    if rate.successes is not None:
        counts = f"{rate.successes} of {counts}"
    return Tile(heading, f"{value} %", interval, counts)


def _recovered_tile(entry: Recovered) -> Tile:
    tile = _tile(f"{entry.arm} brings back", entry.rate, "lost missions")
    return tile._replace(remark=f"{tile.remark}, newly loses {entry.newly_lost}")


def _render(template: str, **values: Any) -> str:
    return page.render(template, HTML, **values)


def refusal(text: str) -> str:
    """A page with one line."""
    return _render("refusal.html.j2", text=text)


def reading(folder: Path, key: str) -> str:
    """A page that waits for that of a campaign."""
    return _render("reading.html.j2", name=name_of(folder, key))


def overview(folder: Path, keys: Sequence[str]) -> str:
    """The campaigns of a folder; their rows are asked for one after the other."""
    return _render("overview.html.j2", folder=folder, campaigns={key: name_of(folder, key) for key in keys})


def overview_row(pace: CampaignPace, answer: CampaignAnswer) -> str:
    """Cells of a campaign in the overview, behind its name."""
    best = None
    if answer.recovered:
        best = _recovered_tile(answer.recovered[0])
        best = best._replace(remark=f"{answer.recovered[0].arm}: {best.remark}")
    return _render(
        "row.html.j2",
        pace=pace,
        answer=answer,
        without_fault=_tile("", answer.without_fault, "missions"),
        with_fault=_tile("", answer.with_fault, "missions"),
        best=best,
        refusal="",
    )


def refused_row(text: str) -> str:
    """The same for a ledger that cannot be read."""
    return _render("row.html.j2", refusal=text)


def campaign(folder: Path, key: str, pace: CampaignPace, read: ReadLedger, others: Sequence[str]) -> str:
    """The page of a campaign.

    Args:
        folder: The served folder.
        key: Name of the campaign.
        pace: Its progress.
        read: What was read of its ledger.
        others: Names of the campaigns that it can be compared with.
    """
    return _render(
        "campaign.html.j2",
        **read.values,
        flights={},
        key=key,
        pace=pace,
        stamp=stamp_text(read.stamp),
        tiles=tiles(read.answer),
        more_detectors=len(read.answer.recovered) - MAX_DETECTORS,
        others={other: name_of(folder, other) for other in others},
    )


def compare(folder: Path, columns: Sequence[ComparedCampaign]) -> str:
    """Two campaigns side by side: answers and findings, then tables and figures that one of them has, or both."""
    campaigns = []
    rows: dict[tuple[str, str], ComparedItem] = {}
    for index, column in enumerate(columns):
        headline = column.read.values["headline"]
        campaigns.append(
            {
                "key": column.key,
                "name": name_of(folder, column.key),
                "pace": column.pace,
                "tiles": tiles(column.read.answer),
                "lines": headline.lines,
                "findings": column.read.answer.findings,
            }
        )
        for section in column.read.values["sections"]:
            for table in section["tables"]:
                row = rows.setdefault(("table", table["name"]), ComparedItem("table", table["title"], [None] * 2))
                row.members[index] = _linked(table, column.key)
            for figure in section["figures"]:
                row = rows.setdefault(("figure", figure["name"]), ComparedItem("figure", "", [None] * 2))
                row.members[index] = {**figure, "svg": _moved(figure["svg"], index, column.key)}
    differences = _differences(*(column.read.report.runs for column in columns))
    return _render("compare.html.j2", campaigns=campaigns, differences=differences, rows=rows.values())


def _differences(first: Runs, second: Runs) -> ShownDifferences:
    """What `mavfi compare` says of two campaigns; where they have nothing in common, only why."""
    try:
        comparison = compare_runs(first, second)
    except BadInputError as error:
        return ShownDifferences([str(error)], None, {})
    table = None
    if not comparison.are_same:
        table = {**table_data(comparison.table, RunSets({})), "id": ""}
    return ShownDifferences(comparison.sentences, table, comparison.differing)


def _linked(table: Mapping[str, Any], key: str) -> dict[str, Any]:
    """A table whose cells open the runs on the page of their campaign."""
    rows = []
    for table_row in table["rows"]:
        cells = []
        for entry in table_row["cells"]:
            link = entry["link"]
            if link:
                link = f"/campaign/{quote(key)}{link}"
            cells.append({**entry, "link": link})
        rows.append({**table_row, "cells": cells})
    return {**table, "rows": rows}


def _moved(svg: str, index: int, key: str) -> Markup:
    """A figure with ids of its own among several campaigns, whose points open the page of theirs."""
    text = str(svg)
    for start in ('id="s', "url(#s", 'href="#s'):
        text = text.replace(start, f"{start[:-1]}c{index}-s")
    return Markup(text.replace('href="#run', f'href="/campaign/{quote(key)}#run'))  # noqa: S704 - drawn by matplotlib
