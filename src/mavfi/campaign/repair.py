"""Saves what is whole of a damaged ledger; the rest is flown again when its campaign is resumed."""

import sqlite3
from collections.abc import Iterator
from contextlib import closing, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mavfi.campaign.store import FILE, PLANNED, SCHEMA, TABLES, checksum_of, connect
from mavfi.errors import BadInputError, writing

DAMAGED = "campaign.damaged.sqlite"
"""The damaged file, which is kept."""
_RUNS = f"{PLANNED}, record, note, wall_s, checksum"


@dataclass(frozen=True, slots=True)
class Repair:
    """What became of a ledger."""

    kept: int  # rows of runs
    lost: int  # rows that were found and are not as they were written


def repair(directory: Path) -> Repair:
    """Put a ledger that holds every sound row in the place of a damaged one, which stays beside it.

    Raises:
        BadInputError: There is no ledger, its description is damaged, or there is a damaged one from before already.
    """
    path, damaged, whole = directory / FILE, directory / DAMAGED, directory / f"{FILE}.repaired"
    if not path.is_file():
        raise BadInputError(f"{directory}: holds no campaign (no {FILE})")
    if damaged.exists():
        raise BadInputError(f"{damaged}: is there already, from an earlier repair; move it away first")
    with closing(connect(path, "ro")) as source:
        described = [row for row in _rows(source, "SELECT key, value, checksum FROM meta") if _sound(row)]
        runs = list(_rows(source, f"SELECT {_RUNS} FROM runs"))
        missions = list(_rows(source, "SELECT environment, seed, checksum FROM missions"))
    if "identity" not in {row[0] for row in described}:
        raise BadInputError(f"{path}: its description is damaged: which campaign it holds is not known")
    sound = [row for row in runs if _sound(row)]
    with writing(whole):
        whole.unlink(missing_ok=True)
        with closing(sqlite3.connect(whole)) as target:
            target.executescript(f"BEGIN; {TABLES} PRAGMA user_version = {SCHEMA};")
            with target:
                target.executemany("INSERT OR IGNORE INTO meta VALUES (?, ?, ?)", described)
                marks = ", ".join("?" * len(_RUNS.split(", ")))
                target.executemany(f"INSERT OR IGNORE INTO runs ({_RUNS}) VALUES ({marks})", sound)
                # a mission that lacks a run is planned anew when the campaign goes on
                target.executemany(
                    "INSERT OR IGNORE INTO missions VALUES (?, ?, ?)", [m for m in missions if _is_whole(target, m)]
                )
        path.rename(damaged)
        for ending in ("-wal", "-shm"):
            with suppress(FileNotFoundError):
                path.with_name(path.name + ending).rename(damaged.with_name(damaged.name + ending))
        whole.rename(path)
    return Repair(len(sound), len(runs) - len(sound))


def _rows(connection: sqlite3.Connection, query: str) -> Iterator[tuple[Any, ...]]:
    """Rows as far as they can be read."""
    with suppress(sqlite3.DatabaseError):
        connection.text_factory = lambda data: data.decode(errors="replace")
        yield from connection.execute(query)


def _sound(row: tuple[Any, ...]) -> bool:
    return bool(row[-1] == checksum_of(*row[:-1]))


def _is_whole(connection: sqlite3.Connection, mission: tuple[Any, ...]) -> bool:
    query = "SELECT run_id, position FROM runs WHERE environment = ? AND seed = ? ORDER BY position"
    *world, checksum = mission
    return bool(checksum == checksum_of(*world, *(part for row in connection.execute(query, world) for part in row)))
