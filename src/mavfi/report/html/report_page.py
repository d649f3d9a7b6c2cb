"""The report of one or more campaigns as one HTML file: headline, sections, runs, flights."""

import io
import re
import time
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from html import escape, unescape
from itertools import islice, zip_longest
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple
from urllib.parse import parse_qsl

import polars as pl
from markupsafe import Markup
from matplotlib import rc_context
from matplotlib.figure import Figure

from mavfi.analysis.listing import ordered, partner
from mavfi.analysis.rows import EFFECT_IN_WORDS
from mavfi.analysis.runs import Runs
from mavfi.analysis.table import TEXT, Table
from mavfi.campaign.config import load_campaign
from mavfi.campaign.ledger import stored_campaign
from mavfi.campaign.store import FILE, Store
from mavfi.errors import BadInputError, write_text
from mavfi.report import links, style
from mavfi.report.campaign_report import CampaignReport, remarks_on
from mavfi.report.figures import Drawn, drawn
from mavfi.report.html import page
from mavfi.report.style import setting_label
from mavfi.report.text import ABSENT, cell, checks, header

if TYPE_CHECKING:
    from mavfi.report.html.flight_page import FlightPage


MAX_NAME_LENGTH = 40
"""Longest text of a cell that is shown on one line (characters)."""

_SETTINGS = ("setting", "row")
"""Columns with names of settings, which are shown in words; CSV keeps the names."""
_INTERVAL = re.compile(r"^(\S+) (\[.*)$")


@dataclass(slots=True)
class RunSets:
    """Deduplicated sets of runs to which cells and figures link.

    Attributes:
        indices: Index of each run in the list of runs, by id.
        texts: Number of each set, by its text of index ranges.
    """

    indices: Mapping[str, int]
    texts: dict[str, int] = field(default_factory=dict)

    def link(self, run_ids: Sequence[str]) -> str:
        """Link to a set of runs within the page, which is added if it is new; "" = no runs."""
        indices = sorted(self.indices[run_id] for run_id in run_ids if run_id in self.indices)
        if not indices:
            return ""
        number = self.texts.setdefault(_ranges(indices), len(self.texts))
        return f"#runs?set={number}"

    def ordered(self, run_ids: Iterable[str]) -> str:
        """Indices of runs in the list of runs, in the given order, as text of ranges.

        Raises:
            KeyError: A run is not listed.
        """
        return _ranges([self.indices[run_id] for run_id in run_ids])


def _ranges(numbers: Sequence[int]) -> str:
    """Format numbers as ranges of ascending ones, in order: "0-29 45"."""
    ranges: list[list[int]] = []
    for number in numbers:
        if ranges and number == ranges[-1][1] + 1:
            ranges[-1][1] = number
        else:
            ranges.append([number, number])
    texts = []
    for low, high in ranges:
        texts.append(f"{low}" if low == high else f"{low}-{high}")
    return " ".join(texts)


def table_data(table: Table, sets: RunSets) -> dict[str, Any]:
    """Headings, rows of cells (text, interval, link), notes and CSV of a table."""
    shown = [index for index, column in enumerate(table.columns) if not column.hidden]
    # "key" identifies the row and has no links; "text" and "number" are aligned left and right
    kinds = {}
    columns = []
    for index in shown:
        kinds[index] = "number"
        if table.columns[index].form == TEXT:
            kinds[index] = "text"
        if index < table.keys:
            kinds[index] = "key"
        # columns with sentences wrap
        is_prose = any(isinstance(row[index], str) and len(row[index]) > MAX_NAME_LENGTH for row in table.rows)
        columns.append({"heading": table.columns[index].heading, "kind": kinds[index], "prose": is_prose})
    # cells with the runs behind them; those of a table without runs have no links
    behind = table.behind or [((),) * len(table.columns)] * len(table.rows)
    rows: list[dict[str, Any]] = []
    first_above = None
    for row, run_ids in zip(table.rows, behind, strict=True):
        cells = []
        for index in shown:
            text = cell(row[index], table.columns[index].form)
            if table.columns[index].key in _SETTINGS:
                text = setting_label(text)
            # a rate is split into its value and the rest: interval and n
            rate = _INTERVAL.match(text)
            value = text
            interval = ""
            if rate:
                value, interval = rate.groups()
            link = ""
            if kinds[index] != "key" and text not in ("", ABSENT):
                link = sets.link(run_ids[index])
            cells.append({"kind": kinds[index], "value": value, "interval": interval, "link": link})
        rows.append({"cells": cells, "repeated": bool(rows) and row[0] == first_above})
        first_above = row[0]
    return {
        "name": table.name,
        "title": table.title,
        "columns": columns,
        "rows": rows,
        "notes": table.notes,
        "csv": table.to_csv(),
    }


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
        effect=EFFECT_IN_WORDS,
    )
    texts = {name: _coded(frame[name]) for name in FILTERS}
    numbers = {name: _rounded(frame[name], digits) for name, digits in NUMBERS.items()}
    return {"ids": frame["run_id"].to_list(), "texts": texts, "numbers": numbers, "filters": FILTERS}


def _coded(column: pl.Series) -> dict[str, Any]:
    """A text column as its distinct values, and the index of each row's value in them."""
    values = column.unique(maintain_order=True).to_list()
    codes = {value: code for code, value in enumerate(values)}
    return {"values": values, "codes": [codes[value] for value in column]}


def _rounded(column: pl.Series, digits: int) -> list[float | None]:
    """Numbers with at most so many decimals; with 0 decimals, integers."""
    numbers: list[float | None] = []
    for value in column:
        if value is not None and digits:
            value = round(value, digits)
        elif value is not None:
            value = int(value)
        numbers.append(value)
    return numbers


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
    # an element within a page has no XML declaration and document type, and needs no metadata
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    # groups of dots: matplotlib has stored their run ids in the only attribute that it offers, `id`
    # the scripts open the run of the dot that is clicked
    text = re.sub(
        rf'\bid="{links.DOTS}([^"]*)"',
        lambda dots: f'class="dots" data-runs="{sets.ordered(dots[1].split())}"',
        text,
    )
    # ids, and references to them, get the prefix: all figures of a page share one name space; links to runs stay
    text = re.sub(r'(\bid="|url\(#|href="#)(?!runs\?|run/)', rf"\g<1>{name}-", text)
    # colours become variables of the style sheet, which has one value for each theme
    for colour, variable in _COLOURS.items():
        text = re.sub(re.escape(colour), f"var(--{variable})", text, flags=re.IGNORECASE)
    # links to runs stay in the page, and are labelled
    text = re.sub(r'<a xlink:href="(#runs?[?/][^"]*)" target="_blank"', lambda anchor: _link(anchor[1], sets), text)
    # without its height it scales; the style sheet limits the scale, so that the text of all figures has one size
    text = re.sub(r'(<svg[^>]*?) height="[^"]*"', r"\1", text, count=1)
    text = re.sub(r'(<svg[^>]*?) width="([^"]*)"', r'\1 style="--drawn: \2"', text, count=1)
    # screen readers announce the caption, then the links within
    label = escape(caption, quote=True)
    return Markup(text.replace("<svg ", f'<svg role="group" aria-label="{label}" ', 1))  # noqa: S704 - from matplotlib


def _link(link: str, sets: RunSets) -> str:
    """Rewrite a link of `report.links` for the page, with a label for screen readers."""
    if link.startswith(links.RUN):
        return f'<a href="{link}" aria-label="run {link.removeprefix(links.RUN)}"'
    label = dict(parse_qsl(unescape(link).removeprefix(links.RUNS)))
    run_ids = label.pop(links.IDS).split()
    values = ", ".join(f"{key.replace('_', ' ')} {value}" for key, value in label.items())
    count = "1 run" if len(run_ids) == 1 else f"{len(run_ids)} runs"
    return f'<a href="{sets.link(run_ids)}" aria-label="{escape(f"{count}: {values}", quote=True)}"'


# ---- the report of one or more campaigns as one HTML file: headline, sections, runs, flights -----------------------

MAX_PAGE_SIZE = 15_000_000
"""Maximum size of a page (bytes)."""
_MAX_OPEN_ROWS = 30
"""Tables with more rows than this are collapsed."""
_MAX_HALF_WIDTH = 7.5
"""Width (in) up to which two figures stand side by side."""


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
    sections = [PageSection(table.title, [table], figures[:1]) for table in report.tables[:1]]
    if figures[1:]:
        sections.append(PageSection("Figures", (), figures[1:]))
    return sections + [PageSection(table.title, [table]) for table in report.tables[1:]]


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
    """Headline of a campaign; the mission, in the title of text reports, is a line of its own."""
    title, *lines = header(report.runs.campaign)
    campaign, _, mission = title.partition(" · ")
    return Headline("campaign", campaign[0].upper() + campaign[1:], [mission, *lines], {"": report.findings})


def page_values(
    campaigns: Sequence[ReportedCampaign],
    sections: Sequence[PageSection],
    commands: Sequence[tuple[str, str]],
    headline: Headline | None = None,
) -> dict[str, Any]:
    """Values of the template of the page, except its `flights`; arguments: see `write_report_page`."""
    reports = [campaign.report for campaign in campaigns]
    # the list of runs, tables and figures; these two collect the sets of runs to which they link
    listed_runs = run_list({str(campaign.directory): campaign.report.runs for campaign in campaigns})
    sets = RunSets({run_id: index for index, run_id in enumerate(listed_runs["ids"])})
    section_data = [_section_data(number, section, sets) for number, section in enumerate(sections)]
    csv = {table["id"]: table.pop("csv") for section in section_data for table in section["tables"]}
    # checks and remarks; with several campaigns, also what each of them is
    remarks: list[str] = []
    if len(reports) > 1:
        remarks += ["; ".join(header(report.runs.campaign)) for report in reports]
    for report in reports:
        remarks += checks(report.runs)
    return {
        "headline": headline or headline_of(reports[0]),
        "commands": commands,
        "sections": section_data,
        "checks": [*remarks, *remarks_on(reports[0].runs)],
        "csv": csv,
        "runs": listed_runs | {"sets": list(sets.texts)},
    }


def write_report_page(
    path: Path,
    campaigns: Sequence[ReportedCampaign],
    sections: Sequence[PageSection],
    commands: Sequence[tuple[str, str]],
    flights: Iterable[tuple[str, "FlightPage"]] = (),
    *,
    headline: Headline | None = None,
    largest: int = MAX_PAGE_SIZE,
) -> int:
    """Write the page of one or more campaigns.

    Args:
        path: File to write.
        campaigns: The campaigns.
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
    values = page_values(campaigns, sections, commands, headline)
    text = page.render("report.html.j2", **values, flights={})
    size = len(text.encode())
    if size > largest:
        raise BadInputError(f"{path}: the report takes {size} bytes without any flight; allowed: {largest}")
    write_text(path, text)  # at once: the flights may take a minute, and may be stopped
    # flights fill what is left of the file
    flight_data = _as_fit(flights, largest - size)
    page.write(path, "report.html.j2", **values, flights=flight_data)
    return len(flight_data)


def _section_data(number: int, section: PageSection, sets: RunSets) -> dict[str, Any]:
    """A section as plain data for the template; ids contain its number, which makes them unique."""
    tables = []
    for table in section.tables:
        data = table_data(table, sets)
        tables.append(data | {"id": f"{number}-{table.name}", "long": len(table.rows) > _MAX_OPEN_ROWS})
    figures = []
    for figure in section.figures:
        svg = svg_of(figure.figure, f"s{number}-{figure.name}", figure.caption, sets)
        is_wide = figure.figure.get_figwidth() > _MAX_HALF_WIDTH
        figures.append({"name": figure.name, "svg": svg, "caption": figure.caption, "is_wide": is_wide})
    return {
        "id": f"section-{number}",
        "title": section.title,
        "text": section.text,
        "tables": tables,
        "figures": figures,
    }


def _as_fit(flights: Iterable[tuple[str, "FlightPage"]], space: int) -> Mapping[str, Markup]:
    """JSON of flights by run id, up to the first one that exceeds the space (bytes); stops iterating there."""
    stored: dict[str, Markup] = {}
    for run_id, flight in flights:
        text = page.as_json(flight.to_json())
        space -= len(text.encode()) + len(run_id) + 100  # including its HTML element
        if space < 0:
            break
        stored[run_id] = text
    return stored


# ---- with flights, flown again for it --------------------------------------------------------------------------------

Case = tuple[Path, str, str | None]
"""Folder of a ledger, id of a run, and id of the run with the same fault in another setting (None = none)."""

ShowProgress = Callable[[int, int], None]
"""Called with the numbers of flights done and in all."""

DEFAULT_FLIGHTS = 30
DEFAULT_SECONDS = 60.0
"""Flights in a page unless their number is given, and the time after which no further one is waited for (s)."""


class EmbeddedFlights(NamedTuple):
    """Flights in a page.

    Attributes:
        stored: Number of flights in the page.
        chosen: Number of flights that were to be flown for it.
        is_stopped: Whether Ctrl-C ended them.
    """

    stored: int
    chosen: int
    is_stopped: bool = False


NO_FLIGHTS = EmbeddedFlights(0, 0)


def write_page(
    path: Path,
    campaigns: Sequence[ReportedCampaign],
    sections: Sequence[PageSection],
    commands: Sequence[tuple[str, str]],
    flights: int | None,
    workers: int,
    show: ShowProgress,
    headline: Headline | None = None,
) -> EmbeddedFlights:
    """Write the page of one or more campaigns, with replayed runs.

    Args:
        path: File to write.
        campaigns: The campaigns.
        sections: Sections in order, the headline first.
        commands: Commands that reproduce the results, with their descriptions.
        flights: Maximum number of flights; None = `DEFAULT_FLIGHTS`, and those that are done in `DEFAULT_SECONDS`.
        workers: Number of processes.
        show: Shows progress.
        headline: See `write_report_page`.

    Returns:
        The flights in the page, with what is done at Ctrl-C.
    """
    if flights is None:
        flown = _FlownCases(_cases(campaigns, DEFAULT_FLIGHTS), workers, show, DEFAULT_SECONDS)
    else:
        flown = _FlownCases(_cases(campaigns, flights), workers, show)
    stored = write_report_page(path, campaigns, sections, commands, flown, headline=headline)
    return EmbeddedFlights(stored, len(flown.cases), flown.is_stopped)


def write_html(
    path: Path,
    directory: Path,
    report: CampaignReport,
    flights: int | None,
    workers: int,
    show: ShowProgress = lambda done, total: None,
) -> EmbeddedFlights:
    """Write the page of the campaign whose ledger is in `directory`; other arguments: see `write_page`."""
    campaigns = [ReportedCampaign(directory, report)]
    with Store.open(directory) as store:
        permission = store.permission
    commands = [
        *_flying(directory),
        (f"Check {FILE}, and fly a share of it again", f"mavfi campaign verify {directory} --share 0.02{permission}"),
        *more_flights(directory, path, permission),
    ]
    return write_page(path, campaigns, sections_of(report), commands, flights, workers, show)


def _cases(campaigns: Sequence[ReportedCampaign], most: int) -> list[Case]:
    """Select runs for the page: campaigns in turn, most illustrative runs first; only those that can be explained."""
    from mavfi.campaign.replay import explained_levels
    from mavfi.campaign.resolve import resolve

    # the runs of each campaign, the most illustrative first
    candidates = []
    for campaign in campaigns:
        with Store.open(campaign.directory) as store:
            levels = explained_levels(resolve(stored_campaign(store)).host)
        explainable = campaign.report.runs.frame.filter(pl.col("level").is_in(levels))
        candidates.append([(run_id, campaign) for run_id in ordered(explainable)[:most]])
    # campaigns in turn; a run may be in several of them
    chosen: dict[str, ReportedCampaign] = {}
    for turn in zip_longest(*candidates):
        for candidate in turn:
            if candidate is not None:  # else this campaign has no more runs
                chosen.setdefault(*candidate)
    return [
        (campaign.directory, run_id, partner(campaign.report.runs.frame, run_id))
        for run_id, campaign in islice(chosen.items(), most)
    ]


class _FlownCases:
    """Run ids and pages of cases in their order, independent of the order of completion; to be iterated once.

    When the time is up, or at Ctrl-C, what is done follows, and nothing else.

    Args:
        cases: The cases.
        workers: Number of processes.
        show: Shows progress.
        seconds: Time from the first case on after which no further one is waited for (s).
    """

    def __init__(self, cases: Sequence[Case], workers: int, show: ShowProgress, seconds: float = float("inf")) -> None:
        self.cases = cases
        self.is_stopped = False
        self._workers = workers
        self._show = show
        self._seconds = seconds
        self._done: dict[Case, FlightPage] = {}  # not yielded yet

    def __iter__(self) -> Iterator[tuple[str, "FlightPage"]]:
        waiting = deque(self.cases)
        with closing(self._fly()) as results:
            for case, flight_page in results:
                self._done[case] = flight_page
                while waiting and waiting[0] in self._done:
                    yield self._take(waiting.popleft())
        for case in waiting:  # the time is up, or Ctrl-C: those behind one that is not done
            if case in self._done:
                yield self._take(case)

    def _take(self, case: Case) -> tuple[str, "FlightPage"]:
        _, run_id, _ = case
        return run_id, self._done.pop(case)

    def _fly(self) -> Generator[tuple[Case, "FlightPage"], None, None]:
        """Yield cases and pages in the order of completion."""
        from mavfi.campaign.executors.executor import map_each
        from mavfi.campaign.executors.local import LocalExecutor

        executor = LocalExecutor(min(self._workers, max(1, len(self.cases))))
        end = time.monotonic() + self._seconds
        try:
            for count, result in enumerate(map_each(executor, _page, self.cases), start=1):
                yield result
                self._show(count, len(self.cases))
                if time.monotonic() > end:
                    return
        except KeyboardInterrupt:
            self.is_stopped = True


def _page(case: Case) -> "FlightPage":
    from mavfi.campaign.replay import explain
    from mavfi.report.html.flight_page import page_of_explanation

    directory, run_id, other = case
    return page_of_explanation(directory, explain(directory, run_id), other, directory)


def more_flights(directory: Path, path: Path, permission: str = "") -> list[tuple[str, str]]:
    """Commands that show the flights of a folder which are not in a page, with their descriptions.

    Args:
        directory: Folder of a ledger or a study.
        path: The page.
        permission: What the commands need to run plug-ins of the ledger, see `Store.permission`.
    """
    return [
        ("See any flight: a run is flown when it is clicked", f"mavfi serve {directory}{permission}"),
        ("Write this page with more flights", f"mavfi report {directory} --html {path} --flights 200{permission}"),
    ]


def _flying(directory: Path) -> list[tuple[str, str]]:
    """The command that flies a campaign; empty unless it is a shipped one at one of its scales."""
    with Store.open(directory) as store:
        campaign = stored_campaign(store)
    try:
        shipped = load_campaign(campaign.name)
    except BadInputError:
        return []
    for scale in ("quick", *shipped.scales):
        # the same missions, whatever other scales there are
        if shipped.at_scale(scale).model_copy(update={"scales": campaign.scales}) == campaign:
            command = f"mavfi campaign run {campaign.name} --scale {scale} --out {directory}"
            return [("Fly the campaign, or what is left of it", command)]
    return []
