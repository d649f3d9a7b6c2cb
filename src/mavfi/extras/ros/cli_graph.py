"""`mavfi ros setup | list | watch`: make a ROS 2 environment, inspect and monitor a running ROS graph."""

from __future__ import annotations

from typing import Annotated

import typer

from mavfi.cli.console import console


def setup(
    distributions: Annotated[
        list[str] | None, typer.Argument(metavar="jazzy|kilted", help="One or both; jazzy by default.")
    ] = None,
) -> None:
    """Make an environment with ROS 2 for machines that have none, apart from mavfi's own.

    Nothing is installed where there is a ROS 2 already.

    Example: [bold]mavfi ros setup[/bold]
    """
    from mavfi.extras.ros.ros2.setup import install

    progress = console(error=True)
    out = console()
    for distribution in distributions or ["jazzy"]:
        installation = install(distribution, lambda line: progress.print(line, style="dim", soft_wrap=True))
        out.print(f"ROS 2 {installation.distribution} is here: {installation.prefix}", soft_wrap=True, highlight=False)
    out.print("Next: [bold]mavfi ros list[/bold] shows a running graph.")
