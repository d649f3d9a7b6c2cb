"""`mavfi demo`: ten telling faults, or one of them with its picture."""

from __future__ import annotations

from contextlib import AbstractContextManager
from pathlib import Path
from textwrap import fill, indent
from typing import TYPE_CHECKING, Annotated

import typer
from rich.text import Text

from mavfi.cli.console import PAGES, check_file, check_writable, console, say_written
from mavfi.errors import BadInputError

if TYPE_CHECKING:
    from mavfi.extras.demo.faults import FlownDemo

HELP_PANEL = "Fly and look"
_WIDTH = 80
"""Width of the text (characters)."""
_INDENT = " " * 5
_FURTHER = "mavfi demo 3 draws one of them; mavfi demo --html demo.html shows all in 3-D."


def demo(
    number: Annotated[
        int | None, typer.Argument(metavar="NUMBER", help="One of them, with its picture; all by default.")
    ] = None,
    html: Annotated[
        Path | None, typer.Option(metavar="FILE.html", help="Write a page with pictures, and flights in 3-D.")
    ] = None,
) -> None:
    """Fly ten telling faults, or draw one of them.

    Each is flown without the fault, with it, and with it under the detector recommended. With a number, this one is
    drawn to demo-NUMBER.png.

    Example: [bold]mavfi demo 3[/bold]
    """
    check_file("--html", html, PAGES)
    if number is not None and html is not None:
        raise BadInputError("--html: the page has all flights; allowed: without a number")
    if number is None:
        _show_all(html)
    else:
        _show_one(number)


def _show_one(number: int) -> None:
    """Fly, tell and draw one fault."""
    from mavfi.extras.demo import faults
    from mavfi.report.progress import compiling

    chosen = faults.demo(number)
    picture = Path(f"demo-{number}.png")
    check_writable(picture)
    with compiling(instrumented="instruction" in chosen.fault, flight=True):
        flown = faults.FlownDemo(number, chosen, chosen.fly())
    _show(flown)
    flown.result.plot().savefig(picture)
    out = console()
    out.print(Text(chosen.command, style="dim"), soft_wrap=True)
    say_written(picture)


def _show_all(html: Path | None) -> None:
    """Fly all faults, tell each when it is flown, and write their page if a file is named."""
    from mavfi.extras.demo import faults
    from mavfi.report.progress import Bar, compiling

    flown = []
    for number, chosen in enumerate(faults.DEMOS, start=1):
        waiting: AbstractContextManager[object]
        if number == 1:
            waiting = compiling(instrumented=True, flight=True)
        else:
            waiting = console(error=True).status(f"{number} of {len(faults.DEMOS)}: {chosen.title} ...")
        with waiting:
            flown.append(faults.FlownDemo(number, chosen, chosen.fly()))
        _show(flown[-1])
    out = console()
    out.print(Text(fill(faults.headline(flown), _WIDTH), style="bold"))
    if html is None:
        out.print(Text(_FURTHER, style="dim"))
        return
    from mavfi.extras.demo.page import write_demo_page

    with Bar("page", unit="faults") as bar:
        write_demo_page(html, flown, bar.show)
    say_written(html)


def _show(flown: FlownDemo) -> None:
    """Print the number and title of a fault, and below it what happened."""
    mark = Text("✓", style="green")
    if flown.is_lost:
        mark = Text("✗", style="red")
    out = console()
    out.print(Text.assemble(f"{flown.number:2} ", mark, " ", (flown.demo.title, "bold")))
    out.print(Text(indent(fill(flown.sentence, _WIDTH - len(_INDENT)), _INDENT)))
