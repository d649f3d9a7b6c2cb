"""HTML reports of campaigns and studies: choose runs, replay them, and write the page."""

from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import ExitStack, closing
from itertools import islice, zip_longest
from pathlib import Path

import polars as pl

from mavfi.analysis.listing import ordered, partner
from mavfi.campaign.config import Campaign, load_campaign
from mavfi.campaign.executors.executor import map_each
from mavfi.campaign.executors.local import LocalExecutor
from mavfi.campaign.mission import host_of
from mavfi.campaign.replay import explain, explained_levels
from mavfi.campaign.run import stored_campaign
from mavfi.campaign.store import FILE, Store
from mavfi.cli.flight_pages import page_of_explanation
from mavfi.cli.progress import Bar
from mavfi.errors import BadInputError
from mavfi.extras.paper.report import StudyReport
from mavfi.report.campaign_report import Report
from mavfi.report.html.flight_page import FlightPage
from mavfi.report.html.report_page import (
    LARGEST,
    Headline,
    Part,
    Section,
    headline_of_study,
    sections_of,
    sections_of_study,
    write_report_page,
)

Case = tuple[Path, str, str | None]
"""Folder of a ledger, id of a run, and id of the run with the same fault in another setting (None = none)."""

Progress = Callable[[int, int], None]

_SMALLEST = 30_000
"""Approximate minimum size of a page of a flight with its golden run (bytes)."""


def _write(
    path: Path, parts: Sequence[Part], sections: Sequence[Section], commands: Sequence[tuple[str, str]],
    flights: int | None, workers: int, headline: Headline | None = None, show: Progress | None = None,
) -> int:  # fmt: skip
    """Write the page of one or more campaigns, with replayed runs.

    Args:
        path: File to write.
        parts: The campaigns.
        sections: Sections in order, the headline first.
        commands: Commands that reproduce the results, with their descriptions.
        flights: Maximum number of flights; None = as many as fit.
        workers: Number of processes.
        headline: See `write_report_page`.
        show: Called with the numbers of flights done and in all; None = there is a bar for them.

    Returns:
        Number of flights in the page.
    """
    cases = _cases(parts, LARGEST // _SMALLEST if flights is None else flights)
    executor = LocalExecutor(min(workers, max(1, len(cases))))
    with ExitStack() as stack:
        told = show or stack.enter_context(Bar("flights of the page")).show
        pages = stack.enter_context(closing(_flown(cases, executor, told)))
        return write_report_page(path, parts, sections, commands, pages, headline=headline)


def _cases(parts: Sequence[Part], most: int) -> list[Case]:
    """Select runs for the page: campaigns in turn, most illustrative runs first; only those that can be explained."""
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
    cases: Sequence[Case], executor: LocalExecutor, show: Progress
) -> Generator[tuple[str, FlightPage], None, None]:  # fmt: skip
    """Yield run ids and pages in the order of the cases, independent of the order of completion."""
    done: dict[Case, FlightPage] = {}
    waiting = iter(cases)
    case = next(waiting, None)
    for count, (flown, page) in enumerate(map_each(executor, _page, cases), start=1):
        done[flown] = page
        show(count, len(cases))
        while case is not None and case in done:
            yield case[1], done.pop(case)
            case = next(waiting, None)


def _page(case: Case) -> FlightPage:
    directory, run_id, other = case
    return page_of_explanation(directory, explain(directory, run_id), other, directory)


def write_html(path: Path, directory: Path, report: Report, flights: int | None, workers: int) -> int:
    """Write the page of the campaign whose ledger is in `directory`; other arguments: see `_write`."""
    return _write(path, [Part(directory, report)], sections_of(report), commands(directory, path), flights, workers)


def write_study_html(  # noqa: PLR0913 - what the command was given
    path: Path, root: Path, study: StudyReport, scale: str, reports: Mapping[Path, Report], flights: int | None,
    workers: int, show: Progress | None = None,
) -> int:  # fmt: skip
    """Write the page of a study.

    Args:
        path: File to write.
        root: Folder of the study.
        study: Its results.
        scale: Its scale.
        reports: Reports of its campaigns, by folder of the ledger.
        flights: Maximum number of flights; None = as many as fit.
        workers: Number of processes.
        show: See `_write`.

    Returns:
        Number of flights in the page.
    """
    parts = [Part(directory, report) for directory, report in reports.items()]
    repeat = [
        ("Fly the study, or what is left of it", f"mavfi reproduce {study.study.name} --scale {scale} --out {root}"),
        (f"Check {FILE}, and fly a share of it again", f"mavfi campaign verify {root} --share 0.02"),
    ]
    return _write(path, parts, sections_of_study(study), repeat, flights, workers, headline_of_study(study), show)


def commands(directory: Path, page: Path) -> list[tuple[str, str]]:
    """Commands that reproduce a campaign and its report, with their descriptions."""
    return [
        *_flying(directory),
        (f"Check {FILE}, and fly a share of it again", f"mavfi campaign verify {directory} --share 0.02"),
        ("Write this page", f"mavfi report {directory} --html {page}"),
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
