"""The report of one or more campaigns as one HTML file: headline, sections, runs, flights."""

from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from itertools import islice, zip_longest
from pathlib import Path
from typing import TYPE_CHECKING, Any

import polars as pl
from markupsafe import Markup

from mavfi.analysis.listing import ordered, partner
from mavfi.analysis.table import Table
from mavfi.campaign.config import Campaign, load_campaign
from mavfi.campaign.ledger import stored_campaign
from mavfi.campaign.store import FILE, Store
from mavfi.errors import BadInputError, write_text
from mavfi.report.campaign_report import REMARKS, Report
from mavfi.report.figures import Drawn, drawn
from mavfi.report.html import page
from mavfi.report.html.report_data import RunSets, run_list, svg_of, table_data
from mavfi.report.text import checks, header

if TYPE_CHECKING:
    from mavfi.report.html.flight_page import FlightPage

LARGEST = 15_000_000
"""Maximum size of a page (bytes)."""
_LONG = 30
"""Tables with more rows than this are collapsed."""


@dataclass(frozen=True, slots=True)
class Section:
    """A section of the page: text, tables and figures."""

    title: str
    tables: Sequence[Table] = ()
    figures: Sequence[Drawn] = ()
    text: str = ""


def sections_of(report: Report) -> list[Section]:
    """Sections of a campaign: leading table with leading figure, other figures, and one section per other table."""
    figures, (leading, *others) = drawn(report.runs), report.tables or (None,)
    sections = [] if leading is None else [Section(leading.title, [leading], figures[:1])]
    sections += [Section("Figures", (), figures[1:])] if figures[1:] else []
    return sections + [Section(table.title, [table]) for table in others]


@dataclass(frozen=True, slots=True)
class Part:
    """A campaign of the page, and the folder of its ledger as printed in commands."""

    directory: Path
    report: Report


@dataclass(frozen=True, slots=True)
class Headline:
    """Text of the first screen; findings by heading ("" = none)."""

    kind: str
    title: str
    lines: Sequence[str]
    findings: Mapping[str, Sequence[str]]


def headline_of(report: Report) -> Headline:
    """Headline of a campaign."""
    named, *lines = header(report.runs.campaign)
    campaign, _, mission = named.partition(" · ")
    return Headline("campaign", campaign[0].upper() + campaign[1:], [mission, *lines], {"": report.findings})


def write_report_page(
    path: Path, parts: Sequence[Part], sections: Sequence[Section], commands: Sequence[tuple[str, str]],
    flights: Iterable[tuple[str, "FlightPage"]] = (), *, headline: Headline | None = None, largest: int = LARGEST,
) -> int:  # fmt: skip
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
    remarks = ["; ".join(header(report.runs.campaign)) for report in reports] if len(reports) > 1 else []
    values: dict[str, Any] = {
        "headline": headline or headline_of(reports[0]), "commands": commands, "sections": numbered,
        "checks": [*remarks, *(line for report in reports for line in checks(report.runs)), *REMARKS],
        "csv": {table["id"]: table.pop("csv") for section in numbered for table in section["tables"]},
        "runs": listed | {"sets": list(sets.texts)},
    }  # fmt: skip
    left = largest - len(page.render("report.html.j2", **values, flights={}).encode())
    if left < 0:
        raise BadInputError(f"{path}: the report takes {largest - left} bytes without any flight; allowed: {largest}")
    stored = _as_fit(flights, left)
    write_text(path, page.render("report.html.j2", **values, flights=stored))
    return len(stored)


def _section_data(sections: Sequence[Section], sets: RunSets) -> Iterator[dict[str, Any]]:
    for place, section in enumerate(sections):
        tables = [table_data(table, sets) for table in section.tables]
        yield {
            "id": f"section-{place}", "title": section.title, "text": section.text,
            "tables": [
                table | {"id": f"{place}-{table['name']}", "long": len(table["rows"]) > _LONG} for table in tables
            ],
            "figures": [
                {"svg": svg_of(one.figure, f"s{place}-{one.name}", one.caption, sets), "caption": one.caption}
                for one in section.figures
            ],
        }  # fmt: skip


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
    path: Path, parts: Sequence[Part], sections: Sequence[Section], commands: Sequence[tuple[str, str]],
    flights: int | None, workers: int, show: Progress, headline: Headline | None = None,
) -> int:  # fmt: skip
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
    path: Path, directory: Path, report: Report, flights: int | None, workers: int,
    show: Progress = lambda done, total: None,
) -> int:  # fmt: skip
    """Write the page of the campaign whose ledger is in `directory`; other arguments: see `write_page`."""
    parts = [Part(directory, report)]
    return write_page(path, parts, sections_of(report), _commands(directory, path), flights, workers, show)


def _cases(parts: Sequence[Part], most: int) -> list[Case]:
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


def _flown(
    cases: Sequence[Case], workers: int, show: Progress
) -> Generator[tuple[str, "FlightPage"], None, None]:  # fmt: skip
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
