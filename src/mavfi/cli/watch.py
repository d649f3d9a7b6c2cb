"""`mavfi campaign status --watch`: progress of a campaign running in another process, redrawn until it is complete."""

import time
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Group, RenderableType
from rich.live import Live
from rich.text import Text

from mavfi.campaign.watch import Watch
from mavfi.cli.console import console
from mavfi.cli.progress import speed, success_counts, time_left
from mavfi.cli.stopping import stoppable

if TYPE_CHECKING:
    from mavfi.campaign.watch import Outlook

_MOST_MISSIONS = 8


def watch(directory: Path, every: float) -> None:
    """Redraw the progress of a campaign, `every` seconds, until it is complete; without a terminal, print lines.

    Raises:
        BadInputError: The ledger is absent or damaged.
    """
    watched, out = Watch(directory), console()
    with stoppable("Stopped watching; the campaign is left as it is."):
        outlook = watched.look()
        with Live(_drawn(outlook), console=out, auto_refresh=False, transient=not out.is_terminal) as live:
            while not outlook.complete:
                if not out.is_terminal:
                    out.print(_headline(outlook), soft_wrap=True)
                time.sleep(every)
                outlook = watched.look()
                live.update(_drawn(outlook), refresh=True)
        if not out.is_terminal:
            out.print(_drawn(outlook))


def _drawn(outlook: "Outlook") -> RenderableType:
    parts: list[RenderableType] = [_headline(outlook), success_counts(outlook.settings)]
    if outlook.in_the_air:
        shown = ", ".join(outlook.in_the_air[:_MOST_MISSIONS])
        more = len(outlook.in_the_air) - _MOST_MISSIONS
        workers = "" if outlook.workers is None else f" (workers: {outlook.workers})"
        parts.append(Text(f"in the air: {shown}{f' and {more} more' if more > 0 else ''}{workers}"))
    parts += [Text(line, style="red", overflow="ellipsis", no_wrap=True) for line in outlook.errors]
    return Group(*parts)


def _headline(outlook: "Outlook") -> Text:
    """Runs, speed and remaining time, or the reason for their absence."""
    parts = [f"{outlook.done} of {outlook.total} runs"]
    if outlook.complete:
        parts.append("complete")
    elif not outlook.flying:
        parts.append("nobody flies it; `mavfi campaign run` resumes")
    else:
        parts += [speed(outlook.rate, "runs")] if outlook.rate > 0 else []
        parts.append(time_left(outlook.remaining_s))
    if outlook.unknown:
        parts.append(f"{outlook.unknown} with status unknown")
    return Text(" · ".join(parts))
