"""Columnar log of one flight: rows of vehicle states and commands, events, injections, alarms."""

import hashlib
import io
import json
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from enum import StrEnum
from pathlib import Path
from typing import Any
from zipfile import ZipFile

import numpy as np

from mavfi.config import checked
from mavfi.errors import BadInputError, writing
from mavfi.files import read_file
from mavfi.mission import MissionStatus

COLUMNS = (
    "time",
    "x",
    "y",
    "z",
    "vx",
    "vy",
    "vz",
    "qw",
    "qx",
    "qy",
    "qz",
    "wx",
    "wy",
    "wz",
    "command_vx",
    "command_vy",
    "command_vz",
    "command_yaw_rate",
    "reference_x",
    "reference_y",
    "reference_z",
)
"""Columns of `FlightLog.rows`: s, m, m/s, unit quaternion, rad/s (body), m/s and rad/s, m."""
LATEST_S = 1e9
"""Latest instant of a flight (s)."""
_LARGEST_FILE = 1 << 27
"""Largest file that is read as a flight log (bytes)."""
_LARGEST_CONTENT = 1 << 28
"""Largest content of such a file when decompressed (bytes)."""
_DIGESTED = len(COLUMNS) - 3
"""Leading columns that the digest covers: all but the reference."""


@dataclass(frozen=True, slots=True)
class Event:
    """An event at an instant: a plan, an alarm of the collision check, a warning of the simulator."""

    time_us: int
    kind: str
    data: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Injection:
    """Record of one injection, at any level.

    Attributes:
        level: "state", "memory", "instruction", "message", "register" or "sensor".
        site: Site as text: "planning.waypoint.x", "memory:planner.decisions.acted_seq", "octomap.insert_scan",
            "joint_states.position[0]", "xmm0", "gyro drift".
        time_s: Time in the flight (s); for messages and registers outside a flight, since the tool's start (s).
        bit: Index of the bit; None for a null fault, or if a whole value was replaced.
        before: Value before; None = not activated, or not a number.
        after: Value after.
        activated: Whether the site was reached and changed as planned (a null fault: left unchanged).
        file: Source file of the instruction, relative to the folder from which it was imported; "" = none.
        line: Source line; 0 = none.
        details: Further data of the level (opcode, value class, variable, register, library, readers ...): plain data.
    """

    level: str
    site: str
    time_s: float
    bit: int | None
    before: float | int | bool | str | None
    after: float | int | bool | str | None
    activated: bool
    file: str = ""
    line: int = 0
    details: Mapping[str, Any] = field(default_factory=dict)

    def to_json(self) -> dict[str, Any]:
        """Plain data; infinities and NaN as text, since JSON has none."""
        return asdict(self) | {"before": _plain(self.before), "after": _plain(self.after)}

    @staticmethod
    def from_json(data: Mapping[str, Any]) -> "Injection":
        """Inverse of `to_json`, a BadInputError for invalid data; values that JSON cannot represent stay text."""
        return checked(Injection, data, "injection")


@dataclass(frozen=True, slots=True)
class AlarmRecord:
    """An alarm of a flight, and the recovery from it.

    Attributes:
        time_s: Time in the flight (s).
        source: Detector or rule that raised it.
        state: The publication concerned.
        stage: Stage whose recomputation it requests.
        score: Anomaly score in units of the threshold.
        fields: The anomalous fields, "state.field".
        action: Action of the host: "recompute", "abandon", "stop", "restart" or "resend".
        outcome: Result: "replaced", "repaired", "accepted" (same value again), "rejected" (violated a rule again), or
            "restarted" (the node).
    """

    time_s: float
    source: str
    state: str
    stage: str
    score: float = 0.0
    fields: tuple[str, ...] = ()
    action: str = "recompute"
    outcome: str = "replaced"

    def to_json(self) -> dict[str, Any]:
        """Plain data."""
        return asdict(self) | {"fields": list(self.fields), "score": _plain(self.score)}

    @staticmethod
    def from_json(data: Mapping[str, Any]) -> "AlarmRecord":
        """Inverse of `to_json`; a BadInputError for invalid data."""
        return checked(AlarmRecord, data, "alarm")


@dataclass(frozen=True, slots=True)
class KernelEffect:
    """Effect of one injected call on its kernel, by comparison in flight with the golden output of that step.

    Attributes:
        effect: Label of an `outcomes.Effect`: "masked", "sdc", "crash", "hang", "exception", "detected" or
            "not_activated".
        detail: Signal, budget or exception; "" = none.
        first_difference: The first published field that differs, as plain data (see `flight.instruction_cases`); None =
            all published fields are equal.
    """

    effect: str
    detail: str = ""
    first_difference: Mapping[str, Any] | None = None


def _plain(value: float | int | bool | str | None) -> float | int | bool | str | None:
    """A number as JSON can represent it: infinities and NaN as text."""
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    return value


@dataclass(slots=True)
class Profile:
    """Publication times of each state in a golden run, from which faults are drawn.

    Only publications that consumers act on are listed (see `StateSpec.acted_on`).

    Attributes:
        times_us: By state, the times of its publications. Shape (n,), int64, ascending.
        counts: By state, number of elements in each (0 if the state has none). Shape (n,), int32.
    """

    times_us: dict[str, np.ndarray] = field(default_factory=dict)
    counts: dict[str, np.ndarray] = field(default_factory=dict)


@dataclass(slots=True)
class FlightLog:
    """One flight.

    Attributes:
        rows: One row per control tick, columns as in `COLUMNS`. Shape (n, 21), float64.
        status: Mission status at the end.
        events: Events in order of time.
        injections: Injection records.
        alarms: Detector alarms, and the outcome of their recovery.
        meta: Scenario, start, goal, obstacles' digest, versions: plain data.
        kernel: Effect of the injected call on its kernel, for a flight with an instruction fault; None otherwise.
    """

    rows: np.ndarray
    status: MissionStatus
    events: list[Event] = field(default_factory=list)
    injections: list[Injection] = field(default_factory=list)
    alarms: list[AlarmRecord] = field(default_factory=list)
    meta: dict[str, Any] = field(default_factory=dict)
    kernel: KernelEffect | None = None

    def column(self, name: str) -> np.ndarray:
        """One column. Shape (n,)."""
        return self.rows[:, COLUMNS.index(name)]

    def columns(self, *names: str) -> np.ndarray:
        """Several columns. Shape (n, len(names))."""
        return self.rows[:, [COLUMNS.index(name) for name in names]]

    def digest(self) -> str:
        """SHA-256 over vehicle state, commands and mission status; excludes injections, alarms and clocks."""
        content = np.ascontiguousarray(self.rows[:, :_DIGESTED]).tobytes()
        return hashlib.sha256(content + self.status.label.encode()).hexdigest()

    def count(self, kind: str) -> int:
        """Number of events of a kind."""
        return sum(event.kind == kind for event in self.events)

    def save(self, path: Path | str) -> None:
        """Write an .npz file: one array for each of `COLUMNS`, by its name, and `record`, all other data as JSON text.

        So `np.load(path)["x"]` is the x coordinate at each control tick, and `json.loads(str(file["record"]))` has
        status, events, injections, alarms and meta.

        Raises:
            BadInputError: The file cannot be written.
        """
        kernel = None
        if self.kernel is not None:
            kernel = asdict(self.kernel)
        data = {
            "status": self.status.name,
            "events": [[e.time_us, e.kind, e.data] for e in self.events],
            "injections": [injection.to_json() for injection in self.injections],
            "alarms": [alarm.to_json() for alarm in self.alarms],
            "meta": self.meta,
            "kernel": kernel,
        }
        buffer = io.BytesIO()
        columns: dict[str, Any] = dict(zip(COLUMNS, self.rows.T, strict=True))
        np.savez_compressed(buffer, **columns, record=np.array(json.dumps(data)))
        with writing(path):
            Path(path).write_bytes(buffer.getvalue())

    @staticmethod
    def load(path: Path | str) -> "FlightLog":
        """Read a file written by `save`.

        Raises:
            BadInputError: The file is absent or not a flight log.
        """
        try:
            arrays = read_arrays(Path(path))
            columns = [arrays[name] for name in COLUMNS]
            if any(column.ndim != 1 or column.dtype.kind not in "fiu" for column in columns) or not len(columns[0]):
                raise ValueError("columns: allowed: one number per control tick, one tick or more")
            rows = np.column_stack(columns).astype(np.float64)
            stored = checked(_Stored, json.loads(str(arrays["record"])), "record")
            status = MissionStatus[stored.status]
            events = [Event(*event) for event in stored.events]
        except (BadInputError, LookupError, RecursionError, ValueError) as error:
            why = str(error).removeprefix(f"{path}: ")
            raise BadInputError(f"{path}: is not a flight log ({why})") from None
        # Readers compute with these times: none may be absurdly large.
        times = [1e-6 * event.time_us for event in events]
        times += [injection.time_s for injection in stored.injections]
        times += [alarm.time_s for alarm in stored.alarms]
        if any(LATEST_S < abs(time) < math.inf for time in times) or not (abs(rows[:, 0]) <= LATEST_S).all():
            raise BadInputError(f"{path}: is not a flight log (times: allowed: {LATEST_S:g} s at most)")
        return FlightLog(rows, status, events, stored.injections, stored.alarms, stored.meta, stored.kernel)


@dataclass(frozen=True, slots=True)
class _Stored:
    """Content of `record` in the file written by `FlightLog.save`."""

    status: str
    events: list[tuple[int, str, dict[str, Any]]]
    injections: list[Injection]
    alarms: list[AlarmRecord]
    meta: dict[str, Any]
    kernel: KernelEffect | None


def read_arrays(path: Path) -> dict[str, np.ndarray]:
    """Arrays of an .npz file; objects are not unpickled.

    Raises:
        BadInputError: The file cannot be read, is not such a file, or is too large when decompressed.
    """
    content = read_file(path, _LARGEST_FILE)
    try:
        with ZipFile(io.BytesIO(content)) as archive:
            size = sum(member.file_size for member in archive.infolist())
        if size > _LARGEST_CONTENT:
            raise BadInputError(f"{path}: {size:,} bytes when decompressed; allowed: {_LARGEST_CONTENT:,}")
        with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
            contents = {name: arrays[name] for name in arrays.files}
        if not all(isinstance(array, np.ndarray) for array in contents.values()):
            raise BadInputError(f"{path}: holds members that are no arrays")
        return contents
    except BadInputError:
        raise
    except Exception as error:  # noqa: BLE001 - whatever NumPy and zipfile raise at a damaged file
        raise BadInputError(f"{path}: is not an archive of arrays ({type(error).__name__}: {error})") from None


# ---- `FlightRecord`: the entry of one flight in a ledger.  It has the data for evaluation, but no verdicts.

MOST_ALARMS = 20
"""Alarms stored for a flight with a fault, in addition to those in the `AFTERMATH`; all alarms are counted."""
MOST_GOLDEN_ALARMS = 1000
"""Alarms stored for an error-free flight, for comparison with those of injected runs."""
INSTANT = 0.5e-6
"""Times that differ by less are equal: times are whole microseconds (s)."""
AFTERMATH = 1.0
"""Time from the injection within which every alarm is stored (s)."""


LIMITED = "detector_limited"
"""Kind of the event when alarms get no response for a while, since too many of them changed nothing."""
SILENCED = "detector_silenced"
"""Kind of the event when alarms get no response any longer, for the same reason."""
CRASHED = "detector_crashed"
"""Kind of the event when a custom detector is disabled after an exception."""
CONTROLLER_LOST = "controller_lost"
"""Kind of the event when a flight controller that is a program of its own ends or hangs."""


class End(StrEnum):
    """How a run ended as a computation: with a log, with a crash of the process, or with a defect of mavfi."""

    FLOWN = "flown"  # with a log, also if the mission failed
    DUE = "due"  # with a crash: a detected unrecoverable error
    UNKNOWN = "unknown"  # with a defect of mavfi: it cannot be judged


@dataclass(frozen=True, slots=True)
class EnergyTerms:
    """Integrals over the flight from which the energy is computed (see `mavfi.outcomes`).

    Speeds are means of two rows, accelerations are difference quotients; world frame.

    Attributes:
        duration_s: Duration of the finite part of the log (s).
        speed_xy: Integral of |v_xy| (m).
        acceleration_xy: Integral of |a_xy| (m/s).
        product_xy: Integral of |v_xy| |a_xy| (m^2/s^2).
        speed_z: Integral of |v_z| (m).
        acceleration_z: Integral of |a_z| (m/s).
        product_z: Integral of |v_z| |a_z| (m^2/s^2).
    """

    duration_s: float = 0.0
    speed_xy: float = 0.0
    acceleration_xy: float = 0.0
    product_xy: float = 0.0
    speed_z: float = 0.0
    acceleration_z: float = 0.0
    product_z: float = 0.0


@dataclass(frozen=True, slots=True)
class FlightRecord:
    """One flight of a campaign.

    Attributes:
        end: Whether there is a flight to judge.
        status: Label of the `MissionStatus`; "" = none.
        digest: SHA-256 of vehicle states, commands and status; "" = none.
        flight_time_s: From the first to the last finite row of the log (s).
        distance_m: Length of the flown path (m).
        energy: Integrals for the energy.
        course_m: Straight distance from start to goal (m).
        time_limit_s: Time limit of the flight (s).
        injections: Injection records.
        alarms: The first alarms, and those in the `AFTERMATH` of an activated injection, in order of time.
        alarms_total: All alarms.
        alarm_counts: All alarms by "source/action/outcome".
        events: Number of events by kind.
        compute_us: Modelled compute time by kernel (us), including recomputations.
        recompute_us: Modelled recomputation time by stage (us).
        publications: Number of publications by state.
        acted_on: For a golden run without a detector: publications by state that consumers act on.
        rejected_commands: Commands rejected by the flight controller.
        kernel: Effect of the injected call (level instruction); None at other levels.
        counts: For a golden run at instruction level: by kernel, dynamic `instructions`, `calls`, and `lines`.
        extra: Additional data of a host, e.g. outputs of a foreign node; plain data.
        error: Reason if there is no flight; "" = there is one.
    """

    end: End
    status: str = ""
    digest: str = ""
    flight_time_s: float = 0.0
    distance_m: float = 0.0
    energy: EnergyTerms = EnergyTerms()
    course_m: float = 0.0
    time_limit_s: float = 0.0
    injections: tuple[Injection, ...] = ()
    alarms: tuple[AlarmRecord, ...] = ()
    alarms_total: int = 0
    alarm_counts: Mapping[str, int] = field(default_factory=dict)
    events: Mapping[str, int] = field(default_factory=dict)
    compute_us: Mapping[str, int] = field(default_factory=dict)
    recompute_us: Mapping[str, int] = field(default_factory=dict)
    publications: Mapping[str, int] = field(default_factory=dict)
    acted_on: Mapping[str, int] = field(default_factory=dict)
    rejected_commands: int = 0
    kernel: KernelEffect | None = None
    counts: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    extra: Mapping[str, Any] = field(default_factory=dict)
    error: str = ""

    @property
    def flown(self) -> bool:
        """Whether there is a flight to judge."""
        return self.end is End.FLOWN

    @property
    def replans(self) -> int:
        """Plans after the first one."""
        return max(0, self.events.get("plan", 0) - 1)

    def to_json(self) -> dict[str, Any]:
        """Plain data; fields with default values are omitted."""
        data = {}
        for name, default in _DEFAULTS.items():
            value = getattr(self, name)
            if name == "end" or value != default:
                data[name] = value
        for name in ("energy", "kernel"):
            if name in data:
                data[name] = asdict(data[name])
        for name in ("injections", "alarms"):
            if name in data:
                data[name] = [item.to_json() for item in data[name]]
        plain_data: dict[str, Any] = plain(data)
        return plain_data

    @staticmethod
    def from_json(data: Mapping[str, Any]) -> "FlightRecord":
        """Inverse of `to_json`; a BadInputError for invalid data."""
        return checked(FlightRecord, data, "record")


_DEFAULTS: dict[str, Any] = {f.name: getattr(FlightRecord(End.FLOWN), f.name) for f in fields(FlightRecord)}
"""Default values of a record's fields, which `to_json` omits."""


_SOURCE_KEYS = ("file", "line")
"""Keys of an injection that say where in the source the instruction is."""
_SOURCE_DETAILS = ("inlined", "line_is_near", "variable")
"""Keys of an injection's details that say the same."""


def without_source(text: str) -> str:
    """The text of a record in a ledger, without what is looked up in the source: files, lines, names of variables.

    Two records of one flight are equal without it, also if code was moved, renamed or commented in between.
    """
    if '"instruction"' not in text and '"lines"' not in text:
        return text  # most records: they need not be parsed
    record = json.loads(text)
    for injection in record.get("injections", ()):
        if injection["level"] == "instruction":
            for key in _SOURCE_KEYS:
                injection.pop(key, None)
            for key in _SOURCE_DETAILS:
                injection["details"].pop(key, None)
    for counted in record.get("counts", {}).values():
        counted.pop("lines", None)
    return canonical(record)


def record_of(log: FlightLog) -> FlightRecord:
    """The record of a flight; course, time limit, latencies, publications and rejected commands come from `meta`."""
    duration, distance, energy = _motion(log)
    meta = log.meta
    events = Counter(event.kind for event in log.events)
    # the loss of a flight controller is a crash, even if the vehicle was flown on
    end = End.FLOWN
    if events[CONTROLLER_LOST]:
        end = End.DUE
    return FlightRecord(
        end=end,
        status=log.status.label,
        digest=log.digest(),
        flight_time_s=duration,
        distance_m=distance,
        energy=energy,
        course_m=meta.get("course_m", 0.0),
        time_limit_s=meta.get("time_limit_s", 0.0),
        injections=tuple(log.injections),
        alarms=tuple(kept_alarms(log.injections, log.alarms)),
        alarms_total=len(log.alarms),
        alarm_counts=dict(Counter(f"{alarm.source}/{alarm.action}/{alarm.outcome}" for alarm in log.alarms)),
        events=dict(events),
        compute_us=dict(meta.get("compute_us", {})),
        recompute_us=dict(meta.get("recompute_us", {})),
        publications=dict(meta.get("publications", {})),
        rejected_commands=meta.get("rejected_commands", 0),
        kernel=log.kernel,
    )


def kept_alarms(injections: Sequence[Injection], alarms: Sequence[AlarmRecord]) -> list[AlarmRecord]:
    """The first alarms of a flight, and all within `AFTERMATH` of an activated injection, in order of time."""
    instants = [injection.time_s for injection in injections if injection.activated]
    first_count = MOST_GOLDEN_ALARMS
    if injections:
        first_count = MOST_ALARMS
    selected = list(alarms[:first_count])
    for alarm in alarms[first_count:]:
        if any(-INSTANT < alarm.time_s - time_s <= AFTERMATH for time_s in instants):
            selected.append(alarm)
    return selected


def _motion(log: FlightLog) -> tuple[float, float, EnergyTerms]:
    """Flight time (s), distance (m) and energy terms, from the rows before the first one that is not finite."""
    rows = log.columns("time", "x", "y", "z", "vx", "vy", "vz")
    finite = np.isfinite(rows).all(axis=1)
    if not finite.all():
        rows = rows[: int(np.argmin(finite))]
    if len(rows) < 2:
        return 0.0, 0.0, EnergyTerms()
    # means and differences over each interval between two rows
    time = rows[:, 0]
    position = rows[:, 1:4]
    velocity = rows[:, 4:7]
    interval = np.diff(time)
    acceleration = np.diff(velocity, axis=0) / interval[:, None]
    mean = 0.5 * (velocity[1:] + velocity[:-1])
    speed_xy = _horizontal(mean)
    acceleration_xy = _horizontal(acceleration)
    speed_z = np.abs(mean[:, 2])
    acceleration_z = np.abs(acceleration[:, 2])
    # in the order of the attributes of `EnergyTerms`
    terms = (
        np.ones(len(interval)),
        speed_xy,
        acceleration_xy,
        speed_xy * acceleration_xy,
        speed_z,
        acceleration_z,
        speed_z * acceleration_z,
    )
    distance = float(np.linalg.norm(np.diff(position, axis=0), axis=1).sum())
    return float(time[-1] - time[0]), distance, EnergyTerms(*(float((term * interval).sum()) for term in terms))


def _horizontal(vectors: np.ndarray) -> np.ndarray:
    """Length of the horizontal part of each vector. Shape (n,)."""
    x = vectors[:, 0]
    y = vectors[:, 1]
    length: np.ndarray = np.sqrt(x * x + y * y)
    return length


def canonical(data: Any) -> str:
    """Canonical JSON text of plain data."""
    return json.dumps(data, sort_keys=True, separators=(",", ":"), allow_nan=False)


def plain(value: Any) -> Any:
    """Convert data for JSON: NumPy numbers and arrays to Python's; infinities and NaN to text."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    return value
