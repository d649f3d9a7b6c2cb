"""The command line: one file per command.

Only the Ctrl-C handler is imported here, so that Ctrl-C during start-up never prints a traceback.
"""

import sys
from collections.abc import Sequence

from mavfi.cli import stopping


def run(arguments: Sequence[str]) -> int:
    """Run one command; see `mavfi.cli.commands.run`."""
    from mavfi.cli import commands

    return commands.run(arguments)


def main() -> None:
    """Entry point of the program `mavfi`."""
    try:
        stopping.leave_on_ctrl_c()
        code = run(sys.argv[1:])
    except KeyboardInterrupt:
        code = stopping.EXIT_STOPPED
    sys.exit(code)
