"""`mavfi report`: print the headline or tables of a campaign; write report.md and figures to its folder."""

from collections import Counter
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.text import Text

from mavfi.campaign.executors.local import MOST_WORKERS
from mavfi.cli import options
from mavfi.cli.console import PAGES, check_file, check_number, console, counted, write_json
from mavfi.errors import BadInputError
from mavfi.files import check_folder

MOST_FLIGHTS = 10_000

if TYPE_CHECKING:
    from mavfi.extras.paper.report import StudyReport
    from mavfi.report.campaign_report import Report
    from mavfi.report.html.report_page import Drawn


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
        int | None, typer.Option(help="Flights in the page, flown again for it; as many as fit by default.")
    ] = None,
    figures: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="Write each figure as PDF and PNG in column width.")
    ] = None,
    workers: options.Workers = 2,
) -> None:
    """Print the headline of a campaign, and write report.md, figures, summary.json and readme_block.md to its folder.

    The folder of a study (`mavfi reproduce`) gives the report of the study; `--view` shows the campaign in it.

    Example: [bold]mavfi report out/states --view by_state --csv[/bold]
    """
    if as_csv and not view:
        raise BadInputError("--csv: allowed: with --view NAME")
    _check_files(html, flights, figures, workers, view)
    if view:
        _show_view(directory, view, as_csv=as_csv, as_json=as_json)
        return
    from mavfi.campaign.store import Store
    from mavfi.extras.paper.report import stored_study

    study = stored_study(directory)
    for folder in (".",) if study is None else study[0].campaigns:
        Store.open(directory / folder).close()  # fails before writing if a ledger is missing or damaged
    check_folder(directory)
    written: Report | StudyReport
    if study is None:
        from mavfi.cli.report_page import write_html
        from mavfi.report.campaign_report import write_report
        from mavfi.report.html.report_page import drawn

        written = write_report(directory)
        count = 0 if html is None else write_html(html, directory, written, flights, workers)
        pictures, show = partial(drawn, written.runs), partial(show_report, written, show_all)
    else:
        from mavfi.extras.paper.cli_report import show_study_report, write_study_report
        from mavfi.report.html.report_page import drawn_of_study

        written, count = write_study_report(*study, directory, html, flights, workers)
        pictures, show = partial(drawn_of_study, written), partial(show_study_report, written, show_all)
    made = [] if html is None else [f"{html}, with {counted(count, 'flight')}, {html.stat().st_size / 1e6:.1f} MB"]
    if figures is not None:
        made.append(_write_figures(pictures(), figures))
    if as_json:
        write_json(written.to_json())
        return
    show()
    names = _listed([path.relative_to(directory) for path in written.files])
    console().print(f"[dim]wrote[/dim] {names} [dim]in[/dim] {directory}", soft_wrap=True)
    for line in made:
        console().print(f"wrote {line}", style="dim", markup=False, soft_wrap=True)


def _write_figures(drawn: Sequence["Drawn"], folder: Path) -> str:
    """Write figures; return one line of text."""
    from mavfi.cli.progress import Bar
    from mavfi.report.column import write_figure

    paths: list[Path] = []
    with Bar("figures", "figures") as bar:
        for done, one in enumerate(drawn, start=1):
            paths += write_figure(one.figure, folder, one.name)
            bar.show(done, len(drawn))
    return f"{', '.join(path.name for path in paths) or 'no figure'} in {folder}"


def _check_files(html: Path | None, flights: int | None, figures: Path | None, workers: int, view: str) -> None:
    """Reject invalid output options before any flight."""
    if view and (html or figures):
        raise BadInputError("--view: prints one table and writes nothing; allowed: without --html and --figures")
    check_file("--html", html, PAGES)
    check_number("--flights", flights, 0, MOST_FLIGHTS)
    if flights is not None and html is None:
        raise BadInputError(f"--flights: {flights}: there is no page; allowed: together with --html")
    check_number("--workers", workers, 1, MOST_WORKERS)
    if figures is not None:
        check_folder(figures)


def show_report(found: "Report", show_all: bool, views: Sequence[str] = ()) -> None:
    """Print a report: campaign, leading table (or the given views, or all tables), findings."""
    from mavfi.analysis import table_asked_for
    from mavfi.report.terminal import show_header, show_table
    from mavfi.report.text import checks, header

    out = console()
    show_header(header(found.runs.campaign), out)
    leading = [table_asked_for(found.runs, name) for name in views] or found.tables[:1]
    for table in found.tables if show_all else leading:
        show_table(table, out)
    for line in (*(f"· {line}" for line in found.findings), *checks(found.runs)):
        out.print(Text(line))


def _listed(files: Sequence[Path]) -> str:
    """Files by name, those in folders as number per folder: "study.md, tables (17)"."""
    folders = Counter(str(path.parent) for path in files if path.parent != Path())
    named = [str(path) for path in files if path.parent == Path()]
    return ", ".join([*named, *(f"{folder} ({count})" for folder, count in folders.items())])


def _show_view(directory: Path, name: str, *, as_csv: bool, as_json: bool) -> None:
    from mavfi.analysis import Runs, table_asked_for
    from mavfi.analysis.views import applicable
    from mavfi.report.terminal import show_table

    runs = Runs.read(directory)
    if name == "list":
        views = applicable(runs)
        width = max(len(view.name) for view in views)
        for view in views:
            typer.echo(f"{view.name:{width}}  {view.title}")
        return
    found = table_asked_for(runs, name)
    if as_csv:
        typer.echo(found.to_csv(), nl=False)
    elif as_json:
        write_json(found.to_json())
    else:
        show_table(found, console())
