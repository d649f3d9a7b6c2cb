"""The ledger of a campaign: one SQLite file, one row per run, written by one process.

Every row has a checksum, which covers the campaign that it belongs to, and every mission a checksum over its planned
runs; a ledger with a mismatch is refused.
Every process that writes has a number (generation); an older one that lives on, with its lock gone, can write no more.
"""

import fcntl
import hashlib
import json
import os
import sqlite3
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

from mavfi.campaign.checksums import BOUND, IDENTITY, canonical, checksum_of, meta_checksum, mission_checksum, salt_of
from mavfi.campaign.plan import RunSpec
from mavfi.errors import BadInputError, MachineError, MavfiError, machine_failure
from mavfi.flight_record import End, FlightRecord

SCHEMA = 3
FILE = "campaign.sqlite"
LOCK = "campaign.lock"
TABLES = """
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
"""
_CANDIDATES = 5
_CHUNK = 1 << 20
_GENERATION = "generation"
_RUN = "spec, record, note, wall_s"
PLANNED = "run_id, position, kind, setting, environment, seed, spec"


@dataclass(frozen=True, slots=True)
class Run:
    """A row: what was planned, and what is known of it (None = not flown yet)."""

    spec: RunSpec
    record: FlightRecord | None
    note: str = ""
    wall_s: float | None = None


class Store:
    """A ledger that is open.  Use `create` to write a campaign, `open` to read one; both close as context managers."""

    def __init__(self, directory: Path, connection: sqlite3.Connection, lock: IO[str] | None = None) -> None:
        self.directory = directory
        self._connection = connection
        self._lock = lock
        self._has_log = False
        self._generation = 0

    def __enter__(self) -> "Store":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close; a ledger that was not closed keeps its data, but cannot be read from read-only media."""
        if self._has_log:
            with suppress(sqlite3.DatabaseError):  # a reader holds it, or the disk fails
                self._connection.execute("PRAGMA journal_mode = DELETE")
        self._connection.close()
        if self._lock is not None:
            self._lock.close()

    @staticmethod
    def create(directory: Path, identity: Mapping[str, Any]) -> "Store":
        """Begin or resume a ledger in a directory, which is made if absent.

        Raises:
            BadInputError: The directory cannot be written, holds a campaign of another identity, or another
                process writes to it.
        """
        try:
            directory.mkdir(parents=True, exist_ok=True)
            lock = (directory / LOCK).open("w", encoding="utf-8")
        except OSError as error:
            raise BadInputError(f"{directory}: cannot be written ({error.strerror})") from None
        try:
            # A record lock belongs to this process alone: workers that outlive it do not hold it.
            fcntl.lockf(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            lock.close()
            raise BadInputError(f"{directory}: another process is writing this campaign") from None
        store = Store(directory, connect(directory / FILE, "rwc"), lock)
        try:
            if store._ask("SELECT COUNT(*) FROM sqlite_master") == 0:
                store._connection.executescript(f"BEGIN; {TABLES} PRAGMA user_version = {SCHEMA};")
                store.write_meta({IDENTITY: identity, BOUND: True})
            else:
                store._check(identity)
            store._connection.execute("PRAGMA journal_mode = WAL")
            store._has_log = True
            store._connection.execute("PRAGMA synchronous = NORMAL")
            store._take_over()
        except BaseException:
            store.close()
            raise
        return store

    @staticmethod
    def open(directory: Path) -> "Store":
        """Open a ledger for reading.

        Raises:
            BadInputError: There is none, or one of another version.
        """
        path = directory / FILE
        if not path.is_file():
            raise BadInputError(f"{directory}: holds no campaign (no {FILE})")
        store = Store(directory, connect(path, "ro"))
        try:
            store._check_schema()
            store._check_content()
        except BaseException:
            store.close()
            raise
        return store

    def _ask(self, query: str) -> Any:
        try:
            return self._connection.execute(query).fetchone()[0]
        except sqlite3.DatabaseError as error:
            code = error.sqlite_errorcode
        self._check_disk()
        if code == sqlite3.SQLITE_READONLY_ROLLBACK:
            raise BadInputError(f"{self.directory}: its first writing was cut short; resume the campaign")
        raise BadInputError(f"{self.directory / FILE}: is not a ledger of mavfi")

    def _check_disk(self) -> None:
        """SQLite takes what a disk does not give for damage: raise a `MachineError` if the file cannot be read."""
        path = self.directory / FILE
        try:
            with path.open("rb") as file:
                while file.read(_CHUNK):
                    pass
        except OSError as error:
            raise MachineError(f"{path}: cannot be read ({error.strerror})") from error

    def _check_schema(self) -> None:
        version = self._ask("PRAGMA user_version")
        if version != SCHEMA:
            raise BadInputError(
                f"{self.directory / FILE}: schema version {version}; allowed: {SCHEMA}"
                + (" (it was written by an older mavfi, which still reads it)" if version < SCHEMA else "")
            )

    def _check(self, identity: Mapping[str, Any]) -> None:
        self._check_schema()
        self._check_content()
        held = self.meta("identity")
        wanted = json.loads(canonical(identity))
        if held != wanted:
            names = [key for key in sorted({*held, *wanted}) if held.get(key) != wanted.get(key)]
            raise BadInputError(
                f"{self.directory}: holds another campaign (differs in: {', '.join(names)}); choose another directory"
            )

    def _check_content(self) -> None:
        """Refuse a ledger that fails its integrity check, twice: a disk may fail for a moment."""
        wrong = self._seen_damage() and self._seen_damage()
        if wrong:
            self._check_disk()
            raise BadInputError(f"{self.directory / FILE}: is damaged: {wrong}")

    def _seen_damage(self) -> str:
        try:
            return self._damage()
        except (sqlite3.DatabaseError, TypeError) as error:  # TypeError: a value has the wrong type
            return f"{error}"

    def _damage(self) -> str:
        """The first integrity violation, "" = none."""
        sound = self._connection.execute("PRAGMA integrity_check(1)").fetchone()[0]
        if sound != "ok":
            return str(sound).splitlines()[-1]
        salt = salt_of(self._connection)
        for key, value, checksum in self._connection.execute("SELECT key, value, checksum FROM meta"):
            if checksum != meta_checksum(key, value, salt):
                return f"metadata {key!r}: checksum mismatch"
        if self.meta(IDENTITY) is None:
            return "metadata are missing"
        for run_id, *rest, checksum in self._connection.execute(
            f"SELECT {PLANNED}, record, note, wall_s, checksum FROM runs"
        ):
            if checksum != checksum_of(run_id, *rest, *salt):
                return f"run {run_id!r}: checksum mismatch"
        for environment, seed, checksum in self._connection.execute("SELECT * FROM missions ORDER BY 1, 2"):
            if checksum != mission_checksum(self._connection, (environment, seed), salt):
                return f"mission {environment}-{seed}: runs are missing or were added"
        return ""

    def _take_over(self) -> None:
        """Become the one that writes."""
        with self._connection:
            self._connection.execute("BEGIN IMMEDIATE")
            self._generation = (self.meta(_GENERATION) or 0) + 1
            row = _GENERATION, canonical(self._generation)
            checksum = meta_checksum(*row, salt_of(self._connection))
            self._connection.execute("INSERT OR REPLACE INTO meta VALUES (?, ?, ?)", (*row, checksum))

    @contextmanager
    def _writing(self) -> Iterator[None]:
        """A transaction; failures of disk and memory are a `MachineError`.

        Raises:
            MavfiError: Another process has taken the ledger over.
        """
        try:
            with self._connection:
                if not self._connection.in_transaction:  # a new ledger's tables and identity are one
                    self._connection.execute("BEGIN IMMEDIATE")
                if self._generation and self.meta(_GENERATION) != self._generation:
                    raise MavfiError(f"{self.directory}: another process has taken over this campaign")
                yield
        except sqlite3.DatabaseError as error:
            if not machine_failure(error):
                raise
            raise MachineError(f"{self.directory / FILE}: cannot be written ({error})") from error

    def meta(self, key: str) -> Any:
        """Plain data stored under a key; None if there is none."""
        row = self._connection.execute("SELECT value FROM meta WHERE key = ?", (key,)).fetchone()
        return None if row is None else json.loads(row[0])

    def write_meta(self, items: Mapping[str, Any]) -> None:
        """Store plain data by key."""
        texts = {key: canonical(value) for key, value in items.items()}
        with self._writing():
            salt = salt_of(self._connection)
            rows = [(key, text, meta_checksum(key, text, salt)) for key, text in texts.items()]
            self._connection.executemany("INSERT OR REPLACE INTO meta VALUES (?, ?, ?)", rows)

    def plan(self, specs: Iterable[RunSpec]) -> None:
        """Store runs before they are flown; those that are there already are left as they are."""
        rows = [
            (s.run_id, s.position, s.kind, s.setting, s.environment, s.seed, canonical(s.to_json())) for s in specs
        ]  # fmt: skip
        marks = "?, ?, ?, ?, ?, ?, ?, ?"
        with self._writing():
            salt = salt_of(self._connection)
            checked = [(*row, checksum_of(*row, None, "", None, *salt)) for row in rows]
            self._connection.executemany(f"INSERT OR IGNORE INTO runs ({PLANNED}, checksum) VALUES ({marks})", checked)

    def end_plan(self, world: tuple[str, int]) -> None:
        """Note that all runs of a mission are stored."""
        with self._writing():
            row = *world, mission_checksum(self._connection, world, salt_of(self._connection))
            self._connection.execute("INSERT OR IGNORE INTO missions VALUES (?, ?, ?)", row)

    def planned(self) -> set[tuple[str, int]]:
        """Missions, by environment and seed, of which all runs are stored."""
        return set(self._connection.execute("SELECT environment, seed FROM missions"))

    def done(self) -> dict[tuple[str, int], frozenset[str]]:
        """Ids of the runs that are flown, by mission."""
        found: dict[tuple[str, int], set[str]] = {}
        rows = self._connection.execute("SELECT environment, seed, run_id FROM runs WHERE record IS NOT NULL")
        for environment, seed, run_id in rows:
            found.setdefault((environment, seed), set()).add(run_id)
        return {world: frozenset(ids) for world, ids in found.items()}

    def complete_missions(self) -> set[tuple[str, int]]:
        """Missions of which every run is stored and flown."""
        open_ones = set(self._connection.execute("SELECT DISTINCT environment, seed FROM runs WHERE record IS NULL"))
        return self.planned() - open_ones

    def runs(self, *, done: bool | None = None) -> Iterator[Run]:
        """Rows in the order of the plan; `done` selects those that are flown, or those that are not."""
        chosen = {None: "1", True: "record IS NOT NULL", False: "record IS NULL"}[done]
        for row in self._connection.execute(f"SELECT {_RUN} FROM runs WHERE {chosen} ORDER BY position"):
            yield _run(*row)

    def run(self, run_id: str) -> Run:
        """One row by its id, or by the beginning of it.

        Raises:
            BadInputError: There is none, or more than one; the message lists some.
        """
        query = f"SELECT run_id, {_RUN} FROM runs WHERE run_id = ? OR instr(run_id, ?) = 1 ORDER BY position"
        rows = self._connection.execute(query, (run_id, run_id)).fetchall()
        rows = [row for row in rows if row[0] == run_id] or rows
        if not rows:
            raise BadInputError(f"{self.directory}: run {run_id!r}: no run of that name; `mavfi runs` lists them")
        if len(rows) > 1:
            some = ", ".join(row[0] for row in rows[:_CANDIDATES])
            raise BadInputError(
                f"{self.directory}: run {run_id!r}: {len(rows)} runs begin so; allowed, among others: {some}"
            )
        return _run(*rows[0][1:])

    def write(self, run_id: str, record: FlightRecord, note: str, wall_s: float) -> None:
        """Store what a run left; from then on the run is done, and stays as it is.

        Raises:
            MavfiError: The run is not planned: its mission, begun again, drew other faults.
        """
        query = f"SELECT {PLANNED} FROM runs WHERE run_id = ? AND record IS NULL"
        with self._writing():
            planned = self._connection.execute(query, (run_id,)).fetchone()
            if planned is None:
                if not self._connection.execute("SELECT 1 FROM runs WHERE run_id = ?", (run_id,)).fetchone():
                    raise MavfiError(f"{self.directory}: run {run_id!r}: is not in the plan")
                return
            result = canonical(record.to_json()), note, wall_s
            self._connection.execute(
                "UPDATE runs SET record = ?, note = ?, wall_s = ?, checksum = ? WHERE run_id = ?",
                (*result, checksum_of(*planned, *result, *salt_of(self._connection)), run_id),
            )

    def counts(self) -> dict[str, tuple[int, int, int]]:
        """Runs by setting: planned, done, done with success."""
        query = (
            "SELECT setting, COUNT(*), COUNT(record), TOTAL(json_extract(record, '$.status') = 'success') FROM runs "
            "GROUP BY setting ORDER BY MIN(position)"
        )
        rows = self._connection.execute(query)
        return {setting: (planned, done, int(success)) for setting, planned, done, success in rows}

    def unknown(self) -> int:
        """Number of done runs with status unknown."""
        query = "SELECT COUNT(*) FROM runs WHERE json_extract(record, '$.end') = ?"
        return int(self._connection.execute(query, (End.UNKNOWN.value,)).fetchone()[0])

    def setting_of(self, run_id: str) -> str:
        """Setting of a run that is stored."""
        query = "SELECT setting FROM runs WHERE run_id = ?"
        return str(self._connection.execute(query, (run_id,)).fetchone()[0])

    @property
    def complete(self) -> bool:
        """Whether every run of every mission is stored and flown."""
        missions = self.meta("missions")
        return missions is not None and len(self.complete_missions()) == missions

    def digest(self) -> str:
        """SHA-256 over plan and records: the same for any order of completion, any workers, any stop and resume.

        It says which campaign this is only when the ledger is `complete`.
        """
        content = hashlib.sha256(canonical(self.meta("identity")).encode())
        for run_id, spec, record in self._connection.execute("SELECT run_id, spec, record FROM runs ORDER BY position"):
            content.update(f"{run_id}\n{spec}\n{record}\n".encode())
        return content.hexdigest()


def _run(spec: str, record: str | None, note: str, wall_s: float | None) -> Run:
    parsed = None if record is None else FlightRecord.from_json(json.loads(record))
    return Run(RunSpec.from_json(json.loads(spec)), parsed, note, wall_s)


def connect(path: Path, mode: str) -> sqlite3.Connection:
    """Open a ledger's file, also on read-only media.

    Raises:
        BadInputError: It cannot be opened.
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
