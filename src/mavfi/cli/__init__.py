"""The command line: one file per command.

Only the Ctrl-C handler is imported here, so that Ctrl-C during start-up never prints a traceback.
"""

import sys
import warnings
from collections.abc import Sequence

from mavfi.cli import stopping


def run(arguments: Sequence[str]) -> int:
    """Run one command; see `mavfi.cli.commands.run`."""
    from mavfi.cli import commands

    return commands.run(arguments)


def _tell(message: Warning | str, *_: object) -> None:
    """Show a warning in one line, without a line of code."""
    sys.stderr.write(f"mavfi: {message}\n")


def main() -> None:
    """Entry point of the program `mavfi`."""
    warnings.showwarning = _tell  # type: ignore[assignment] # the other arguments are the place in the code
    try:
        stopping.leave_on_ctrl_c()
        code = run(sys.argv[1:])
    except KeyboardInterrupt:
        code = stopping.EXIT_STOPPED
    sys.exit(code)
