"""Safe reading of files from other sources: regular files of bounded size."""

import os
import stat
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

from mavfi.errors import BadInputError, writing

LARGEST_TEXT = 1 << 22
"""Largest size of a text file (bytes)."""


def read_file(path: Path, most: int) -> bytes:
    """Content of a file of at most `most` bytes.

    Raises:
        BadInputError: It cannot be read, is larger, or is a device or a pipe, which may be endless.
    """
    check_regular(path)
    try:
        with path.open("rb") as file:
            content = file.read(most + 1)
    except OSError as error:
        raise BadInputError(f"{path}: cannot be read ({error.strerror})") from None
    if len(content) > most:
        raise BadInputError(f"{path}: is too large; allowed: {most:,} bytes")
    return content


def is_file(path: Path) -> bool:
    """Whether there is such a regular file; a name that no file can have (too long, with a NUL) is that of none."""
    return os.path.isfile(path)  # noqa: PTH113 - Path.is_file raises for such a name


def is_dir(path: Path) -> bool:
    """Whether there is such a folder; a name that no folder can have is that of none."""
    return os.path.isdir(path)  # noqa: PTH112


def exists(path: Path) -> bool:
    """Whether there is something of that name; a name that nothing can have is that of nothing."""
    return os.path.exists(path)  # noqa: PTH110


def check_regular(path: Path) -> None:
    """Raise a `BadInputError` for a device, a pipe or a missing file; folders pass."""
    try:
        mode = path.stat().st_mode
    except OSError as error:
        raise BadInputError(f"{path}: cannot be read ({error.strerror})") from None
    except ValueError as error:  # a name with a NUL
        raise BadInputError(f"{path}: no name of a file ({error})") from None
    if not stat.S_ISREG(mode) and not stat.S_ISDIR(mode):
        raise BadInputError(f"{path}: is a device or a pipe; allowed: a regular file")


def check_folder(folder: Path) -> None:
    """Refuse a folder that cannot be written, or made; one that is absent stays so until something is written."""
    absent = absent_folders(folder)
    with writing(folder):
        make_folder(folder)
        probe = folder / ".mavfi-probe"
        probe.touch()
        probe.unlink()
    remove_folders(absent)


def make_folder(folder: Path) -> None:
    """Make a folder for what is written to it; raises a `BadInputError` if it cannot be made."""
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)


def absent_folders(folder: Path) -> list[Path]:
    """A folder and those around it, as far as they do not exist, the innermost first."""
    absent = []
    while not exists(folder):
        absent.append(folder)
        folder = folder.parent
    return absent


def remove_folders(folders: Iterable[Path]) -> None:
    """Remove folders, the innermost first, as far as they are empty."""
    for folder in folders:
        with suppress(OSError):
            folder.rmdir()
