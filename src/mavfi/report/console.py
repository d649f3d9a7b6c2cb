"""Consoles for text on stdout and stderr."""

import os
import sys

from rich.console import Console

from mavfi.output import answer_stream

WIDE = 140
"""Width in columns if the output is not a terminal, so that tables in a file are not wrapped."""


class _PipedConsole(Console):
    """A console that a closed pipe (`| head`) does not stop, so that the command keeps its exit code."""

    def on_broken_pipe(self) -> None:
        """Discard what is printed from now on."""
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, answer_stream().fileno())


def console(*, error: bool = False) -> Console:
    """A console for text; progress goes to the one on stderr, so that stdout can be piped."""
    stream = answer_stream()
    if error:
        stream = sys.stderr
    if stream.isatty() or "COLUMNS" in os.environ:
        return _PipedConsole(file=stream, stderr=error, highlight=False)
    return _PipedConsole(file=stream, stderr=error, highlight=False, width=WIDE)
