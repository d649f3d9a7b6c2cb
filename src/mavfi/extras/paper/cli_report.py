"""Reports of studies: write files and page, print the headline."""

import re
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from rich.text import Text

from mavfi.campaign.executors.executor import map_each
from mavfi.campaign.executors.local import LocalExecutor
from mavfi.cli.console import console
from mavfi.cli.progress import StudyBar
from mavfi.cli.report_page import write_study_html
from mavfi.extras.paper.report import StudyReport, write_study, write_texts
from mavfi.extras.paper.study import Study
from mavfi.report.campaign_report import write_report
from mavfi.report.terminal import show_table


def write_study_report(  # noqa: PLR0913 - what the command was given
    study: Study, scale: str, folder: Path, page: Path | None, flights: int | None, workers: int, *,
    bar: StudyBar | None = None,
) -> tuple[StudyReport, int]:  # fmt: skip
    """Write the reports of a study and of its campaigns.

    Args:
        study: The study.
        scale: The scale at which it was flown.
        folder: Its folder.
        page: HTML file to write; None = none.
        flights: Maximum number of flights in the page; None = as many as fit.
        workers: Number of processes.
        bar: Shows the progress, and records the time of tables and page; None = the page has a bar of its own.

    Returns:
        The report of the study, and the number of flights in the page.

    Raises:
        BadInputError: A ledger is missing or damaged, or a file cannot be written.
    """
    campaigns = [folder / name for name in study.campaigns]
    tasks: list[Callable[[], Any]] = [
        partial(write_study, study, scale, folder),  # the longest first
        *(partial(write_report, directory) for directory in campaigns),
    ]
    show = None if bar is None else bar.show
    with nullcontext() if bar is None else bar.timed("tables and figures", "reports"):
        written, *found = _written(tasks, 1 if _polars_has_threads() else workers, show)
    if bar is not None:
        written = replace(written, steps=bar.steps)
    reports = dict(zip(campaigns, found, strict=True))
    with nullcontext() if bar is None else bar.timed("report.html and its flights"):
        count = 0 if page is None else write_study_html(page, folder, written, scale, reports, flights, workers, show)
    if bar is not None:
        write_texts(written, scale, folder)
    return written, count


def _polars_has_threads() -> bool:
    """Whether polars was used here: a forked process lacks its threads, and would wait for them for ever."""
    names = (path.read_text(encoding="utf-8") for path in Path("/proc/self/task").glob("*/comm"))
    return any(re.match(r"polars-\d", name) for name in names)


def _written(
    tasks: Sequence[Callable[[], Any]], workers: int, show: Callable[[int, int], None] | None = None
) -> list[Any]:
    """Reports in the order of the tasks that write them."""
    alone, numbered = workers == 1, enumerate(tasks)
    each = ((one, _write(one)) for one in numbered) if alone else map_each(LocalExecutor(workers), _write, numbered)
    done: dict[int, Any] = {}
    for (place, _), found in each:
        done[place] = found
        if show is not None:
            show(len(done), len(tasks))
    return [done[place] for place in range(len(tasks))]


def _write(task: tuple[int, Callable[[], Any]]) -> Any:  # noqa: ANN401 - the report that the task writes
    """Write one report; importable, to be called in a worker."""
    return task[1]()


def show_study_report(written: StudyReport, show_all: bool) -> None:
    """Print a study: the first table of each headline section (or all tables of all sections), and the findings."""
    terminal = console()
    for section in written.sections if show_all else written.headline:
        terminal.print(Text(section.section.title, "bold"))
        for table in section.tables if show_all else section.tables[:1]:
            show_table(table, terminal)
    if show_all:
        for table in written.times:
            show_table(table, terminal)
    for title, lines in written.findings.items():
        terminal.print(Text(title, "bold"))
        for line in lines:
            terminal.print(Text(f"· {line}"))
