"""The ledger of a campaign: one SQLite file, one row per run, written by one process."""

import fcntl
import hashlib
import json
import sqlite3
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

from mavfi.campaign.nodes.config import KIND
from mavfi.campaign.plan import PHASE_INJECTED, RunSpec
from mavfi.errors import BadInputError
from mavfi.flight_log import Profile

SCHEMA = 1
FILE = "campaign.sqlite"
_LOCK = "campaign.lock"
_TABLES = """
CREATE TABLE meta (key TEXT PRIMARY KEY, value TEXT NOT NULL);
CREATE TABLE runs (
    run_id TEXT PRIMARY KEY,
    position INTEGER NOT NULL UNIQUE,
    phase INTEGER NOT NULL,
    setting TEXT NOT NULL,
    environment TEXT NOT NULL,
    seed INTEGER NOT NULL,
    spec TEXT NOT NULL,
    record TEXT,
    note TEXT NOT NULL DEFAULT '',
    wall_s REAL
);
CREATE TABLE profiles (environment TEXT, seed INTEGER, content BLOB NOT NULL, PRIMARY KEY (environment, seed));
"""


@dataclass(frozen=True, slots=True)
class Run:
    """A row: what was planned, and what is known of it (None = not flown yet)."""

    spec: RunSpec
    record: dict[str, Any] | None
    note: str = ""
    wall_s: float | None = None


class Store:
    """A ledger that is open.  Use `create` to write a campaign, `open` to read one; both close as context managers."""

    def __init__(self, directory: Path, connection: sqlite3.Connection, lock: IO[str] | None = None) -> None:
        self.directory = directory
        self._connection = connection
        self._lock = lock

    def __enter__(self) -> "Store":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close; nothing is lost by not doing so."""
        self._connection.close()
        if self._lock is not None:
            self._lock.close()

    @staticmethod
    def create(directory: Path, identity: Mapping[str, Any]) -> "Store":
        """Begin a ledger, or go on with it.

        Args:
            directory: Made if absent.
            identity: What makes this campaign this one; plain data.

        Raises:
            BadInputError: The directory cannot be written, holds another campaign, or another process writes to it.
        """
        try:
            directory.mkdir(parents=True, exist_ok=True)
            lock = (directory / _LOCK).open("w", encoding="utf-8")
        except OSError as error:
            raise BadInputError(f"{directory}: cannot be written ({error.strerror})") from None
        try:
            # A record lock belongs to this process alone: workers that outlive it do not hold it.
            fcntl.lockf(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            lock.close()
            raise BadInputError(f"{directory}: another process is writing this campaign") from None
        store = Store(directory, _connect(directory / FILE, "rwc"), lock)
        try:
            if store._is_empty():
                store._begin(identity)
            else:
                store._check(identity)
            store._connection.execute("PRAGMA journal_mode = WAL")
            store._connection.execute("PRAGMA synchronous = NORMAL")
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
        store = Store(directory, _connect(path, "ro"))
        try:
            store._check_schema()
        except BaseException:
            store.close()
            raise
        return store

    def _begin(self, identity: Mapping[str, Any]) -> None:
        self._connection.executescript(f"BEGIN; {_TABLES} PRAGMA user_version = {SCHEMA};")
        self.write_meta({"identity": identity})

    def _is_empty(self) -> bool:
        return bool(self._ask("SELECT COUNT(*) FROM sqlite_master") == 0)

    def _ask(self, query: str) -> Any:
        try:
            return self._connection.execute(query).fetchone()[0]
        except sqlite3.DatabaseError:
            raise BadInputError(f"{self.directory / FILE}: is not a ledger of mavfi") from None

    def _check_schema(self) -> None:
        version = self._ask("PRAGMA user_version")
        if version != SCHEMA:
            raise BadInputError(f"{self.directory / FILE}: schema version {version}; allowed: {SCHEMA}")

    def _check(self, identity: Mapping[str, Any]) -> None:
        self._check_schema()
        held = self.meta("identity")
        wanted = json.loads(canonical(identity))
        if held != wanted:
            names = [key for key in sorted({*held, *wanted}) if held.get(key) != wanted.get(key)]
            raise BadInputError(
                f"{self.directory}: holds another campaign (differs in: {', '.join(names)}); choose another directory"
            )

    def meta(self, key: str) -> Any:
        """Plain data stored under a key; None if there is none."""
        row = self._connection.execute("SELECT value FROM meta WHERE key = ?", (key,)).fetchone()
        return None if row is None else json.loads(row[0])

    def write_meta(self, items: Mapping[str, Any]) -> None:
        """Store plain data by key."""
        rows = [(key, canonical(value)) for key, value in items.items()]
        with self._connection:
            self._connection.executemany("INSERT OR REPLACE INTO meta VALUES (?, ?)", rows)

    def plan(self, phase: int, specs: Iterable[RunSpec]) -> None:
        """Store all runs of a phase at once; those that are there already are left as they are."""
        if self.is_planned(phase):
            return
        self.plan_part(phase, dict(enumerate(specs)))
        self.end_plan(phase)

    def plan_part(self, phase: int, specs: Mapping[int, RunSpec]) -> None:
        """Store some runs of a phase at once.

        Args:
            phase: The phase; those before it are planned as a whole.
            specs: By place in the phase; those that are there already are left as they are.
        """
        (first,) = self._connection.execute("SELECT COUNT(*) FROM runs WHERE phase < ?", (phase,)).fetchone()
        rows = [
            (s.run_id, first + place, s.phase, s.setting, s.environment, s.seed, canonical(s.to_json()))
            for place, s in specs.items()
        ]
        columns = "run_id, position, phase, setting, environment, seed, spec"
        with self._connection:
            self._connection.executemany(f"INSERT OR IGNORE INTO runs ({columns}) VALUES (?, ?, ?, ?, ?, ?, ?)", rows)

    def end_plan(self, phase: int) -> None:
        """Note that all runs of a phase are stored."""
        (count,) = self._connection.execute("SELECT COUNT(*) FROM runs WHERE phase = ?", (phase,)).fetchone()
        with self._connection:
            self._connection.execute("INSERT OR IGNORE INTO meta VALUES (?, ?)", (f"planned_{phase}", str(count)))

    def is_planned(self, phase: int) -> bool:
        """Whether the runs of a phase are stored."""
        return self.meta(f"planned_{phase}") is not None

    def runs(
        self, phase: int | None = None, *, done: bool | None = None, world: tuple[str, int] | None = None
    ) -> Iterator[Run]:
        """Rows in the order of the plan.

        Args:
            phase: Only of this phase.
            done: Only those that are flown, or only those that are not.
            world: Only of this environment and seed.
        """
        clauses = ["1"]
        if phase is not None:
            clauses.append(f"phase = {int(phase)}")
        if done is not None:
            clauses.append(f"record IS {'NOT ' if done else ''}NULL")
        if world is not None:
            clauses += ["environment = ?", "seed = ?"]
        query = f"SELECT spec, record, note, wall_s FROM runs WHERE {' AND '.join(clauses)} ORDER BY position"
        for spec, record, note, wall_s in self._connection.execute(query, world or ()):
            parsed = None if record is None else json.loads(record)
            yield Run(RunSpec.from_json(json.loads(spec)), parsed, note, wall_s)

    def run(self, run_id: str) -> Run:
        """One row by its id, or by the beginning of it.

        Raises:
            BadInputError: There is none, or more than one.
        """
        query = "SELECT run_id, spec, record, note, wall_s FROM runs WHERE run_id = ? OR instr(run_id, ?) = 1"
        rows = self._connection.execute(query, (run_id, run_id)).fetchall()
        rows = [row for row in rows if row[0] == run_id] or rows
        if len(rows) != 1:
            found = "no run" if not rows else f"{len(rows)} runs"
            raise BadInputError(f"{self.directory}: run {run_id!r}: {found} of that name")
        _, spec, record, note, wall_s = rows[0]
        return Run(RunSpec.from_json(json.loads(spec)), None if record is None else json.loads(record), note, wall_s)

    def write(self, spec: RunSpec, record: Mapping[str, Any], profile: bytes | None, note: str, wall_s: float) -> None:
        """Store what a run left; from then on the run is done."""
        with self._connection:
            self._connection.execute(
                "UPDATE runs SET record = ?, note = ?, wall_s = ? WHERE run_id = ?",
                (canonical(record), note, wall_s, spec.run_id),
            )
            if profile is not None:
                row = (spec.environment, spec.seed, profile)
                self._connection.execute("INSERT OR REPLACE INTO profiles VALUES (?, ?, ?)", row)

    def profiles(self) -> dict[tuple[str, int], Profile]:
        """Profiles of the golden flights, by environment and seed."""
        rows = self._connection.execute("SELECT environment, seed, content FROM profiles")
        return {(environment, seed): Profile.from_bytes(content) for environment, seed, content in rows}

    def profile(self, environment: str, seed: int) -> Profile | None:
        """Profile of one golden flight; None if it left none."""
        query = "SELECT content FROM profiles WHERE environment = ? AND seed = ?"
        row = self._connection.execute(query, (environment, seed)).fetchone()
        return None if row is None else Profile.from_bytes(row[0])

    def counts(self) -> dict[str, tuple[int, int, int]]:
        """Runs by setting: planned, done, done with success."""
        query = (
            "SELECT setting, COUNT(*), COUNT(record), TOTAL(json_extract(record, '$.success')) FROM runs "
            "GROUP BY setting ORDER BY MIN(position)"
        )
        rows = self._connection.execute(query)
        return {setting: (planned, done, int(success)) for setting, planned, done, success in rows}

    @property
    def is_of_nodes(self) -> bool:
        """Whether it holds trials on a ROS node instead of flights."""
        return bool(self.meta("identity").get("campaign", {}).get("kind") == KIND)

    def require_flights(self) -> None:
        """Refuse a ledger of trials.

        Raises:
            BadInputError: It holds trials on a ROS node.
        """
        if self.is_of_nodes:
            raise BadInputError(f"{self.directory}: holds trials on a ROS node, which cannot be flown again")

    @property
    def complete(self) -> bool:
        """Whether every phase is planned and every run is flown."""
        return self.is_planned(PHASE_INJECTED) and self._ask("SELECT COUNT(*) FROM runs WHERE record IS NULL") == 0

    def digest(self) -> str:
        """SHA-256 over plan and records: the same for any order of completion, any workers, any stop and resume.

        It says which campaign this is only when the ledger is `complete`.
        """
        content = hashlib.sha256(canonical(self.meta("identity")).encode())
        for run_id, spec, record in self._connection.execute("SELECT run_id, spec, record FROM runs ORDER BY position"):
            content.update(f"{run_id}\n{spec}\n{record}\n".encode())
        return content.hexdigest()


def canonical(data: Any) -> str:
    """The one JSON text of plain data."""
    return json.dumps(data, sort_keys=True, separators=(",", ":"), allow_nan=False)


def _connect(path: Path, mode: str) -> sqlite3.Connection:
    try:
        return sqlite3.connect(f"{path.absolute().as_uri()}?mode={mode}", uri=True)
    except sqlite3.OperationalError as error:
        raise BadInputError(f"{path}: cannot be opened ({error})") from None
