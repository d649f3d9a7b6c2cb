"""Ctrl-C: work with results to keep is stopped cleanly; everything else exits at once, with exit code 130."""

import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

EXIT_STOPPED = 130
"""Exit code after Ctrl-C, by shell convention."""


def leave_on_ctrl_c() -> None:
    """Make Ctrl-C end the process silently, also during imports, where an exception would print a traceback."""
    signal.signal(signal.SIGINT, _leave)


def _leave(number: int, frame: FrameType | None) -> None:
    os._exit(EXIT_STOPPED)


@contextmanager
def stoppable(message: str) -> Iterator[None]:
    """Work with results to keep: Ctrl-C ends it cleanly, prints `message` on stderr, and exits with code 130."""
    import typer

    from mavfi.cli.console import console

    leaving = signal.getsignal(signal.SIGINT) is _leave
    if leaving:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        yield
    except KeyboardInterrupt:
        console(error=True).print(message)
        raise typer.Exit(EXIT_STOPPED) from None
    finally:
        if leaving:
            signal.signal(signal.SIGINT, _leave)
