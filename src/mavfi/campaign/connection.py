"""Connections to the file of a ledger."""

import os
import sqlite3
from pathlib import Path

from mavfi.errors import BadInputError


def connect(path: Path, mode: str) -> sqlite3.Connection:
    """Open a ledger's file, also on read-only media.

    Raises:
        BadInputError: The file cannot be opened.
    """
    options = f"mode={mode}"
    if mode == "ro" and not os.access(path.parent, os.W_OK):  # SQLite cannot create its auxiliary files
        log = path.with_name(f"{path.name}-wal")
        if log.exists() and log.stat().st_size > 0:
            raise BadInputError(f"{path}: was not closed; open it once on writable media")
        options += "&immutable=1"
    try:
        return sqlite3.connect(f"{path.absolute().as_uri()}?{options}", uri=True)
    except sqlite3.OperationalError as error:
        raise BadInputError(f"{path}: cannot be opened ({error})") from None
