"""`mavfi explain`: what a fault did, step by step."""

from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from mavfi.cli.console import JSON_HELP, console, write_json


def explain(
    directory: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of the ledger.")],
    run_id: Annotated[str, typer.Argument(metavar="RUN_ID", help="The run, or an unambiguous beginning of its id.")],
    as_json: Annotated[bool, typer.Option("--json", help=JSON_HELP)] = False,
) -> None:
    """Fly a run and its golden twin again, and tell what the fault did: to values, to the path, to the mission.

    Example: [bold]mavfi explain out/reproduce dense-10007-fi-planning-3[/bold]
    """
    from mavfi.reports.explain import explain as explain_run
    from mavfi.reports.explain import lines, to_json

    found = explain_run(directory, run_id)
    if as_json:
        write_json(to_json(found))
        return
    table = Table(box=None, show_header=False, pad_edge=False, padding=(0, 2, 0, 0))
    table.add_column(style="bold")
    table.add_column(overflow="fold")
    for heading, sentence in lines(found):
        table.add_row(heading, sentence)
    console().print(table)
