"""Columnar record of one flight: what flew, what happened; save, load, digest."""

import hashlib
import io
import json
import zlib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np

from mavfi.errors import BadInputError
from mavfi.mission import MissionStatus

COLUMNS = (
    "time", "x", "y", "z", "vx", "vy", "vz", "qw", "qx", "qy", "qz", "wx", "wy", "wz",
    "command_vx", "command_vy", "command_vz", "command_yaw_rate", "reference_x", "reference_y", "reference_z",
)  # fmt: skip
"""Columns of `FlightLog.rows`: s, m, m/s, unit quaternion, rad/s (body), m/s and rad/s, m."""
_DIGESTED = len(COLUMNS) - 3


@dataclass(frozen=True, slots=True)
class Event:
    """Something that happened at an instant: a plan, an alarm of the collision check, a warning of the simulator."""

    time_us: int
    kind: str
    data: dict[str, Any] = field(default_factory=dict)


@dataclass(slots=True)
class Profile:
    """When which state was published in a golden flight: what faults are drawn from.

    Only publications that consumers act on are listed (see `StateSpec.acted_on`).

    Attributes:
        times_us: By state, the instants of its publications. Shape (n,), int64, ascending.
        counts: By state, how many elements each carried (0 where the state has none). Shape (n,), int32.
    """

    times_us: dict[str, np.ndarray] = field(default_factory=dict)
    counts: dict[str, np.ndarray] = field(default_factory=dict)

    def to_bytes(self) -> bytes:
        """Compressed form for the ledger."""
        buffer = io.BytesIO()
        arrays: dict[str, Any] = {f"t:{name}": times for name, times in self.times_us.items()}
        arrays |= {f"n:{name}": counts for name, counts in self.counts.items()}
        np.savez_compressed(buffer, **arrays)
        return buffer.getvalue()

    @staticmethod
    def from_bytes(content: bytes) -> "Profile":
        """Inverse of `to_bytes`."""
        with np.load(io.BytesIO(content)) as archive:
            arrays = {name: archive[name] for name in archive.files}
        return Profile(
            {name[2:]: array for name, array in arrays.items() if name.startswith("t:")},
            {name[2:]: array for name, array in arrays.items() if name.startswith("n:")},
        )


@dataclass(slots=True)
class FlightLog:
    """One flight.

    Attributes:
        rows: One row per control tick, columns as in `COLUMNS`. Shape (n, 21), float64.
        status: How it ended.
        events: In the order in which they happened.
        injections: What the injector did, as plain data (level, site, time_s, bit, before, after, hit).
        alarms: What detectors said, and what recomputing gave, as plain data.
        meta: Scenario, start, goal, obstacles' digest, versions: plain data.
    """

    rows: np.ndarray
    status: MissionStatus
    events: list[Event] = field(default_factory=list)
    injections: list[dict[str, Any]] = field(default_factory=list)
    alarms: list[dict[str, Any]] = field(default_factory=list)
    meta: dict[str, Any] = field(default_factory=dict)

    def column(self, name: str) -> np.ndarray:
        """One column. Shape (n,)."""
        return self.rows[:, COLUMNS.index(name)]

    def columns(self, *names: str) -> np.ndarray:
        """Several columns. Shape (n, len(names))."""
        return self.rows[:, [COLUMNS.index(name) for name in names]]

    def digest(self) -> str:
        """SHA-256 over vehicle state, commands and mission status; injections, alarms and clocks are not in it."""
        content = np.ascontiguousarray(self.rows[:, :_DIGESTED]).tobytes()
        return hashlib.sha256(content + self.status.label.encode()).hexdigest()

    def count(self, kind: str) -> int:
        """How many events of a kind."""
        return sum(event.kind == kind for event in self.events)

    def save(self, path: Path) -> None:
        """Write an .npz file.

        Raises:
            BadInputError: The place cannot be written.
        """
        data = {
            "status": self.status.name,
            "events": [[e.time_us, e.kind, e.data] for e in self.events],
            "injections": self.injections, "alarms": self.alarms, "meta": self.meta,
        }  # fmt: skip
        buffer = io.BytesIO()
        np.savez_compressed(buffer, rows=self.rows, record=np.frombuffer(json.dumps(data).encode(), np.uint8))
        try:
            path.write_bytes(buffer.getvalue())
        except OSError as error:
            raise BadInputError(f"{path}: cannot be written ({error.strerror})") from None

    @staticmethod
    def load(path: Path) -> "FlightLog":
        """Read what `save` wrote.

        Raises:
            BadInputError: The file is absent or is no flight log.
        """
        try:
            with np.load(io.BytesIO(path.read_bytes())) as archive:
                rows, data = archive["rows"], json.loads(archive["record"].tobytes())
            events = [Event(*event) for event in data["events"]]
            return FlightLog(
                rows, MissionStatus[data["status"]], events, data["injections"], data["alarms"], data["meta"]
            )
        except (OSError, EOFError, LookupError, ValueError, TypeError, BadZipFile, zlib.error) as error:
            raise BadInputError(f"{path}: is not a flight log ({error})") from None
