"""Queries of a ledger without opening it as a `Store`, before opening it or for monitoring."""

import fcntl
import os
import sqlite3
import struct
from contextlib import closing, suppress
from pathlib import Path
from typing import Any

from mavfi.campaign.connection import connect
from mavfi.campaign.store import FILE, LOCK, Store
from mavfi.files import is_file

_FLOCK = "hhqqi0q"  # struct flock of fcntl(2) on 64-bit Linux: type, whence, start, length, pid


def is_written(directory: Path) -> bool:
    """Whether another process writes the campaign; the query itself takes no lock.

    The writing process must not call this: closing any handle of the file releases its lock, fcntl(2).
    """
    with suppress(OSError), (directory / LOCK).open("rb") as lock:
        asked = struct.pack(_FLOCK, fcntl.F_WRLCK, os.SEEK_SET, 0, 0, 0)
        return bool(struct.unpack(_FLOCK, fcntl.fcntl(lock, fcntl.F_GETLK, asked))[0] != fcntl.F_UNLCK)
    return False


def held(directory: Path, key: str) -> Any:
    """`Store.meta` of a ledger; None if it is absent, empty or damaged."""
    if not is_file(directory / FILE):
        return None
    with suppress(sqlite3.DatabaseError, ValueError), closing(connect(directory / FILE, "ro")) as connection:
        return Store(directory, connection).meta(key)
    return None
