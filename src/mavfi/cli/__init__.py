"""The command line: one file per command.

Only the Ctrl-C handler is imported here, so that Ctrl-C during start-up never prints a traceback.
"""

import atexit
import gc
import os
import sys
import threading
import warnings
from collections.abc import Sequence
from typing import NoReturn

from mavfi.cli import stopping

_COLLECT_AFTER = 50_000
"""New objects after which Python looks for cycles; imports alone make four times as many, which all stay."""


def run(arguments: Sequence[str]) -> int:
    """Run one command; see `mavfi.cli.commands.run`."""
    from mavfi.cli import commands
    from mavfi.output import answering

    with answering():
        return commands.run(arguments)


def _tell(message: Warning | str, *_: object) -> None:
    """Show a warning in one line, without a line of code."""
    sys.stderr.write(f"mavfi: {message}\n")


def main() -> None:
    """Entry point of the program `mavfi`."""
    warnings.showwarning = _tell  # type: ignore[assignment] # the other arguments are the place in the code
    gc.set_threshold(_COLLECT_AFTER)
    try:
        stopping.leave_on_ctrl_c()
        code = run(sys.argv[1:])
    except KeyboardInterrupt:
        code = stopping.EXIT_STOPPED
    _leave(code)


def _leave(code: int) -> NoReturn:
    """End without freeing memory object by object, a sixth of the time of a short flight (as mypy does).

    As at any exit, exit functions are called, output is written, and other threads are waited for.
    """
    if threading.active_count() == 1:
        atexit._run_exitfuncs()
        try:
            sys.stdout.flush()
            sys.stderr.flush()
        except (OSError, ValueError):  # closed, or the disk is full: Python's own exit says so
            sys.exit(code)
        os._exit(code)
    sys.exit(code)
