"""`mavfi report`: the tables of a campaign in the terminal; report.md and figures in its folder."""

from pathlib import Path
from typing import Annotated, Any

import typer

from mavfi.cli.console import JSON_HELP, check_folder, console, write_json


def report(
    directory: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of the ledger.")],
    as_json: Annotated[bool, typer.Option("--json", help=JSON_HELP)] = False,
    draw_run: Annotated[bool, typer.Option(help="Fly a telling run again and draw it.")] = True,
) -> None:
    """Print the tables of a campaign, and write report.md, its figures and summary.json into its folder.

    Example: [bold]mavfi report out/states[/bold]
    """
    from mavfi.campaign.store import Store
    from mavfi.reports.campaign_report import write_report
    from mavfi.reports.terminal import show

    with Store.open(directory) as store:  # what is no campaign is left as it is
        of_nodes = store.is_of_nodes
    check_folder(directory)
    if of_nodes:
        _report_nodes(directory, as_json)
        return
    out = console()

    def tell(analysis: dict[str, Any]) -> None:
        if as_json:
            write_json(analysis)
        else:
            show(analysis, out)

    written = write_report(directory, draw_run=draw_run, shown=tell)
    if not as_json:
        out.print(f"[dim]wrote[/dim] {', '.join(path.name for path in written.files)} [dim]in[/dim] {directory}")


def _report_nodes(directory: Path, as_json: bool) -> None:
    """The same of a campaign on a ROS node."""
    from mavfi.reports.node_report import show_nodes, write_node_report

    analysis, files = write_node_report(directory)
    if as_json:
        write_json(analysis)
        return
    out = console()
    show_nodes(analysis, out)
    out.print(f"[dim]wrote[/dim] {', '.join(path.name for path in files)} [dim]in[/dim] {directory}")
