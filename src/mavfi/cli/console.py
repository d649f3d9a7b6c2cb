"""What all verbs share: where text goes, how numbers look, what is checked before anything is flown."""

import json
import os
import sys
from pathlib import Path
from typing import Any

import typer
from rich.console import Console

from mavfi.errors import BadInputError
from mavfi.mission import LARGEST_SEED

WIDE = 140
"""Columns where the output is no terminal: tables in a file are not folded."""
PICTURES = (".png", ".svg", ".pdf")
JSON_HELP = "One JSON object instead of text."


def console(*, error: bool = False) -> Console:
    """A console for text; progress goes to the one on stderr, so that stdout can be piped."""
    stream = sys.stderr if error else sys.stdout
    width = None if stream.isatty() or "COLUMNS" in os.environ else WIDE
    return Console(stderr=error, highlight=False, width=width)


def complain(text: str, code: int) -> int:
    """Write one line to stderr, and answer the exit code."""
    typer.echo(f"mavfi: {' '.join(text.split())}", err=True)
    return code


def write_json(data: Any) -> None:
    """Write plain data to stdout as JSON; infinities and NaN become text."""
    from mavfi.flight_record import plain

    typer.echo(json.dumps(plain(data), indent=2, allow_nan=False))


def check_number(name: str, value: float | None, low: float, high: float) -> None:
    """Refuse a number outside of its range, or one that is not finite; None passes.

    Raises:
        BadInputError: One line that names option, value and range.
    """
    if value is not None and not low <= value <= high:
        raise BadInputError(f"{name}: {value}: allowed: {low:g} to {high:g}")


def check_seed(name: str, value: int) -> None:
    """Refuse a seed that no random stream takes.

    Raises:
        BadInputError: It is negative or too large.
    """
    if not 0 <= value <= LARGEST_SEED:
        raise BadInputError(f"{name}: {value}: allowed: 0 to {LARGEST_SEED}")


def check_writable(path: Path | None) -> None:
    """Refuse a file that could not be written, before anything is flown; what is there stays as it is.

    Raises:
        BadInputError: One line with the reason.
    """
    if path is None:
        return
    there = path.exists()
    try:
        with path.open("ab"):
            pass
        if not there:
            path.unlink()
    except OSError as error:
        raise BadInputError(f"{path}: cannot be written ({error.strerror})") from None


def check_picture(path: Path | None) -> None:
    """Refuse a picture of an unknown format, or one that could not be written.

    Raises:
        BadInputError: One line that names the file.
    """
    if path is not None and path.suffix.lower() not in PICTURES:
        raise BadInputError(f"--picture: {path}: allowed endings: {', '.join(PICTURES)}")
    check_writable(path)


def check_folder(folder: Path) -> None:
    """Make a folder and refuse one that cannot be written into.

    Raises:
        BadInputError: One line with the reason.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        probe = folder / ".mavfi-probe"
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise BadInputError(f"{folder}: cannot be written ({error.strerror})") from None
