"""The report of one or more campaigns as one HTML file: headline, sections, runs, flights."""

import io
import re
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from html import escape, unescape
from itertools import islice, zip_longest
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import parse_qsl

import polars as pl
from markupsafe import Markup
from matplotlib import rc_context
from matplotlib.figure import Figure

from mavfi.analysis.listing import ordered, partner
from mavfi.analysis.runs import Runs
from mavfi.analysis.table import TEXT, Table
from mavfi.campaign.config import Campaign, load_campaign
from mavfi.campaign.ledger import stored_campaign
from mavfi.campaign.store import FILE, Store
from mavfi.errors import BadInputError, write_text
from mavfi.report import links, style
from mavfi.report.campaign_report import REMARKS, CampaignReport
from mavfi.report.figures import Drawn, drawn
from mavfi.report.html import page
from mavfi.report.style import setting_label
from mavfi.report.text import ABSENT, cell, checks, header

if TYPE_CHECKING:
    from mavfi.report.html.flight_page import FlightPage


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
            if kinds[column] != "key" and text not in ("", ABSENT):
                link = sets.link(ids[column])
            else:
                link = ""
            cells.append({"kind": kinds[column], "value": value, "interval": interval, "link": link})
        rows.append({"cells": cells, "repeated": place > 0 and row[0] == table.rows[place - 1][0]})
    columns = [
        {"heading": table.columns[place].heading, "kind": kinds[place], "prose": _is_prose(table, place)}
        for place in shown
    ]
    return {
        "name": table.name,
        "title": table.title,
        "columns": columns,
        "rows": rows,
        "notes": table.notes,
        "csv": table.to_csv(),
    }


def _kind(table: Table, place: int) -> str:
    """Kind of a column: "key" identifies the row and has no links; "text" and "number" are aligned left and right."""
    if place < table.keys:
        return "key"
    if table.columns[place].form == TEXT:
        return "text"
    return "number"


def _is_prose(table: Table, place: int) -> bool:
    """Whether a column holds sentences, which wrap."""
    return any(isinstance(row[place], str) and len(row[place]) > LONGEST_NAME for row in table.rows)


def _split(text: str) -> tuple[str, str]:
    """Split the text of a rate into the value and the rest (interval and n)."""
    found = _INTERVAL.match(text)
    if found:
        return (found[1], found[2])
    return (text, "")


# ---- runs, stored by column; text columns are dictionary-encoded -----------------------------------------------------

FILTERS = {
    "folder": "ledger",
    "environment": "environment",
    "setting": "arm",
    "status": "status",
    "effect": "effect",
    "level": "level",
    "stage": "stage",
    "place": "kernel or state",
    "field": "field",
    "bit": "bit",
    "bit_class": "bit class",
}
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
    style.INK: "ink",
    style.GREY: "soft",
    style.PALE: "line",
    style.BLUE: "golden",
    style.ORANGE: "injected",
    style.GREEN: "recovered",
    style.PURPLE: "purple",
    style.AMBER: "amber",
    "#ffffff": "paper",
    "#000000": "ink",
}
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


# ---- the report of one or more campaigns as one HTML file: headline, sections, runs, flights -----------------------

LARGEST = 15_000_000
"""Maximum size of a page (bytes)."""
_LONG = 30
"""Tables with more rows than this are collapsed."""


@dataclass(frozen=True, slots=True)
class PageSection:
    """A section of the page: text, tables and figures."""

    title: str
    tables: Sequence[Table] = ()
    figures: Sequence[Drawn] = ()
    text: str = ""


def sections_of(report: CampaignReport) -> list[PageSection]:
    """Sections of a campaign: leading table with leading figure, other figures, and one section per other table."""
    figures = drawn(report.runs)
    (leading, *others) = report.tables or (None,)
    if leading is None:
        sections = []
    else:
        sections = [PageSection(leading.title, [leading], figures[:1])]
    sections += [PageSection("Figures", (), figures[1:])] if figures[1:] else []
    return sections + [PageSection(table.title, [table]) for table in others]


@dataclass(frozen=True, slots=True)
class ReportedCampaign:
    """A campaign of the page, and the folder of its ledger as printed in commands."""

    directory: Path
    report: CampaignReport


@dataclass(frozen=True, slots=True)
class Headline:
    """Text of the first screen; findings by heading ("" = none)."""

    kind: str
    title: str
    lines: Sequence[str]
    findings: Mapping[str, Sequence[str]]


def headline_of(report: CampaignReport) -> Headline:
    """Headline of a campaign."""
    named, *lines = header(report.runs.campaign)
    campaign, _, mission = named.partition(" · ")
    return Headline("campaign", campaign[0].upper() + campaign[1:], [mission, *lines], {"": report.findings})


def write_report_page(
    path: Path,
    parts: Sequence[ReportedCampaign],
    sections: Sequence[PageSection],
    commands: Sequence[tuple[str, str]],
    flights: Iterable[tuple[str, "FlightPage"]] = (),
    *,
    headline: Headline | None = None,
    largest: int = LARGEST,
) -> int:
    """Write the page of one or more campaigns.

    Args:
        path: File to write.
        parts: The campaigns.
        sections: Sections in order; the first one is the headline.
        commands: Descriptions and commands that reproduce the results.
        flights: Run ids and pages, the most illustrative first; embedded until the file is full.
        headline: Text of the first screen; by default that of the first campaign.
        largest: Maximum size of the file (bytes).

    Returns:
        Number of flights in the page.

    Raises:
        BadInputError: The file cannot be written, or exceeds the maximum size even without flights.
    """
    reports = [part.report for part in parts]
    listed = run_list({str(part.directory): part.report.runs for part in parts})
    sets = RunSets({run_id: place for place, run_id in enumerate(listed["ids"])})
    numbered = list(_section_data(sections, sets))
    if len(reports) > 1:
        remarks = ["; ".join(header(report.runs.campaign)) for report in reports]
    else:
        remarks = []
    values: dict[str, Any] = {
        "headline": headline or headline_of(reports[0]),
        "commands": commands,
        "sections": numbered,
        "checks": [*remarks, *(line for report in reports for line in checks(report.runs)), *REMARKS],
        "csv": {table["id"]: table.pop("csv") for section in numbered for table in section["tables"]},
        "runs": listed | {"sets": list(sets.texts)},
    }
    left = largest - len(page.render("report.html.j2", **values, flights={}).encode())
    if left < 0:
        raise BadInputError(f"{path}: the report takes {largest - left} bytes without any flight; allowed: {largest}")
    stored = _as_fit(flights, left)
    write_text(path, page.render("report.html.j2", **values, flights=stored))
    return len(stored)


def _section_data(sections: Sequence[PageSection], sets: RunSets) -> Iterator[dict[str, Any]]:
    for place, section in enumerate(sections):
        tables = [table_data(table, sets) for table in section.tables]
        yield {
            "id": f"section-{place}",
            "title": section.title,
            "text": section.text,
            "tables": [
                table | {"id": f"{place}-{table['name']}", "long": len(table["rows"]) > _LONG} for table in tables
            ],
            "figures": [
                {"svg": svg_of(one.figure, f"s{place}-{one.name}", one.caption, sets), "caption": one.caption}
                for one in section.figures
            ],
        }


def _as_fit(flights: Iterable[tuple[str, "FlightPage"]], left: int) -> Mapping[str, Markup]:
    """JSON of flights by run id, up to the first one that does not fit; stops iterating there."""
    stored: dict[str, Markup] = {}
    for run_id, flight in flights:
        text = page.as_json(flight.to_json())
        left -= len(text.encode()) + len(run_id) + 100  # including its HTML element
        if left < 0:
            break
        stored[run_id] = text
    return stored


# ---- with flights, flown again for it --------------------------------------------------------------------------------

Case = tuple[Path, str, str | None]
"""Folder of a ledger, id of a run, and id of the run with the same fault in another setting (None = none)."""

Progress = Callable[[int, int], None]

_SMALLEST = 30_000
"""Approximate minimum size of a page of a flight with its golden run (bytes)."""


def write_page(
    path: Path,
    parts: Sequence[ReportedCampaign],
    sections: Sequence[PageSection],
    commands: Sequence[tuple[str, str]],
    flights: int | None,
    workers: int,
    show: Progress,
    headline: Headline | None = None,
) -> int:
    """Write the page of one or more campaigns, with replayed runs.

    Args:
        path: File to write.
        parts: The campaigns.
        sections: Sections in order, the headline first.
        commands: Commands that reproduce the results, with their descriptions.
        flights: Maximum number of flights; None = as many as fit.
        workers: Number of processes.
        show: Called with the numbers of flights done and in all.
        headline: See `write_report_page`.

    Returns:
        Number of flights in the page.
    """
    cases = _cases(parts, LARGEST // _SMALLEST if flights is None else flights)
    with closing(_flown(cases, workers, show)) as pages:
        return write_report_page(path, parts, sections, commands, pages, headline=headline)


def write_html(
    path: Path,
    directory: Path,
    report: CampaignReport,
    flights: int | None,
    workers: int,
    show: Progress = lambda done, total: None,
) -> int:
    """Write the page of the campaign whose ledger is in `directory`; other arguments: see `write_page`."""
    parts = [ReportedCampaign(directory, report)]
    return write_page(path, parts, sections_of(report), _commands(directory, path), flights, workers, show)


def _cases(parts: Sequence[ReportedCampaign], most: int) -> list[Case]:
    """Select runs for the page: campaigns in turn, most illustrative runs first; only those that can be explained."""
    from mavfi.campaign.mission import host_of
    from mavfi.campaign.replay import explained_levels

    chosen = []
    for part in parts:
        frame = part.report.runs.frame
        with Store.open(part.directory) as store:
            levels = explained_levels(host_of(stored_campaign(store)))
        ids = ordered(frame.filter(pl.col("level").is_in(levels)))[:most]
        chosen.append([(part.directory, run_id) for run_id in ids])
    folders: dict[str, Path] = {}  # by run: the same one may be in several campaigns
    for directory, run_id in (case for turn in zip_longest(*chosen) for case in turn if case is not None):
        folders.setdefault(run_id, directory)
    frames = {part.directory: part.report.runs.frame for part in parts}
    return [
        (directory, run_id, partner(frames[directory], run_id)) for run_id, directory in islice(folders.items(), most)
    ]


def _flown(cases: Sequence[Case], workers: int, show: Progress) -> Generator[tuple[str, "FlightPage"], None, None]:
    """Yield run ids and pages in the order of the cases, independent of the order of completion."""
    from mavfi.campaign.executors.executor import map_each
    from mavfi.campaign.executors.local import LocalExecutor

    executor = LocalExecutor(min(workers, max(1, len(cases))))
    done: dict[Case, Any] = {}
    waiting = iter(cases)
    case = next(waiting, None)
    for count, (flown, flight_page) in enumerate(map_each(executor, _page, cases), start=1):
        done[flown] = flight_page
        show(count, len(cases))
        while case is not None and case in done:
            yield case[1], done.pop(case)
            case = next(waiting, None)


def _page(case: Case) -> "FlightPage":
    from mavfi.campaign.replay import explain
    from mavfi.report.html.flight_page import page_of_explanation

    directory, run_id, other = case
    return page_of_explanation(directory, explain(directory, run_id), other, directory)


def _commands(directory: Path, path: Path) -> list[tuple[str, str]]:
    """Commands that reproduce a campaign and its report, with their descriptions."""
    return [
        *_flying(directory),
        (f"Check {FILE}, and fly a share of it again", f"mavfi campaign verify {directory} --share 0.02"),
        ("Write this page", f"mavfi report {directory} --html {path}"),
    ]


def _flying(directory: Path) -> list[tuple[str, str]]:
    """The command that flies a campaign; empty unless it is a shipped one at one of its scales."""
    with Store.open(directory) as store:
        held = stored_campaign(store)
    try:
        shipped = load_campaign(held.name)
    except BadInputError:
        return []
    for scale in ("quick", *shipped.scales):
        if _same(shipped.at_scale(scale), held):
            command = f"mavfi campaign run {held.name} --scale {scale} --out {directory}"
            return [("Fly the campaign, or what is left of it", command)]
    return []


def _same(first: Campaign, second: Campaign) -> bool:
    """Whether two campaigns fly the same missions, ignoring their alternative scales."""
    return first.model_dump(exclude={"scales"}) == second.model_dump(exclude={"scales"})
