"""Shared by all commands: output, and checks of input before the first flight (`BadInputError`, one line)."""

import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import typer
from rich import box
from rich.table import Table
from rich.text import Text

from mavfi.errors import BadInputError, not_known, writing
from mavfi.files import exists
from mavfi.output import answer_stream
from mavfi.report.console import WIDE as WIDE
from mavfi.report.console import console as console
from mavfi.report.numbers import counted as counted

MAX_LINE_LENGTH = 2000
"""Maximum length of an error message (characters)."""
FLIGHTS = (".npz",)
PICTURES = (".png", ".svg", ".pdf")
PAGES = (".html",)
"""File name extensions."""


def titled_table(title: str, **more: Any) -> Table:
    """An empty table with a title, in the style of all commands."""
    return Table(title=title, title_style="bold", title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False, **more)


def one_line(text: str) -> str:
    """The text as one line for a terminal: unprintable characters are escaped, long text is shortened in the middle."""
    line = " ".join(text.split())
    if not line.isprintable():
        line = "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in line)
    if len(line) <= MAX_LINE_LENGTH:
        return line
    half = MAX_LINE_LENGTH // 2 - 3
    return f"{line[:half]} ... {line[-half:]}"


def complain(text: str, code: int) -> int:
    """Write one line to stderr, and return the exit code."""
    typer.echo(f"mavfi: {one_line(text)}", err=True)
    return code


def say_written(*paths: Path | None) -> None:
    """Print the files that were written; None = none was asked for."""
    for path in paths:
        if path is not None:
            console().print(Text.assemble(("wrote ", "dim"), str(path)))


def answer(text: str, end: str = "\n") -> None:
    """Write text to stdout as it is."""
    typer.echo(text + end, file=answer_stream(), nl=False)


def write_json(data: Any) -> None:
    """Write plain data to stdout as JSON; infinities and NaN become text."""
    from mavfi.record import plain

    answer(json.dumps(plain(data), indent=2, allow_nan=False))


def check_number(option: str, value: float | None, low: float, high: float) -> None:
    """Refuse a number outside its range, or a non-finite one; None passes."""
    if value is not None and not low <= value <= high:
        raise BadInputError(f"{option}: {value}: allowed: {low:g} to {high:g}")


def check_seed(option: str, value: int) -> None:
    """Refuse a seed outside the range of random streams."""
    from mavfi.mission import LARGEST_SEED

    if not 0 <= value <= LARGEST_SEED:
        raise BadInputError(f"{option}: {value}: allowed: 0 to {LARGEST_SEED}")


def check_name(option: str, value: str, names: Iterable[str]) -> None:
    """Refuse a name that is not in the list."""
    if value not in (allowed := tuple(names)):
        raise BadInputError(f"{option}: {not_known(value, allowed)}")


def check_file(option: str, path: Path | None, endings: Sequence[str]) -> None:
    """Refuse a file with another extension, or one that cannot be written; None passes."""
    if path is not None and path.suffix.lower() not in endings:
        noun = "ending" if len(endings) == 1 else "endings"
        raise BadInputError(f"{option}: {path}: allowed {noun}: {', '.join(endings)}")
    check_writable(path)


def check_writable(path: Path | None) -> None:
    """Refuse a file that cannot be written, before the first flight; an existing file is not changed."""
    if path is None:
        return
    existed = exists(path)
    with writing(path):
        path.open("ab").close()
        if not existed:
            path.unlink()
