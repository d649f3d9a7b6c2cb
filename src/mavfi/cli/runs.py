"""`mavfi runs`: the runs of a campaign, one line each."""

from typing import Annotated

import typer

from mavfi.cli import options
from mavfi.cli.console import console, write_json


def runs(
    directory: options.Ledger,
    failed: Annotated[bool, typer.Option("--failed", help="Only missions that did not succeed.")] = False,
    where: Annotated[
        list[str] | None,
        typer.Option(metavar="COLUMN=VALUE", help="Only these, e.g. stage=planning; may be given several times."),
    ] = None,
    sort: Annotated[
        list[str] | None,
        typer.Option(metavar="COLUMN", help="Order, e.g. inflation; -inflation puts the largest first."),
    ] = None,
    as_csv: Annotated[bool, typer.Option("--csv", help="All columns as comma-separated values.")] = False,
    as_json: options.AsJson = False,
) -> None:
    """List the runs of a campaign: fault, effect, and mission status.

    Example: [bold]mavfi runs out/states --failed --where environment=dense --sort -flight_time_s[/bold]
    """
    from mavfi.campaign.analysis.listing import listing
    from mavfi.campaign.analysis.runs import Runs
    from mavfi.reports.terminal import show_table

    table = listing(Runs.read(directory), where or (), failed=failed, sort=sort or ())
    if as_csv:
        typer.echo(table.to_csv(), nl=False)
    elif as_json:
        write_json(table.to_json())
    else:
        show_table(table, console())
