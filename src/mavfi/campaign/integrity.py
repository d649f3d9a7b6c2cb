"""The file of a ledger: how it is opened, its tables, the checksums of its rows, and what damages it.

Checksums cover the row and, as a salt, the identity of the campaign, so that rows of another campaign are rejected.
Ledgers of an older mavfi have no salt, and no `BOUND` row.  Checksums detect damage, but a forged ledger can have valid
ones.  So types are checked as well.
"""

import hashlib
import json
import os
import sqlite3
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from mavfi.config import checked
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


INDEX = "runs_by_mission ON runs (environment, seed, position)"
"""Without this index, finding the runs of a mission reads all runs; it is added to ledgers of earlier versions."""
TABLES = f"""
CREATE TABLE meta (key TEXT PRIMARY KEY, value TEXT NOT NULL, checksum TEXT NOT NULL);
CREATE TABLE runs (
    run_id TEXT PRIMARY KEY,
    position INTEGER NOT NULL UNIQUE,
    kind TEXT NOT NULL,
    setting TEXT NOT NULL,
    environment TEXT NOT NULL,
    seed INTEGER NOT NULL,
    spec TEXT NOT NULL,
    record TEXT,
    note TEXT NOT NULL DEFAULT '',
    wall_s REAL,
    checksum TEXT NOT NULL
);
CREATE TABLE missions (environment TEXT, seed INTEGER, checksum TEXT NOT NULL, PRIMARY KEY (environment, seed));
CREATE INDEX {INDEX};
"""
PLANNED = "run_id, position, kind, setting, environment, seed, spec"
_TYPES = {
    "run_id": "text", "position": "integer", "kind": "text", "setting": "text", "environment": "text",
    "seed": "integer", "spec": "text", "record": "text null", "note": "text", "wall_s": "real null",
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class _Identity:
    campaign: dict[str, Any]
    models: dict[str, str]


@dataclass(frozen=True, slots=True)
class _Meta:
    identity: _Identity
    versions: dict[str, str] | None = None
    missions: int | None = None
    models_dir: str | None = None
    generation: int | None = None
    shard: str | None = None
    campaign: str | None = None
    bound: bool | None = None


def damage(connection: sqlite3.Connection) -> str:
    """The first violation of integrity; "" = none."""
    try:
        return strange_schema(connection) or _structure(connection) or _checksums(connection) or _types(connection)
    except (sqlite3.DatabaseError, TypeError, UnicodeDecodeError) as error:  # TypeError: a value has the wrong type
        return " ".join(str(error).split())  # SQLite quotes text of the file, with its line breaks


def strange_schema(connection: sqlite3.Connection) -> str:
    """The first foreign object of the schema; "" = none.  Reading a view in place of a table would execute it."""
    held = connection.execute("SELECT type, name, sql FROM sqlite_master WHERE sql IS NOT NULL").fetchall()
    wanted = {statement.strip() for statement in TABLES.split(";")}
    for kind, name, sql in held:
        if sql not in wanted:
            return f"{kind} {name!r} is not of a ledger"
    return ""


def _structure(connection: sqlite3.Connection) -> str:
    sound = connection.execute("PRAGMA integrity_check(1)").fetchone()[0]
    return "" if sound == "ok" else str(sound).splitlines()[-1]


def _checksums(connection: sqlite3.Connection) -> str:
    salt = salt_of(connection)
    for key, value, checksum in connection.execute("SELECT key, value, checksum FROM meta"):
        if checksum != meta_checksum(key, value, salt):
            return f"metadata {key!r}: checksum mismatch"
    rows = connection.execute(f"SELECT {PLANNED}, record, note, wall_s, checksum FROM runs")
    for run_id, *rest, checksum in rows:
        if checksum != checksum_of(run_id, *rest, *salt):
            return f"run {run_id!r}: checksum mismatch"
    for environment, seed, checksum in connection.execute("SELECT * FROM missions ORDER BY 1, 2"):
        if checksum != mission_checksum(connection, (environment, seed), salt):
            return f"mission {environment}-{seed}: runs are missing or were added"
    return ""


def _types(connection: sqlite3.Connection) -> str:
    """The first value of a wrong type; "" = none."""
    try:
        items = {key: json.loads(value) for key, value in connection.execute("SELECT key, value FROM meta")}
        if "identity" not in items:
            return "metadata are missing"
        json.dumps(items, allow_nan=False)
        checked(_Meta, items, "metadata")
    except (BadInputError, RecursionError, ValueError) as error:
        return str(error)
    for column, kinds in _TYPES.items():
        allowed = ", ".join(f"'{kind}'" for kind in kinds.split())
        json_too = f" OR {column} IS NOT NULL AND NOT json_valid({column})" if column in ("spec", "record") else ""
        query = f"SELECT run_id FROM runs WHERE typeof({column}) NOT IN ({allowed}){json_too} LIMIT 1"
        row = connection.execute(query).fetchone()
        if row is not None:
            return f"run {row[0]!r}: key {column!r}: allowed: {kinds.replace(' ', ' or ')}"
    return ""
