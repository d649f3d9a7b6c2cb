"""`mavfi redundancy`: flight time and energy of a UAV with redundant processors, compared with a detector."""

from pathlib import Path
from typing import Annotated

import typer

from mavfi.cli.console import PICTURES, check_file, console, say_written


def redundancy(
    vehicle: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME|FILE.yaml",
            help="A shipped design (configs/redundancy), or a YAML file of your own; may be given several times. All "
            "shipped ones by default.",
        ),
    ] = None,
    picture: Annotated[Path | None, typer.Option(metavar="FILE.png", help="Draw the comparison.")] = None,
) -> None:
    """Compare flight time and energy with redundant processors (DMR, TMR) and with detection, by a performance model.

    Needs no flights. A vehicle file needs name, mass (kg) and max_thrust (N).

    Example: [bold]mavfi redundancy --vehicle my_drone.yaml --picture redundancy.png[/bold]
    """
    from rich.text import Text

    from mavfi.extras.paper.redundancy import find_design, shipped_designs
    from mavfi.extras.paper.redundancy_figure import redundancy as draw
    from mavfi.extras.paper.redundancy_views import redundancy_tables, summary
    from mavfi.report import style
    from mavfi.report.text import show_table

    check_file("--picture", picture, PICTURES)
    designs = [find_design(name) for name in vehicle] if vehicle else shipped_designs()
    tables = redundancy_tables(designs)
    if picture is not None:
        with style.house_style():
            style.write(draw(designs), picture)
    out = console()
    for sentence in summary(designs):
        out.print(Text(sentence))
    out.print()
    for table in tables:
        show_table(table, out)
    say_written(picture)
