"""Errors reported to users of mavfi.  The command line turns each into one line and an exit code."""

import errno
import os
import re
import sqlite3
from collections.abc import Collection, Iterable, Iterator
from contextlib import contextmanager
from difflib import get_close_matches
from importlib import metadata
from pathlib import Path

_MOST_SHOWN = 12
_MACHINE = {
    errno.ENOSPC,
    errno.EDQUOT,
    errno.EMFILE,
    errno.ENFILE,
    errno.ENOMEM,
    errno.EAGAIN,
    errno.EIO,
    errno.EROFS,
}
_MACHINE_OF_SQLITE = {
    sqlite3.SQLITE_FULL,
    sqlite3.SQLITE_IOERR,
    sqlite3.SQLITE_CANTOPEN,
    sqlite3.SQLITE_READONLY,
    sqlite3.SQLITE_NOMEM,
    sqlite3.SQLITE_PROTOCOL,
    sqlite3.SQLITE_CORRUPT,  # EIO while reading a ledger that was sound when opened
}
_PACKAGE_OF_MODULE = {"elftools": "pyelftools", "foxglove": "foxglove-sdk", "sklearn": "scikit-learn"}
"""Optional packages whose module has another name."""
_NO_MEMORY = "could not allocate"
"""MuJoCo's message; it raises no MemoryError."""

FROM_OUTSIDE = frozenset({"SIGKILL", "SIGTERM", "SIGHUP", "SIGINT", "SIGQUIT"})
"""Signals sent by an operator or the OOM killer, never raised by a fault."""


class MavfiError(Exception):
    """Base of every error that mavfi raises on purpose."""

    def _render_traceback_(self) -> list[str]:
        """What IPython shows in place of a traceback, whose lines tell nothing about a user's error: one line."""
        return [f"{type(self).__name__}: {self}"]


class BadInputError(MavfiError):
    """User input is wrong: the text names item, place, value and what is allowed (exit code 2)."""


class SpecMismatchError(BadInputError):
    """Two items do not match, e.g. a trained model and the pipeline that it should monitor."""


class NotInstalledError(BadInputError):
    """An optional package is needed, but not installed."""


def not_installed(what: str, package: str, extra: str) -> NotInstalledError:
    """Return the error for a feature whose optional package is missing.

    Args:
        what: What the user asked for, as typed: an option, a command, or a file.
        package: The package that is missing.
        extra: The extra of mavfi that brings it.
    """
    return NotInstalledError(f"{what}: needs {package}; install it with: pip install 'mavfi[{extra}]'")


def missing_package(error: ModuleNotFoundError, what: str) -> NotInstalledError | None:
    """Return the error for an optional package of mavfi that an import did not find; None for other modules.

    Args:
        error: Raised by the import.
        what: What the user asked for, as typed.
    """
    module = (error.name or "").partition(".")[0]
    package = _PACKAGE_OF_MODULE.get(module, module)
    sizes = {extra: len(packages) for extra, packages in packages_by_extra().items() if package in packages}
    if not sizes:
        return None
    return not_installed(what, package, min(sizes, key=lambda extra: sizes[extra]))


def packages_by_extra() -> dict[str, set[str]]:
    """Names of the packages of each extra of mavfi, from its metadata."""
    packages: dict[str, set[str]] = {}
    for requirement in metadata.requires("mavfi") or ():
        optional = re.match(r"([\w.-]+).*; extra == ['\"]([\w-]+)['\"]", requirement)
        if optional:
            packages.setdefault(optional[2], set()).add(optional[1])
    return packages


@contextmanager
def naming_extra(what: str) -> Iterator[None]:
    """Convert an import that does not find an optional package to the error that names the extra of mavfi."""
    try:
        yield
    except ModuleNotFoundError as error:
        missing = missing_package(error, what)
        if missing is None:
            raise
        raise missing from None


class MachineError(MavfiError):
    """A failure of the machine (disk, memory, file handles, external signal), not of the flight; never recorded.

    Campaigns retry, then stop; the same command resumes once the cause is removed.
    """


def machine_failure(error: BaseException | None) -> str:
    """The machine failure behind an exception, including its causes and contexts; "" = none."""
    while error is not None:
        if isinstance(error, MachineError):
            return str(error)
        if isinstance(error, MemoryError) or _NO_MEMORY in str(error).lower():
            return "out of memory"
        if isinstance(error, OSError) and error.errno in _MACHINE:
            text = os.strerror(error.errno)
            if error.filename:
                text += f" ({error.filename})"
            return text
        if isinstance(error, sqlite3.Error) and getattr(error, "sqlite_errorcode", 0) & 0xFF in _MACHINE_OF_SQLITE:
            return f"the ledger cannot be read or written ({error})"
        error = error.__cause__ or error.__context__
    return ""


def allowed(names: Collection[str], wanted: str = "") -> str:
    """The allowed names for a message, at most one line: of many, the likeliest first."""
    ordered = list(dict.fromkeys(names))
    if not ordered:
        return "none, there are none"
    if len(ordered) > _MOST_SHOWN:
        likely = get_close_matches(wanted, ordered, 3, 0.5)
        ordered = [*likely, *(name for name in ordered if name not in likely)]
    text = ", ".join(ordered[:_MOST_SHOWN])
    if len(ordered) > _MOST_SHOWN:
        text += f", and {len(ordered) - _MOST_SHOWN} more"
    return text


def not_known(name: object, names: Collection[str], also: str = "") -> str:
    """The end of a message on a name that is not allowed.

    Args:
        name: The name.
        names: All that are allowed.
        also: What else is allowed, in words, e.g. "or a path to a .yaml file".
    """
    text = f"{name!r}: not known{hint(name, names)}; allowed: {allowed(names, str(name))}"
    if also:
        text += f", {also}"
    return text


def hint(wanted: object, names: Iterable[str]) -> str:
    """A question after an unknown name: whether the most similar of some names is meant; "" = none is similar."""
    if not isinstance(wanted, str):
        return ""
    similar = get_close_matches(wanted, list(names), 1, 0.6)
    if similar:
        return f" (did you mean '{similar[0]}'?)"
    return ""


@contextmanager
def writing(path: Path | str) -> Iterator[None]:
    """Convert an operating-system error while writing a file or folder to a `BadInputError` that names it."""
    try:
        yield
    except OSError as error:
        raise BadInputError(f"{path}: cannot be written ({error.strerror})") from None


def write_text(path: Path, content: str) -> None:
    """Write a text file; raises a `BadInputError` that names it if it cannot be written."""
    with writing(path):
        path.write_text(content, encoding="utf-8")
