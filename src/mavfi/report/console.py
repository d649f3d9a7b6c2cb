"""Consoles for text on stdout and stderr."""

import os
import sys

from rich.console import Console

WIDE = 140
"""Width in columns if the output is not a terminal, so that tables in a file are not wrapped."""


def console(*, error: bool = False) -> Console:
    """A console for text; progress goes to the one on stderr, so that stdout can be piped."""
    stream = sys.stderr if error else sys.stdout
    if stream.isatty() or "COLUMNS" in os.environ:
        return Console(stderr=error, highlight=False)
    return Console(stderr=error, highlight=False, width=WIDE)
