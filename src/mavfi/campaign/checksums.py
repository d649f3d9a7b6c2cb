"""Checksums of a ledger's rows.

They cover the row and, as a salt, the identity of the campaign, so that rows of another campaign are rejected.  Ledgers
of an older mavfi have no salt, and no `BOUND` row.
"""

import hashlib
import sqlite3
from collections.abc import Sequence
from functools import lru_cache
from typing import Any

IDENTITY, BOUND = "identity", "bound"
"""Metadata keys: the identity of the campaign; a mark that checksums are salted with it."""


def checksum_of(*values: str | int | float | None) -> str:
    """Checksum of the values of a row, types included."""
    return hashlib.sha256(repr(values).encode()).hexdigest()[:32]


def mission_checksum(connection: sqlite3.Connection, world: tuple[Any, ...], salt: Sequence[str]) -> str:
    """Checksum of the planned runs of a mission, given by environment and seed."""
    query = "SELECT run_id, position FROM runs WHERE environment = ? AND seed = ? ORDER BY position"
    return checksum_of(*world, *(part for row in connection.execute(query, world) for part in row), *salt)


def meta_checksum(key: str, value: str, salt: Sequence[str]) -> str:
    """Checksum of a metadata row; rows `IDENTITY` and `BOUND` have no salt."""
    return checksum_of(key, value) if key in (IDENTITY, BOUND) else checksum_of(key, value, *salt)


def salt_of(connection: sqlite3.Connection) -> tuple[str, ...]:
    """Salt of the checksums, from the campaign's identity; () = a ledger of an older mavfi, or a new one."""
    query = "SELECT value FROM meta WHERE key = ? AND EXISTS (SELECT 1 FROM meta WHERE key = ?)"
    return tuple(_salt(identity) for (identity,) in connection.execute(query, (IDENTITY, BOUND)))


@lru_cache(maxsize=8)
def _salt(identity: str) -> str:
    """Checksum of an identity, which is long, and the same for all rows."""
    return checksum_of(identity)
