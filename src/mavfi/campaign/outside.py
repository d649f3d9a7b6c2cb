"""What is asked of a ledger without opening it: by who is about to open it, and by who only looks on."""

import fcntl
import os
import sqlite3
import struct
from contextlib import closing, suppress
from pathlib import Path
from typing import Any

from mavfi.campaign.connection import connect
from mavfi.campaign.store import FILE, LOCK, Store

_FLOCK = "hhqqi0q"  # struct flock of fcntl(2) on 64-bit Linux: type, whence, start, length, pid


def is_written(directory: Path) -> bool:
    """Whether another process writes the campaign; nothing is locked in order to ask.

    The process that writes must not ask: its lock ends as soon as it closes any handle of the file, fcntl(2).
    """
    with suppress(OSError), (directory / LOCK).open("rb") as lock:
        asked = struct.pack(_FLOCK, fcntl.F_WRLCK, os.SEEK_SET, 0, 0, 0)
        return bool(struct.unpack(_FLOCK, fcntl.fcntl(lock, fcntl.F_GETLK, asked))[0] != fcntl.F_UNLCK)
    return False


def held(directory: Path, key: str) -> Any:
    """`Store.meta` of a ledger that may be absent, empty or damaged (None)."""
    if not (directory / FILE).is_file():
        return None
    with suppress(sqlite3.DatabaseError, ValueError), closing(connect(directory / FILE, "ro")) as connection:
        return Store(directory, connection).meta(key)
    return None
