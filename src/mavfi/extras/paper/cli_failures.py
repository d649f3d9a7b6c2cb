"""`mavfi failures`: failures per flight hour of each setting of a campaign."""

from typing import Annotated

import typer

from mavfi.cli import options
from mavfi.cli.console import console
from mavfi.errors import BadInputError


def failures(
    directory: options.Ledger,
    upsets: Annotated[
        str, typer.Option(metavar="NAME|FILE.yaml", help="Upset rates: shipped (configs/upsets), or your own.")
    ] = "low_altitude",
) -> None:
    """Compare settings by failures per flight hour: upset rate x instructions x harm, of detectors and recovery too.

    Harm is the increase in mission failures per fault. Needs a campaign with instruction faults in which the golden
    runs of every arm are counted, e.g. failure_rate.

    Example: [bold]mavfi failures out/failure_rate --upsets my_upsets.yaml[/bold]
    """
    from rich.text import Text

    from mavfi.analysis import Runs
    from mavfi.extras.paper.failure_rate import find_upsets
    from mavfi.extras.paper.failure_views import failure_table, summary
    from mavfi.report.text import show_table

    chosen, runs = find_upsets(upsets), Runs.read(directory)
    table = failure_table(runs, chosen)
    if not table.rows:
        raise BadInputError(f"{directory}: no faults in instructions whose golden runs were counted; needed: some")
    out = console()
    for sentence in summary(runs, chosen):
        out.print(Text(sentence))
    out.print()
    show_table(table, out)
