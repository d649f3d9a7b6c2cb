"""`mavfi report`: print the headline or tables of a campaign; write report.md and figures to its folder."""

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.text import Text

from mavfi.campaign.executors.local import MOST_WORKERS
from mavfi.cli import options
from mavfi.cli.console import PAGES, answer, check_file, check_number, console, counted, write_json
from mavfi.cli.stopping import EXIT_STOPPED, stoppable
from mavfi.errors import BadInputError, write_text
from mavfi.files import check_folder, make_folder
from mavfi.plugins import extensions

HELP_PANEL = "Campaigns"
MAX_FLIGHTS = 10_000

if TYPE_CHECKING:
    from mavfi.analysis.table import Table
    from mavfi.report.campaign_report import CampaignReport
    from mavfi.report.figures import Drawn
    from mavfi.report.html.report_page import EmbeddedFlights
    from mavfi.report.progress import Bar


def report(  # noqa: PLR0913 - one parameter per option
    directory: options.Ledger,
    view: Annotated[
        str, typer.Option(metavar="NAME", help="Print this table only, and write nothing; `list` names all of them.")
    ] = "",
    show_all: options.AllTables = False,
    as_csv: Annotated[bool, typer.Option("--csv", help="The table as comma-separated values (with --view).")] = False,
    as_json: options.AsJson = False,
    html: Annotated[
        Path | None, typer.Option(metavar="FILE.html", help="Write all of it, with runs and flights, as one page.")
    ] = None,
    flights: Annotated[
        int | None,
        typer.Option(help="Flights in the page, flown again for it; by default up to 30, within a minute."),
    ] = None,
    figures: Annotated[
        Path | None,
        typer.Option(metavar="FOLDER", help="Write figures for papers and for talks (16:9), and tables in LaTeX."),
    ] = None,
    workers: options.Workers = 2,
) -> None:
    """Print the headline of a campaign; write report and figures.

    Written to its folder: report.md, figures, summary.json and readme_block.md. The folder of a study (`mavfi
    reproduce`) gives the report of the study; `--view` shows the campaign in it.

    Example: [bold]mavfi report out/states --view by_state --csv[/bold]
    """
    # refuse what is not allowed before the report, which may fly runs again
    if as_csv and not view:
        raise BadInputError("--csv: allowed: with --view NAME")
    _check_files(html, flights, figures, workers, view)
    if view:
        _show_view(directory, view, as_csv=as_csv, as_json=as_json)
        return
    # the first extra that knows this kind of folder, else that of a campaign
    writers = (*extensions("mavfi.reports").values(), report_campaign)
    reports = (write(directory, html, flights, workers) for write in writers)
    reported = next(report for report in reports if report is not None)
    written_files = []
    if html is not None:
        written_files.append(_said_of_page(html, reported.flights, directory))
    if figures is not None:
        written_files.append(_write_figures(reported, figures))
    if as_json:
        write_json(reported.written.to_json())
        return
    reported.show(show_all)
    names = _listed([path.relative_to(directory) for path in reported.written.files])
    console().print(f"[dim]wrote[/dim] {names} [dim]in[/dim] {directory}", soft_wrap=True)
    for line in written_files:
        console().print(f"wrote {line}", style="dim", markup=False, soft_wrap=True)
    if reported.flights.is_stopped:
        raise typer.Exit(EXIT_STOPPED)


@dataclass(frozen=True)
class Reported:
    """A report of a folder, as `mavfi report` shows it.

    Attributes:
        written: The report; it has `files` and `to_json`.
        flights: The flights in its page.
        draw: Draws its figures.
        tables: Its tables, by name.
        show: Prints it: its headline, or with True all of it.
    """

    written: Any
    flights: "EmbeddedFlights"
    draw: Callable[[], Sequence["Drawn"]]
    tables: Mapping[str, "Table"]
    show: Callable[[bool], None]


def report_campaign(directory: Path, html: Path | None, flights: int | None, workers: int) -> Reported:
    """Write the report of the campaign whose ledger is in a folder.

    An extra adds an entry point of the group `mavfi.reports` for folders of another kind: a function with the same
    arguments, which returns None for a folder that is not its own.

    Args:
        directory: The folder.
        html: Page to write; None = none.
        flights: Maximum number of flights in the page; None = see `write_page`.
        workers: Number of processes for them.

    Raises:
        BadInputError: The ledger is missing or damaged, or a file cannot be written.
    """
    from mavfi.campaign.store import Store
    from mavfi.report.campaign_report import write_report
    from mavfi.report.figures import drawn
    from mavfi.report.html.report_page import NO_FLIGHTS, write_html

    Store.open(directory).close()  # fails before writing
    check_folder(directory)
    written = write_report(directory)
    page_flights = NO_FLIGHTS
    if html is not None:
        with page_bar() as bar:
            page_flights = write_html(html, directory, written, flights, workers, bar.show)
    tables = {table.name: table for table in written.tables}
    return Reported(written, page_flights, partial(drawn, written.runs), tables, partial(show_report, written))


@contextmanager
def page_bar() -> Iterator["Bar"]:
    """Progress of the flights of a page; Ctrl-C stops them, and what is done is written."""
    from mavfi.report.progress import Bar

    with stoppable("Stopped: the page holds no flights."), Bar("flights of the page (Ctrl-C: those done)") as bar:
        yield bar


def _said_of_page(path: Path, flights: "EmbeddedFlights", directory: Path) -> str:
    """What was written, and how to see the flights that are not in it."""
    from mavfi.report.html.report_page import DEFAULT_FLIGHTS

    count = counted(flights.stored, "flight")
    if flights.stored < flights.chosen:
        count = f"{flights.stored} of {counted(flights.chosen, 'flight')}"
    if flights.is_stopped:
        count = f"{count} (stopped)"
    summary = f"{path}, with {count}, {path.stat().st_size / 1e6:.1f} MB"
    if flights.stored == flights.chosen < DEFAULT_FLIGHTS:  # there are no more that explain anything
        return summary
    return f"{summary} (any other: mavfi serve {directory}; more in the page: --flights 200)"


def _write_figures(reported: Reported, folder: Path) -> str:
    """Write figures and tables; return one line of text."""
    from mavfi.report.latex import latex_table
    from mavfi.report.progress import Bar
    from mavfi.report.style import write_figure, write_talk_figure

    paths: list[Path] = []
    make_folder(folder)
    with Bar("figures", "figures") as bar:
        for write in (write_figure, write_talk_figure):
            drawn = reported.draw()  # once for each, since it is resized
            for done, result in enumerate(drawn, start=1):
                paths += write(result.figure, folder, result.name)
                bar.show(done, len(drawn))
    for name, table in reported.tables.items():
        paths.append(folder / f"{name}.tex")
        write_text(paths[-1], latex_table(table))
    kinds = Counter(path.suffix.removeprefix(".") for path in paths)
    return f"{', '.join(f'{count} {kind}' for kind, count in kinds.items()) or 'nothing'} in {folder}"


def _check_files(html: Path | None, flights: int | None, figures: Path | None, workers: int, view: str) -> None:
    """Reject invalid output options before any flight."""
    if view and (html or figures):
        raise BadInputError("--view: prints one table and writes nothing; allowed: without --html and --figures")
    check_file("--html", html, PAGES)
    check_number("--flights", flights, 0, MAX_FLIGHTS)
    if flights is not None and html is None:
        raise BadInputError(f"--flights: {flights}: there is no page; allowed: together with --html")
    check_number("--workers", workers, 1, MOST_WORKERS)
    if figures is not None:
        check_folder(figures)


def show_report(report: "CampaignReport", show_all: bool) -> None:
    """Print a report: campaign, leading table or all tables, findings."""
    from mavfi.report.text import checks, has_failed_checks, header, show_header, show_table

    out = console()
    show_header(header(report.runs.campaign), out)
    # A failed check stands before the figures that it puts in doubt.
    failed = has_failed_checks(report.runs)
    if failed:
        _show_checks(checks(report.runs))
    tables = report.tables if show_all else report.tables[:1]
    for table in tables:
        show_table(table, out)
    for finding in report.findings:
        out.print(Text(f"· {finding}"))
    if not failed:
        _show_checks(checks(report.runs))


def _show_checks(lines: Sequence[str]) -> None:
    """Print whether null runs equal their golden runs, and which runs could not be judged."""
    for line in lines:
        console().print(Text(line))


def _listed(files: Sequence[Path]) -> str:
    """Files by name, those in folders as number per folder: "study.md, tables (17)"."""
    folders = Counter(str(path.parent) for path in files if path.parent != Path())
    named = [str(path) for path in files if path.parent == Path()]
    return ", ".join([*named, *(f"{folder} ({count})" for folder, count in folders.items())])


def _show_view(directory: Path, name: str, *, as_csv: bool, as_json: bool) -> None:
    """Print a view of a campaign, or the list of views."""
    from mavfi.analysis.runs import Runs
    from mavfi.analysis.views import applicable, table_asked_for
    from mavfi.report.text import show_table

    runs = Runs.read(directory)
    if name == "list":
        views = applicable(runs)
        width = max(len(view.name) for view in views)
        for view in views:
            answer(f"{view.name:{width}}  {view.title_of(runs)}")
        return
    table = table_asked_for(runs, name)
    if as_csv:
        answer(table.to_csv(), end="")
    elif as_json:
        write_json(table.to_json())
    else:
        show_table(table, console())
