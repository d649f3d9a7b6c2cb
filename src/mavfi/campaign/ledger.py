"""Ledgers as wholes: the campaign and the progress of one, ledgers of shards joined, and a damaged one repaired."""

import json
import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Any

from mavfi.campaign.config import Campaign
from mavfi.campaign.fingerprint import differences
from mavfi.campaign.plan import WHOLE, Plan, Shard
from mavfi.campaign.resolve import resolve
from mavfi.campaign.store import (
    BOUND,
    FILE,
    IDENTITY,
    PLANNED,
    SCHEMA,
    TABLES,
    Store,
    checksum_of,
    connect,
    meta_checksum,
    mission_checksum,
    no_campaign,
    strange_schema,
)
from mavfi.config import parse
from mavfi.errors import BadInputError, writing
from mavfi.files import is_file
from mavfi.record import canonical, without_source

SHARD = "shard"
ORDERED = "campaign"
"""Metadata key: the campaign as JSON text in its order of keys; the identity has sorted keys."""


@dataclass(frozen=True, slots=True)
class Status:
    """Progress of a stored campaign."""

    done: int  # runs, earlier sessions included
    total: int  # runs of the complete campaign
    settings: Mapping[str, tuple[int, int, int]] = field(default_factory=dict)
    """By setting: runs planned so far, done, successful."""
    unknown: int = 0  # done runs with status unknown
    shard: Shard = WHOLE  # shard in the ledger
    flies: bool = True  # whether runs are flights, which succeed or not

    @property
    def complete(self) -> bool:
        """Whether all runs are done."""
        return self.done == self.total


@dataclass(frozen=True, slots=True)
class Progress(Status):
    """Progress of a running campaign."""

    flown: int = 0  # runs done in this session
    compiling: bool = False  # kernels are being compiled; no run has been flown yet


def status(directory: Path) -> Status:
    """Progress of a stored campaign.

    Raises:
        BadInputError: The folder holds no ledger.
    """
    with Store.open(directory) as store:
        return status_of(store)


def status_of(store: Store) -> Status:
    """Progress of the campaign in an open ledger."""
    counts = store.counts()
    done = sum(number for _, number, _ in counts.values())
    total = sum(planned for planned, _, _ in counts.values())
    shard = shard_of(store)
    campaign = stored_campaign(store)
    if not store.complete:
        total = Plan(resolve(campaign)).count(shard)
    return Status(done, total, counts, store.unknown().total(), shard, campaign.flies)


def shard_of(store: Store) -> Shard:
    """The shard of a ledger; raises a BadInputError if its entry is invalid."""
    return Shard.parse(store.meta(SHARD) or str(WHOLE), str(store.directory))


def stored_campaign(store: Store) -> Campaign:
    """The campaign of a ledger (older ones do not store the order of keys); raises a BadInputError if invalid."""
    text = store.meta(ORDERED)
    data = store.meta("identity")["campaign"] if text is None else json.loads(text)
    return parse(Campaign, data, str(store.directory), stored=True)


def check_shard(store: Store, shard: Shard) -> None:
    """Store the shard; raises a BadInputError if the ledger belongs to another one."""
    if store.meta(SHARD) is None:
        store.write_meta({SHARD: str(shard)})
    if shard_of(store) != shard:
        raise BadInputError(f"{store.directory}: holds shard {shard_of(store)}, not {shard}; choose another directory")


def check_versions(
    store: Store, versions_there: Mapping[str, str], there: str = "here is", *, adds_runs: bool = False
) -> None:
    """Store the versions; raises a BadInputError if runs are missing in a ledger that was started with others.

    Args:
        store: The ledger.
        versions_there: Versions of the runs to be added.
        there: Words before such a version in the message.
        adds_runs: Whether runs are added to a complete ledger, too.
    """
    stored: dict[str, Any] | None = store.meta("versions")
    if stored is None:
        store.write_meta({"versions": dict(versions_there)})
        return
    differing = [name for name in versions_there if stored.get(name) != versions_there[name]]
    if differing and (adds_runs or not store.complete):
        name = differing[0]
        raise BadInputError(
            f"{store.directory}: was begun with {name} {stored.get(name)}, {there} {versions_there[name]}; runs "
            "cannot be mixed"
        )


# ---- ledgers of shards joined, with the digest of the undivided campaign ---------------------------------------------

_ROWS = 1000  # per transaction


def merge(sources: Sequence[Path], out: Path) -> Status:
    """Copy all runs of several ledgers of one campaign, complete or not, in any order, into a new or existing one.

    Raises:
        BadInputError: A ledger is absent or damaged, belongs to another campaign or to one with another order of keys,
            was started with other versions, or has a record that conflicts with another ledger's.
    """
    _check_alike(sources)
    for directory in sources:
        with Store.open(directory) as source, Store.create(out, source.meta("identity")) as target:
            check_shard(target, WHOLE)
            check_versions(target, source.meta("versions"), f"{directory} with")
            if target.meta(ORDERED) not in (None, source.meta(ORDERED)):
                raise BadInputError(f"{directory}: holds the campaign with its keys in another order than {out}")
            models = source.models_dir
            target.write_meta(
                {
                    ORDERED: source.meta(ORDERED),
                    "models_dir": models and str(models.absolute()),
                    "missions": stored_campaign(source).total_missions,
                }
            )
            _copy(source, target)
    return status(out)


def _check_alike(sources: Sequence[Path]) -> None:
    """Raise a BadInputError if ledgers are not of one campaign, before anything is written."""
    identities = {}
    for directory in sources:
        with Store.open(directory) as source:
            identities[directory] = source.meta("identity")
    for directory, identity in identities.items():
        if identity != identities[sources[0]]:
            differing = differences(identities[sources[0]], identity)
            raise BadInputError(f"{directory}: holds another campaign than {sources[0]} (differs in: {differing})")


def _copy(source: Store, target: Store) -> None:
    """Copy all runs, and which missions are completely planned; raises the error of `merge` about records."""
    stored_rows = source.rows()
    while batch := list(islice(stored_rows, _ROWS)):
        runs = [run for _, run in batch if run is not None]
        for run in runs:
            text = target.record_text(run.run_id)
            if text is not None and without_source(text) != without_source(run.text):
                raise BadInputError(
                    f"{source.directory}: run {run.run_id!r}: has another record than in {target.directory}"
                )
        target.plan(row for row, _ in batch)
        target.write(runs)
    for world in source.planned():
        target.end_plan(world)


# ---- the intact rows of a damaged ledger; resuming the campaign flies the missing runs -------------------------------

DAMAGED = "campaign.damaged.sqlite"
"""Backup of the damaged file."""
_RUNS = f"{PLANNED}, record, note, wall_s, checksum"
_UNREADABLE = (sqlite3.DatabaseError, UnicodeDecodeError)
"""SQLite quotes a damaged schema in its message, which then is no valid text."""


@dataclass(frozen=True, slots=True)
class Repair:
    """Outcome of a repair."""

    intact: int  # runs that the repaired ledger has
    lost: int  # runs with a checksum mismatch
    was_intact: bool = False  # nothing was damaged, and nothing is changed


def repair(directory: Path) -> Repair:
    """Replace a damaged ledger by one with all its intact rows; the damaged file is kept as a backup.

    An intact ledger is left as it is.

    Raises:
        BadInputError: The ledger is absent, its metadata are damaged, or a backup exists already.
    """
    path = directory / FILE
    damaged = directory / DAMAGED
    repaired = directory / f"{FILE}.repaired"
    if not is_file(path):
        raise no_campaign(directory)
    with suppress(BadInputError), Store.open(directory) as store:
        return Repair(len(list(store.rows())), 0, was_intact=True)
    if damaged.exists():
        raise BadInputError(f"{damaged}: exists already, from an earlier repair; move it away first")

    # Read what can be read, unless the schema is foreign: reading a view would execute it.
    with closing(connect(path, "ro")) as source:
        with suppress(*_UNREADABLE):  # the schema may be damaged, too: readable rows are kept
            strange = strange_schema(source)
            if strange:
                raise BadInputError(f"{path}: {strange}")
        meta = list(_rows(source, "SELECT key, value, checksum FROM meta"))
        runs = list(_rows(source, f"SELECT {_RUNS} FROM runs"))
        missions = list(_rows(source, "SELECT environment, seed, checksum FROM missions"))
    # its own checksum has no salt
    identities = [value for key, value, checksum in meta if key == IDENTITY and checksum == checksum_of(key, value)]
    if not identities:
        raise BadInputError(f"{path}: its metadata are damaged: the campaign cannot be identified")

    # Row `BOUND`, which says whether checksums are salted, may be damaged: the salt that fits more rows counts.
    salted = _IntactRows.of(meta, runs, (checksum_of(identities[0]),))
    unsalted = _IntactRows.of(meta, runs, ())
    intact = max(salted, unsalted, key=lambda rows: len(rows.meta) + len(rows.runs))

    with writing(repaired):
        repaired.unlink(missing_ok=True)
        with closing(sqlite3.connect(repaired)) as target:
            target.executescript(f"BEGIN; {TABLES} PRAGMA user_version = {SCHEMA};")
            with target:
                target.executemany("INSERT OR IGNORE INTO meta VALUES (?, ?, ?)", intact.meta)
                marks = ", ".join("?" * len(_RUNS.split(", ")))
                target.executemany(f"INSERT OR IGNORE INTO runs ({_RUNS}) VALUES ({marks})", intact.runs)
                # incomplete missions are replanned on resume
                complete = [m for m in missions if m[-1] == mission_checksum(target, m[:-1], intact.salt)]
                target.executemany("INSERT OR IGNORE INTO missions VALUES (?, ?, ?)", complete)
        # The damaged file makes room only now that the repaired one is complete.
        path.rename(damaged)
        for ending in ("-wal", "-shm"):
            with suppress(FileNotFoundError):
                path.with_name(path.name + ending).rename(damaged.with_name(damaged.name + ending))
        repaired.rename(path)
    return Repair(len(intact.runs), len(runs) - len(intact.runs))


def _rows(connection: sqlite3.Connection, query: str) -> Iterator[tuple[Any, ...]]:
    """All rows up to the first unreadable one."""
    with suppress(*_UNREADABLE):
        connection.text_factory = lambda data: data.decode(errors="replace")
        yield from connection.execute(query)


@dataclass(frozen=True, slots=True)
class _IntactRows:
    """The intact rows of a damaged ledger, if its checksums have this salt."""

    salt: tuple[str, ...]
    meta: list[tuple[Any, ...]]
    runs: list[tuple[Any, ...]]

    @staticmethod
    def of(meta: list[tuple[Any, ...]], runs: list[tuple[Any, ...]], salt: tuple[str, ...]) -> "_IntactRows":
        """Select the rows whose checksums match; salted checksums need a new `BOUND` row."""
        intact_meta = [row for row in meta if row[0] != BOUND and row[2] == meta_checksum(row[0], row[1], salt)]
        if salt:
            bound = BOUND, canonical(True)
            intact_meta.append((*bound, checksum_of(*bound)))
        intact_runs = [row for row in runs if row[-1] == checksum_of(*row[:-1], *salt)]
        return _IntactRows(salt, intact_meta, intact_runs)
