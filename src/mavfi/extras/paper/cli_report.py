"""Reports of studies: write files and page, print the headline."""

import re
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from rich.text import Text

from mavfi.analysis.table import Table
from mavfi.campaign.executors.executor import map_each
from mavfi.campaign.executors.local import LocalExecutor
from mavfi.campaign.store import FILE, Store
from mavfi.cli.console import console
from mavfi.cli.report import Reported, page_bar
from mavfi.extras.paper.report import StudyReport, stored_study, title_of, write_study
from mavfi.extras.paper.study import Study
from mavfi.files import check_folder
from mavfi.report.campaign_report import write_report
from mavfi.report.figures import Drawn, drawn
from mavfi.report.html.report_page import (
    NO_FLIGHTS,
    EmbeddedFlights,
    Headline,
    PageSection,
    ReportedCampaign,
    more_flights,
    write_page,
)
from mavfi.report.progress import Bar
from mavfi.report.text import show_table


class StudyBar(Bar):
    """Progress bar of a study, which takes one step after the other.

    Args:
        study: Name of the study.
    """

    def __init__(self, study: str) -> None:
        super().__init__(study)
        self._study = study

    def begin_step(self, step: str, unit: str = "flights") -> None:
        """Show a step, counted in units."""
        self.begin(f"{self._study}, {step}", unit)


def write_study_report(  # noqa: PLR0913 - what the command was given
    study: Study,
    scale: str,
    folder: Path,
    page: Path | None,
    flights: int | None,
    workers: int,
    *,
    bar: StudyBar | None = None,
) -> tuple[StudyReport, EmbeddedFlights]:
    """Write the reports of a study and of its campaigns.

    Args:
        study: The study.
        scale: The scale at which it was flown.
        folder: Its folder.
        page: HTML file to write; None = none.
        flights: Maximum number of flights in the page; None = see `write_page`.
        workers: Number of processes.
        bar: Shows the progress; None = the page has a bar of its own.

    Returns:
        The report of the study, and the flights in the page.

    Raises:
        BadInputError: A ledger is missing or damaged, or a file cannot be written.
    """
    campaigns = [folder / name for name in study.campaigns]
    tasks: list[Callable[[], Any]] = [
        partial(write_study, study, scale, folder),  # the longest first
        *(partial(write_report, directory) for directory in campaigns),
    ]
    show = None
    if bar is not None:
        bar.begin_step("tables and figures", "reports")
        show = bar.show
    study_report, *campaign_reports = _write_all(tasks, workers, show)

    # the page needs the reports of all campaigns
    reports = dict(zip(campaigns, campaign_reports, strict=True))
    page_flights = NO_FLIGHTS
    if page is not None:
        shown_bar: AbstractContextManager[Bar] = page_bar()
        if bar is not None:
            bar.begin_step("report.html and its flights")
            shown_bar = nullcontext(bar)
        with shown_bar as running_bar:
            parts = [ReportedCampaign(directory, report) for directory, report in reports.items()]
            repeat = [
                (
                    "Fly the study, or what is left of it",
                    f"mavfi reproduce {study.name} --scale {scale} --out {folder}",
                ),
                (f"Check {FILE}, and fly a share of it again", f"mavfi campaign verify {folder} --share 0.02"),
                *more_flights(folder, page),
            ]
            sections = sections_of_study(study_report)
            headline = headline_of_study(study_report)
            page_flights = write_page(page, parts, sections, repeat, flights, workers, running_bar.show, headline)
    return study_report, page_flights


def report_study(directory: Path, html: Path | None, flights: int | None, workers: int) -> Reported | None:
    """Write the report of the study in a folder; None if it holds none.  See `mavfi.cli.report.report_campaign`."""
    stored = stored_study(directory)
    if stored is None:
        return None
    study, scale = stored
    for folder in study.campaigns:
        Store.open(directory / folder).close()  # fails before writing
    check_folder(directory)
    report, page_flights = write_study_report(study, scale, directory, html, flights, workers)
    show = partial(show_study_report, report)
    return Reported(report, page_flights, partial(drawn_of_study, report), report.tables, show)


def _polars_has_threads() -> bool:
    """Whether polars was used here: a forked process lacks its threads, and would wait for them for ever."""
    names = (path.read_text(encoding="utf-8") for path in Path("/proc/self/task").glob("*/comm"))
    return any(re.match(r"polars-\d", name) for name in names)


def _write_all(
    tasks: Sequence[Callable[[], Any]], workers: int, show: Callable[[int, int], None] | None = None
) -> list[Any]:
    """Reports in the order of the tasks that write them."""
    numbered = enumerate(tasks)
    results: Iterator[tuple[tuple[int, Callable[[], Any]], Any]]
    if workers == 1 or _polars_has_threads():
        results = ((task, _write(task)) for task in numbered)
    else:
        results = map_each(LocalExecutor(workers), _write, numbered)
    reports: dict[int, Any] = {}
    for (number, _), report in results:  # in the order in which they are finished
        reports[number] = report
        if show is not None:
            show(len(reports), len(tasks))
    return [reports[number] for number in range(len(tasks))]


def _write(task: tuple[int, Callable[[], Any]]) -> Any:  # noqa: ANN401 - the report that the task writes
    """Write one report; importable, to be called in a worker."""
    return task[1]()


def show_study_report(written: StudyReport, show_all: bool) -> None:
    """Print a study: the first table of each headline section (or all tables of all sections), and the findings."""
    terminal = console()
    if show_all:
        for section in written.sections:
            _show_tables(section.definition.title, section.tables)
    else:
        for section in written.headline:
            _show_tables(section.definition.title, section.tables[:1])
    for title, lines in written.findings.items():
        terminal.print(Text(title, "bold"))
        for line in lines:
            terminal.print(Text(f"· {line}"))


def _show_tables(title: str, tables: Sequence[Table]) -> None:
    terminal = console()
    terminal.print(Text(title, "bold"))
    for table in tables:
        show_table(table, terminal)


# ---- the page --------------------------------------------------------------------------------------------------------
def sections_of_study(study: StudyReport) -> list[PageSection]:
    """Sections of a study: the headline, then all sections in order."""
    sections = []
    for report in study.sections:
        figures = drawn(report.runs, report.definition.figures) if report.runs else ()
        sections.append(PageSection(report.definition.title, report.tables, figures, report.definition.text))
    headline = []
    if study.headline:
        leading = sections[study.sections.index(study.headline[0])]
        headline.append(PageSection(leading.title, leading.tables[:1], leading.figures[:1]))
    return [*headline, *sections]


def drawn_of_study(study: StudyReport) -> list[Drawn]:
    """Figures of a study; their names begin with that of the campaign."""
    figures = []
    for section in study.sections:
        if section.runs is not None:
            campaign = section.runs.campaign["name"]
            for figure in drawn(section.runs, section.definition.figures):
                figures.append(replace(figure, name=f"{campaign}_{figure.name}"))
    return figures


def headline_of_study(study: StudyReport) -> Headline:
    """Headline of a study: environments, number of runs by level, provenance; the remarks describe each campaign."""
    campaigns = [runs.campaign for runs in study.campaigns.values()]
    done = sum(campaign["done"] for campaign in campaigns)
    total = sum(campaign["total"] for campaign in campaigns)
    levels = Counter[str]()
    for runs in study.campaigns.values():
        levels.update(runs.injected["level"])
    golden = sum(len(runs.golden) for runs in study.campaigns.values())
    counts = [f"{golden:,} without a fault", *(f"{n:,} with one at {level} level" for level, n in levels.most_common())]
    nulls = sum(len(runs.where(kind="null")) for runs in study.campaigns.values())
    if nulls:
        counts.append(f"{nulls:,} as with a fault, but without one (null)")
    environments = dict.fromkeys(
        campaign.get("parts", {}).get(name, {}).get("environment") or name  # a part may have a name of its own
        for campaign in campaigns
        for name in campaign["environments"]
    )
    lines = [
        f"Missions of an autonomous quadrotor in {', '.join(environments)}: at most one flipped bit per mission",
        f"{done:,} of {total:,} runs done in {len(campaigns)} campaigns: {', '.join(counts)}",
        *study.provenance,
    ]
    return Headline("study", title_of(study.study), lines, study.findings)
