"""Recovers the intact rows of a damaged ledger; resuming the campaign flies the missing runs."""

import sqlite3
from collections.abc import Iterator
from contextlib import closing, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mavfi.campaign.integrity import (
    BOUND,
    IDENTITY,
    PLANNED,
    TABLES,
    checksum_of,
    connect,
    meta_checksum,
    mission_checksum,
    strange_schema,
)
from mavfi.campaign.store import FILE, SCHEMA, Store
from mavfi.errors import BadInputError, writing
from mavfi.files import is_file
from mavfi.record import canonical

DAMAGED = "campaign.damaged.sqlite"
"""Backup of the damaged file."""
_RUNS = f"{PLANNED}, record, note, wall_s, checksum"
_UNREADABLE = (sqlite3.DatabaseError, UnicodeDecodeError)
"""SQLite quotes a damaged schema in its message, which then is no valid text."""


@dataclass(frozen=True, slots=True)
class Repair:
    """Outcome of a repair."""

    kept: int  # runs
    lost: int  # runs with a checksum mismatch
    was_intact: bool = False  # nothing was damaged, and nothing is changed


def repair(directory: Path) -> Repair:
    """Replace a damaged ledger by one with all its intact rows; the damaged file is kept as a backup.

    An intact ledger is left as it is.

    Raises:
        BadInputError: The ledger is absent, its metadata are damaged, or a backup exists already.
    """
    path, damaged, whole = directory / FILE, directory / DAMAGED, directory / f"{FILE}.repaired"
    if not is_file(path):
        raise BadInputError(f"{directory}: holds no campaign (no {FILE})")
    if (runs_of_intact := _intact(directory)) is not None:
        return Repair(runs_of_intact, 0, was_intact=True)
    if damaged.exists():
        raise BadInputError(f"{damaged}: exists already, from an earlier repair; move it away first")
    with closing(connect(path, "ro")) as source:
        with suppress(*_UNREADABLE):  # the schema may be damaged, too: readable rows are kept
            if strange := strange_schema(source):
                raise BadInputError(f"{path}: {strange}")
        meta = list(_rows(source, "SELECT key, value, checksum FROM meta"))
        runs = list(_rows(source, f"SELECT {_RUNS} FROM runs"))
        missions = list(_rows(source, "SELECT environment, seed, checksum FROM missions"))
    identity = next(
        (value for key, value, checksum in meta if (key, checksum) == (IDENTITY, checksum_of(key, value))), ""
    )
    if not identity:
        raise BadInputError(f"{path}: its metadata are damaged: the campaign cannot be identified")
    salts: list[tuple[str, ...]] = [(checksum_of(identity),), ()]  # try both: row `BOUND` may be damaged
    salt, described, sound = max(
        ((salt, _described(meta, salt), _sound(runs, salt)) for salt in salts), key=lambda kept: len(kept[1] + kept[2])
    )
    with writing(whole):
        whole.unlink(missing_ok=True)
        with closing(sqlite3.connect(whole)) as target:
            target.executescript(f"BEGIN; {TABLES} PRAGMA user_version = {SCHEMA};")
            with target:
                target.executemany("INSERT OR IGNORE INTO meta VALUES (?, ?, ?)", described)
                marks = ", ".join("?" * len(_RUNS.split(", ")))
                target.executemany(f"INSERT OR IGNORE INTO runs ({_RUNS}) VALUES ({marks})", sound)
                # incomplete missions are replanned on resume
                complete = [m for m in missions if m[-1] == mission_checksum(target, m[:-1], salt)]
                target.executemany("INSERT OR IGNORE INTO missions VALUES (?, ?, ?)", complete)
        path.rename(damaged)
        for ending in ("-wal", "-shm"):
            with suppress(FileNotFoundError):
                path.with_name(path.name + ending).rename(damaged.with_name(damaged.name + ending))
        whole.rename(path)
    return Repair(len(sound), len(runs) - len(sound))


def _intact(directory: Path) -> int | None:
    """Number of runs of an intact ledger; None if it is damaged."""
    try:
        with Store.open(directory) as store:
            return len(list(store.rows()))
    except BadInputError:
        return None


def _rows(connection: sqlite3.Connection, query: str) -> Iterator[tuple[Any, ...]]:
    """All rows up to the first unreadable one."""
    with suppress(*_UNREADABLE):
        connection.text_factory = lambda data: data.decode(errors="replace")
        yield from connection.execute(query)


def _described(meta: list[tuple[Any, ...]], salt: tuple[str, ...]) -> list[tuple[Any, ...]]:
    """The intact metadata rows, and a new `BOUND` row if checksums are salted."""
    intact = [row for row in meta if row[0] != BOUND and row[2] == meta_checksum(row[0], row[1], salt)]
    bound = BOUND, canonical(True)
    return [*intact, (*bound, checksum_of(*bound))] if salt else intact


def _sound(runs: list[tuple[Any, ...]], salt: tuple[str, ...]) -> list[tuple[Any, ...]]:
    return [row for row in runs if row[-1] == checksum_of(*row[:-1], *salt)]
