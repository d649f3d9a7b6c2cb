"""The ledger of a campaign: one SQLite file, one row per run, written by one process; what its checksums prove.

Checksums cover the row and, as a salt, the identity of the campaign, so that rows of another campaign are rejected.
Ledgers of an older mavfi have no salt, and no `BOUND` row.  Checksums detect damage, but a forged ledger can have valid
ones.  So types are checked as well.
"""

import errno
import fcntl
import hashlib
import json
import os
import shlex
import sqlite3
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import IO, Any

from mavfi.campaign.fingerprint import differences
from mavfi.campaign.plan import CompletedRun, Row, RunSpec, reason_of
from mavfi.config import checked
from mavfi.errors import BadInputError, MachineError, MavfiError, allowed, machine_failure
from mavfi.files import absent_folders, is_file, remove_folders
from mavfi.mission import MissionStatus
from mavfi.plugins import permission_for, use_ledger
from mavfi.record import FlightRecord, canonical, without_source


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


IDENTITY = "identity"
BOUND = "bound"
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
    if key in (IDENTITY, BOUND):
        return checksum_of(key, value)
    return checksum_of(key, value, *salt)


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
    "run_id": "text",
    "position": "integer",
    "kind": "text",
    "setting": "text",
    "environment": "text",
    "seed": "integer",
    "spec": "text",
    "record": "text null",
    "note": "text",
    "wall_s": "real null",
}


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
        violation = strange_schema(connection)
        if violation:
            return violation
        answer = str(connection.execute("PRAGMA integrity_check(1)").fetchone()[0])  # of SQLite itself
        if answer != "ok":
            return answer.splitlines()[-1]
        return _checksums(connection) or _types(connection)
    except (sqlite3.DatabaseError, TypeError, UnicodeDecodeError) as error:  # TypeError: a value has the wrong type
        return " ".join(str(error).split())  # SQLite quotes text of the file, with its line breaks


def strange_schema(connection: sqlite3.Connection) -> str:
    """The first foreign object of the schema; "" = none.  Reading a view in place of a table would execute it."""
    objects = connection.execute("SELECT type, name, sql FROM sqlite_master WHERE sql IS NOT NULL").fetchall()
    allowed = {statement.strip() for statement in TABLES.split(";")}
    for kind, name, sql in objects:
        if sql not in allowed:
            return f"{kind} {name!r} is not of a ledger"
    return ""


def _checksums(connection: sqlite3.Connection) -> str:
    """The first row, or mission, whose checksum does not match; "" = none."""
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
        wrong = f"typeof({column}) NOT IN ({allowed})"
        if column in ("spec", "record"):
            wrong += f" OR {column} IS NOT NULL AND NOT json_valid({column})"
        query = f"SELECT run_id FROM runs WHERE {wrong} LIMIT 1"
        row = connection.execute(query).fetchone()
        if row is not None:
            return f"run {row[0]!r}: key {column!r}: allowed: {kinds.replace(' ', ' or ')}"
    return ""


# ---- the ledger of a campaign: one SQLite file, one row per run, written by one process ----------------------------

SCHEMA = 3
FILE = "campaign.sqlite"
LOCK = "campaign.lock"
LOG = "log.jsonl"
_CANDIDATES = 5
"""Runs that a message about an ambiguous prefix names."""
_CHUNK = 1 << 20
"""Size of a read (bytes)."""
_GENERATION = "generation"
_RUN = "spec, record, note, wall_s"


@dataclass(frozen=True, slots=True)
class Run:
    """A row: the planned run and its record (None = not flown yet)."""

    spec: RunSpec
    record: FlightRecord | None
    note: str = ""
    wall_s: float | None = None


def no_campaign(directory: Path) -> BadInputError:
    """The error for a folder that holds no campaign; it names the folders in it that do."""
    ledgers: list[str] = []
    with suppress(OSError, ValueError):  # absent, not readable, or a name that no folder can have
        ledgers = sorted(str(path.parent) for path in directory.glob(f"*/{FILE}"))
    question = ""
    if ledgers:
        question = f"; did you mean {allowed(ledgers)}?"
    return BadInputError(f"{directory}: holds no campaign (no {FILE}){question}")


class Store:
    """An open ledger.  Use `create` to write a campaign, `open` to read one; both are context managers."""

    def __init__(self, directory: Path, connection: sqlite3.Connection, lock: IO[str] | None = None) -> None:
        self.directory = directory
        self._connection = connection
        self._lock = lock
        self._has_log = False
        self._generation = 0
        self._is_new = False
        self._absent: list[Path] = []
        """Folders that were made for a new ledger."""

    def __enter__(self) -> "Store":
        return self

    def __exit__(self, _: type[BaseException] | None, error: BaseException | None, trace: object) -> None:
        was_refused = self._is_new and isinstance(error, BadInputError)
        has_runs = was_refused and self._ask("SELECT COUNT(*) FROM runs WHERE record IS NOT NULL") > 0
        self.close()
        if was_refused and not has_runs:  # what was refused before the first flight leaves nothing
            for name in (FILE, LOCK, LOG):
                (self.directory / name).unlink(missing_ok=True)
            remove_folders(self._absent)

    def close(self) -> None:
        """Close; an unclosed ledger keeps its data, but cannot be read from read-only media."""
        if self._has_log:
            with suppress(sqlite3.DatabaseError):  # locked by a reader, or a disk failure
                self._connection.execute("PRAGMA journal_mode = DELETE")
        self._connection.close()
        if self._lock is not None:
            self._lock.close()

    @staticmethod
    def create(directory: Path, identity: Mapping[str, Any]) -> "Store":
        """Create or resume a ledger in a directory, which is created if absent.

        Raises:
            BadInputError: The directory cannot be written, holds a campaign of another identity, or another
                process writes to it.
        """
        absent = absent_folders(directory)
        try:
            directory.mkdir(parents=True, exist_ok=True)
            lock = (directory / LOCK).open("w", encoding="utf-8")
        except OSError as error:
            raise BadInputError(f"{directory}: cannot be written ({error.strerror})") from None
        try:
            # A record lock belongs to this process alone: workers that survive it do not hold the lock.
            fcntl.lockf(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            lock.close()
            raise BadInputError(f"{directory}: another process is writing this campaign") from None
        store = Store(directory, connect(directory / FILE, "rwc"), lock)
        store._absent = absent
        try:
            if store._ask("SELECT COUNT(*) FROM sqlite_master") == 0:
                store._is_new = True
                store._connection.executescript(f"BEGIN; {TABLES} PRAGMA user_version = {SCHEMA};")
                store.write_meta({IDENTITY: identity, BOUND: True})
            else:
                store._check_schema()
                store._check_content()
                stored = store.meta(IDENTITY)
                requested = json.loads(canonical(identity))
                if stored != requested:
                    text = f"holds another campaign (differs in: {differences(stored, requested)})"
                    raise BadInputError(f"{directory}: {text}; choose another directory")
            store._begin_log()
            store._connection.execute("PRAGMA synchronous = NORMAL")
            # Become the writing process: whoever wrote before finds another generation, and stops.
            with store._connection:
                store._connection.execute("BEGIN IMMEDIATE")
                store._generation = (store.meta(_GENERATION) or 0) + 1
                row = store.meta_row(_GENERATION, store._generation)
                store._connection.execute("INSERT OR REPLACE INTO meta VALUES (?, ?, ?)", row)
            use_ledger(directory, identity)
        except BaseException:
            store.close()
            raise
        return store

    @staticmethod
    def open(directory: Path) -> "Store":
        """Open a ledger for reading, and verify every checksum.

        Raises:
            BadInputError: The ledger is absent, damaged or of another version.
        """
        if not is_file(directory / FILE):
            raise no_campaign(directory)
        store = Store(directory, connect(directory / FILE, "ro"))
        try:
            store._check_schema()
            store._check_content()
            use_ledger(directory, store.meta(IDENTITY))
        except BaseException:
            store.close()
            raise
        return store

    def _ask(self, query: str) -> Any:
        """The only value of a query; a BadInputError if the file is no ledger."""
        try:
            return self._connection.execute(query).fetchone()[0]
        except sqlite3.DatabaseError as error:
            code = error.sqlite_errorcode  # the low byte is the kind of error, the rest its details
            if code & 0xFF in (sqlite3.SQLITE_IOERR, sqlite3.SQLITE_NOMEM):
                raise MachineError(f"{self.directory / FILE}: cannot be read ({error})") from None
        self._check_disk()
        if code == sqlite3.SQLITE_READONLY_ROLLBACK:
            raise BadInputError(f"{self.directory}: its first writing was cut short; resume the campaign")
        raise BadInputError(f"{self.directory / FILE}: is not a ledger of mavfi")

    def _check_disk(self) -> None:
        """Raise a `MachineError` if the file cannot be read: SQLite reports read errors as damage."""
        path = self.directory / FILE
        if not is_file(path):  # reading a pipe or device would never end
            return
        try:
            with path.open("rb") as file:
                while True:
                    file.seek(os.lseek(file.fileno(), file.tell(), os.SEEK_DATA))  # skip holes, which cannot fail
                    file.read(_CHUNK)
        except OSError as error:
            if error.errno != errno.ENXIO:  # end of file
                raise MachineError(f"{path}: cannot be read ({error.strerror})") from error

    def _check_schema(self) -> None:
        """Raise a BadInputError for a file of another schema, or of another program."""
        path = self.directory / FILE
        version = self._ask("PRAGMA user_version")
        if version == 0:  # what SQLite gives for a file that no mavfi wrote
            text = f"{path}: is not a ledger of mavfi"
            if path.stat().st_size == 0:
                text += " (it is empty)"
            raise BadInputError(text)
        if version != SCHEMA:
            text = f"{path}: schema version {version}; allowed: {SCHEMA}"
            if version < SCHEMA:
                text += " (it was written by an older mavfi, which still reads it)"
            raise BadInputError(text)

    def _check_content(self) -> None:
        """Refuse a ledger that fails its integrity check twice, since a disk may fail temporarily."""
        if not damage(self._connection):
            return
        violation = damage(self._connection)
        if violation:
            self._check_disk()
            raise BadInputError(
                f"{self.directory / FILE}: is damaged: {violation}; "
                f"what is intact is rescued by: mavfi campaign repair {shlex.quote(str(self.directory))}"
            )

    def _begin_log(self) -> None:
        """Let readers and the writer work at the same time, by a log of changes."""
        try:
            self._connection.execute("PRAGMA journal_mode = WAL")
            self._connection.execute(f"CREATE INDEX IF NOT EXISTS {INDEX}")
        except sqlite3.OperationalError as error:
            if error.sqlite_errorcode & 0xFF != sqlite3.SQLITE_BUSY:
                raise
            raise BadInputError(f"{self.directory / FILE}: another process reads it; try again later") from None
        self._has_log = True

    @contextmanager
    def writing(self) -> Iterator[None]:
        """A transaction, or part of the surrounding one; failures of disk and memory are raised as `MachineError`.

        Raises:
            MavfiError: Another process has taken over the ledger, or the rows conflict with stored ones.
        """
        if self._generation and self._connection.in_transaction:
            yield
            return
        try:
            with self._connection:
                if not self._connection.in_transaction:  # a new ledger's tables and identity share one
                    self._connection.execute("BEGIN IMMEDIATE")
                if self._generation and self.meta(_GENERATION) != self._generation:
                    raise MavfiError(f"{self.directory}: another process has taken over this campaign")
                yield
        except sqlite3.IntegrityError as error:
            raise MavfiError(f"{self.directory}: runs do not fit those that are planned ({error})") from None
        except sqlite3.DatabaseError as error:
            if not machine_failure(error):
                raise
            raise MachineError(f"{self.directory / FILE}: cannot be written ({error})") from error

    def meta(self, key: str) -> Any:
        """Plain data stored under a key; None if there is none."""
        row = self._connection.execute("SELECT value FROM meta WHERE key = ?", (key,)).fetchone()
        if row is None:
            return None
        return json.loads(row[0])

    def meta_row(self, key: str, value: object) -> tuple[str, str, str]:
        """Plain data as a metadata row of this ledger."""
        text = canonical(value)
        return key, text, meta_checksum(key, text, salt_of(self._connection))

    def write_meta(self, items: Mapping[str, Any]) -> None:
        """Store plain data by key."""
        with self.writing():
            rows = [self.meta_row(key, value) for key, value in items.items()]
            self._connection.executemany("INSERT OR REPLACE INTO meta VALUES (?, ?, ?)", rows)

    def plan(self, rows: Iterable[Row]) -> list[Row]:
        """Store planned runs; those already stored are left unchanged, the new ones are returned."""
        query = "SELECT 1 FROM runs WHERE run_id = ?"
        with self.writing():
            salt = salt_of(self._connection)
            new = [row for row in rows if self._connection.execute(query, (row.run_id,)).fetchone() is None]
            self._connection.executemany(
                f"INSERT INTO runs ({PLANNED}, checksum) VALUES (?, ?, ?, ?, ?, ?, ?, ?)",
                [(*row, checksum_of(*row, None, "", None, *salt)) for row in new],
            )
        return new

    def end_plan(self, world: tuple[str, int]) -> None:
        """Mark a mission as completely planned."""
        with self.writing():
            row = *world, mission_checksum(self._connection, world, salt_of(self._connection))
            self._connection.execute("INSERT OR IGNORE INTO missions VALUES (?, ?, ?)", row)

    def replan(
        self,
        identity: Mapping[str, Any],
        rows: Sequence[Row],
        planned: Iterable[tuple[str, int]],
        unflown: Collection[str],
        replaced: Collection[str],
    ) -> None:
        """Make this the ledger of another campaign, which has all of its runs, at other positions.

        Args:
            identity: That of the campaign.
            rows: The stored runs as the campaign plans them, except the replaced ones.
            planned: Missions that have no further runs in it, by environment and seed.
            unflown: Ids of runs that are to be flown again.
            replaced: Ids of runs that it does not have.
        """
        with self.writing():
            # The identity comes first: it is the salt of all other checksums.
            keys = [key for (key,) in self._connection.execute("SELECT key FROM meta")]
            metadata = {key: self.meta(key) for key in keys if key not in (IDENTITY, BOUND)}
            self.write_meta({IDENTITY: identity, BOUND: True})
            self.write_meta(metadata)
            salt = salt_of(self._connection)

            self._connection.executemany("DELETE FROM runs WHERE run_id = ?", [(run_id,) for run_id in replaced])
            # Positions are unique at every instant: the old ones make room by becoming negative.
            self._connection.execute("UPDATE runs SET position = -1 - position")
            for row in rows:
                result = None, "", None
                if row.run_id not in unflown:
                    query = "SELECT record, note, wall_s FROM runs WHERE run_id = ?"
                    result = self._connection.execute(query, (row.run_id,)).fetchone()
                self._connection.execute(
                    "UPDATE runs SET position = ?, spec = ?, record = ?, note = ?, wall_s = ?, checksum = ? "
                    "WHERE run_id = ?",
                    (row.position, row.text, *result, checksum_of(*row, *result, *salt), row.run_id),
                )

            # A mission is completely planned if nothing is added to it.
            self._connection.execute("DELETE FROM missions")
            for world in planned:
                self.end_plan(world)

    def done(self, world: tuple[str, int]) -> frozenset[str]:
        """Ids of the completed runs of a mission, given by environment and seed."""
        query = "SELECT run_id FROM runs WHERE environment = ? AND seed = ? AND record IS NOT NULL"
        return frozenset(run_id for (run_id,) in self._connection.execute(query, world))

    def is_planned(self, world: tuple[str, int]) -> bool:
        """Whether every run of a mission is stored."""
        query = "SELECT 1 FROM missions WHERE environment = ? AND seed = ?"
        return self._connection.execute(query, world).fetchone() is not None

    def is_complete(self, world: tuple[str, int]) -> bool:
        """Whether every run of a mission is stored and flown."""
        query = "SELECT 1 FROM runs WHERE environment = ? AND seed = ? AND record IS NULL"
        return self.is_planned(world) and self._connection.execute(query, world).fetchone() is None

    def runs(self, *, done: bool | None = None, world: tuple[str, int] | None = None) -> Iterator[Run]:
        """Rows in plan order; `done` selects completed (True) or missing (False) ones, `world` those of a mission."""
        condition = {None: "1", True: "record IS NOT NULL", False: "record IS NULL"}[done]
        if world is not None:
            condition += " AND environment = ? AND seed = ?"
        query = f"SELECT {_RUN} FROM runs WHERE {condition} ORDER BY position"
        for row in self._connection.execute(query, world or ()):
            yield self._run(*row)

    def planned(self) -> list[tuple[str, int]]:
        """Completely planned missions, as environment and seed."""
        return self._connection.execute("SELECT environment, seed FROM missions ORDER BY 1, 2").fetchall()

    def rows(self) -> Iterator[tuple[Row, CompletedRun | None]]:
        """Stored runs as arguments of `plan` and `write`, in plan order."""
        query = f"SELECT {PLANNED}, record, note, wall_s, json_extract(record, '$.status') FROM runs ORDER BY position"
        for *planned, text, note, wall_s, status in self._connection.execute(query):
            row = Row(*planned)
            if text is None:
                yield row, None
                continue
            success = status == MissionStatus.SUCCESS.label
            yield row, CompletedRun(row.run_id, text, success, note=note, wall_s=wall_s)

    def record_text(self, run_id: str) -> str | None:
        """Record of a run as text; None = not flown, or not stored."""
        row = self._connection.execute("SELECT record FROM runs WHERE run_id = ?", (run_id,)).fetchone()
        if row is None:
            return None
        text: str | None = row[0]
        return text

    def run(self, run_id: str) -> Run:
        """One row by its id, with or without the hash at its end, by a prefix of it, or by its number in `mavfi runs`.

        Raises:
            BadInputError: No row matches, or several do; the message lists some.
        """
        if run_id.isdecimal():
            numbered = f"SELECT {_RUN} FROM runs WHERE record IS NOT NULL ORDER BY position LIMIT 1 OFFSET ?"
            row = self._connection.execute(numbered, (min(int(run_id), 2**32) - 1,)).fetchone()
            if row is not None and int(run_id) > 0:
                return self._run(*row)
        query = f"SELECT run_id, {_RUN} FROM runs WHERE run_id = ? OR instr(run_id, ?) = 1 ORDER BY position"
        rows = self._connection.execute(query, (run_id, run_id)).fetchall()
        exact = [row for row in rows if row[0] == run_id]
        without_hash = [row for row in rows if row[0].rpartition("-")[0] == run_id]
        rows = exact or without_hash or rows
        if not rows:
            raise BadInputError(
                f"{self.directory}: run {run_id!r}: not known; `mavfi runs {self.directory}` lists them with numbers"
            )
        if len(rows) > 1:
            some = ", ".join(row[0] for row in rows[:_CANDIDATES])
            raise BadInputError(f"{self.directory}: run {run_id!r}: ambiguous, {len(rows)} runs match, e.g. {some}")
        return self._run(*rows[0][1:])

    def _run(self, spec: str, record: str | None, note: str, wall_s: float | None) -> Run:
        """A stored run, from its columns."""
        try:
            flight_record = None
            if record is not None:
                flight_record = FlightRecord.from_json(json.loads(record))
            return Run(RunSpec.from_json(json.loads(spec)), flight_record, note, wall_s)
        except (BadInputError, RecursionError, ValueError) as error:  # ValueError: a number is too large
            raise BadInputError(f"{self.directory / FILE}: {error}") from None

    def write(self, runs: Iterable[CompletedRun]) -> list[tuple[str, CompletedRun]]:
        """Store the results of runs, which are then done and never changed.

        Returns:
            Runs that were not done before, each with its setting.

        Raises:
            MavfiError: A run is not planned: its mission drew other faults when repeated.
        """
        new_runs = []
        query = f"SELECT {PLANNED} FROM runs WHERE run_id = ? AND record IS NULL"
        with self.writing():
            salt = salt_of(self._connection)
            for run in runs:
                planned = self._connection.execute(query, (run.run_id,)).fetchone()
                if planned is None:
                    if self.record_text(run.run_id) is None:
                        raise MavfiError(f"{self.directory}: run {run.run_id!r}: is not in the plan")
                    continue  # done already
                result = run.text, run.note, run.wall_s
                self._connection.execute(
                    "UPDATE runs SET record = ?, note = ?, wall_s = ?, checksum = ? WHERE run_id = ?",
                    (*result, checksum_of(*planned, *result, *salt), run.run_id),
                )
                setting = Row(*planned).setting
                new_runs.append((setting, run))
        return new_runs

    @property
    def models_dir(self) -> Path | None:
        """Folder of the campaign's trained models; None = the shipped ones."""
        path: str | None = self.meta("models_dir")
        if path is None:
            return None
        return self.directory / path

    @property
    def permission(self) -> str:
        """The option, with a space before it, that commands need to run the ledger's plug-ins; "" = none."""
        return permission_for(self.directory, self.meta(IDENTITY))

    @contextmanager
    def snapshot(self) -> Iterator[None]:
        """Read a consistent snapshot of the ledger, unaffected by concurrent writes."""
        self._connection.execute("BEGIN")
        try:
            yield
        finally:
            self._connection.rollback()

    def tables(self) -> Iterator[tuple[str, tuple[Any, ...]]]:
        """Every row with its table's name, in an order independent of the order of flights."""
        for table, order in (("meta", "key"), ("runs", "position"), ("missions", "environment, seed")):
            for row in self._connection.execute(f"SELECT * FROM {table} ORDER BY {order}"):
                yield table, row

    def counts(self) -> dict[str, tuple[int, int, int]]:
        """Runs by setting: planned, done, successful."""
        query = (
            "SELECT setting, COUNT(*), COUNT(record), TOTAL(json_extract(record, '$.status') = 'success') FROM runs "
            "GROUP BY setting ORDER BY MIN(position)"
        )
        rows = self._connection.execute(query)
        return {setting: (planned, done, int(success)) for setting, planned, done, success in rows}

    def unknown(self) -> Counter[str]:
        """Number of completed runs with status unknown, by reason."""
        stored = self._connection.execute(
            "SELECT note, json_extract(record, '$.error') FROM runs WHERE json_extract(record, '$.end') = 'unknown'"
        )
        return Counter(reason_of(note) or error or "" for note, error in stored)

    def differing_null_runs(self) -> list[str]:
        """Ids of the null runs that differ from the golden run of their arm, in the flight or the number of alarms."""
        query = (
            "SELECT n.run_id FROM runs n JOIN runs g ON g.environment = n.environment AND g.seed = n.seed "
            "AND g.kind = 'golden' AND json_extract(g.spec, '$.arm') = json_extract(n.spec, '$.arm') "
            "WHERE n.kind = 'null' AND n.record IS NOT NULL AND json_extract(g.record, '$.digest') != '' "
            # keys are absent where they have their default
            "AND (json_extract(n.record, '$.digest') IS NOT json_extract(g.record, '$.digest') "
            "OR json_extract(n.record, '$.alarms_total') IS NOT json_extract(g.record, '$.alarms_total')) "
            "ORDER BY n.position"
        )
        return [run_id for (run_id,) in self._connection.execute(query)]

    @property
    def complete(self) -> bool:
        """Whether every run of every mission is stored and flown."""
        left = self._connection.execute("SELECT 1 FROM runs WHERE record IS NULL LIMIT 1").fetchone()
        return left is None and len(self.planned()) == self.meta("missions")

    def digest(self) -> str:
        """SHA-256 over plan and records, independent of order of completion, workers, stops and resumes.

        Source lines in the records are not part of it, see `record.without_source`.  It identifies the campaign
        only if the ledger is `complete`.
        """
        content = hashlib.sha256(canonical(self.meta("identity")).encode())
        for run_id, spec, record in self._connection.execute("SELECT run_id, spec, record FROM runs ORDER BY position"):
            text = None if record is None else without_source(record)
            content.update(f"{run_id}\n{spec}\n{text}\n".encode())
        return content.hexdigest()


def read_meta(directory: Path, key: str) -> Any:
    """`Store.meta` of a ledger that is not open; None if it is absent, empty or damaged."""
    if not is_file(directory / FILE):
        return None
    with suppress(sqlite3.DatabaseError, ValueError), closing(connect(directory / FILE, "ro")) as connection:
        return Store(directory, connection).meta(key)
    return None
