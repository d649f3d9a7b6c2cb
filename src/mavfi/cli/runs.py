"""`mavfi runs`: the runs of a campaign, one line each."""

from typing import Annotated

import typer

from mavfi.cli import options
from mavfi.cli.console import console, write_json


def runs(
    directory: options.Ledger,
    failed: Annotated[bool, typer.Option("--failed", help="Only missions that did not succeed.")] = False,
    as_csv: Annotated[bool, typer.Option("--csv", help="All columns as comma-separated values.")] = False,
    as_json: options.AsJson = False,
) -> None:
    """List the runs of a campaign: fault, effect, and mission status.

    Example: [bold]mavfi runs out/states --failed[/bold]
    """
    from mavfi.analysis.listing import listing
    from mavfi.analysis.runs import Runs
    from mavfi.report.terminal import show_table

    table = listing(Runs.read(directory), failed=failed)
    if as_csv:
        typer.echo(table.to_csv(), nl=False)
    elif as_json:
        write_json(table.to_json())
    else:
        show_table(table, console())
