"""Errors that a user of mavfi can meet.  The command line turns each into one line and an exit code."""

from collections.abc import Collection, Iterator
from contextlib import contextmanager
from difflib import get_close_matches
from pathlib import Path

_MOST_SHOWN = 12


class MavfiError(Exception):
    """Base of every error that mavfi raises on purpose."""


class BadInputError(MavfiError):
    """Something the user gave is wrong: the text names what, where, its value and what is allowed (exit code 2)."""


class SpecMismatchError(BadInputError):
    """Two things that must belong together do not, e.g. a trained model and the stack that it should watch."""


def allowed(names: Collection[str], wanted: str = "") -> str:
    """The names that there are, for a message: the likeliest first, not more than a line holds."""
    likely = get_close_matches(wanted, names, 3, 0.5)
    ordered = [*likely, *sorted(set(names) - set(likely))]
    more = f", and {len(ordered) - _MOST_SHOWN} more" if len(ordered) > _MOST_SHOWN else ""
    return (", ".join(ordered[:_MOST_SHOWN]) + more) if ordered else "none, there are none"


@contextmanager
def writing(path: Path | str) -> Iterator[None]:
    """Turn an error of the operating system while a file or folder is written into a `BadInputError` that names it."""
    try:
        yield
    except OSError as error:
        raise BadInputError(f"{path}: cannot be written ({error.strerror})") from None
