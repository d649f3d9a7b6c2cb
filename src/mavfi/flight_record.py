"""`FlightRecord`: the entry of one flight in a ledger.  It has the data for evaluation, but no verdicts.

Success, quality of flight and effects are computed from records (`mavfi.qof`, `mavfi.outcomes`, `campaign.analysis`),
so a changed definition needs no new flight.
"""

import json
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from enum import StrEnum
from typing import Any

import numpy as np

from mavfi.config import checked
from mavfi.flight_log import AlarmRecord, FlightLog, Injection, KernelEffect

MOST_ALARMS = 20
"""Alarms stored for a flight with a fault, in addition to those in the `AFTERMATH`; all alarms are counted."""
MOST_GOLDEN_ALARMS = 1000
"""Alarms stored for an error-free flight, for comparison with those of injected runs."""
INSTANT = 0.5e-6
"""Times that differ by less are equal: times are whole microseconds (s)."""
AFTERMATH = 1.0
"""Time from the injection within which every alarm is stored (s)."""


LIMITED, SILENCED = "detector_limited", "detector_silenced"
"""Kinds of events: alarms get no response for a while, or no longer, since too many of them changed nothing."""
CRASHED = "detector_crashed"
"""Kind of the event when a custom detector is disabled after an exception."""
CONTROLLER_LOST = "controller_lost"
"""Kind of the event when a flight controller that is a program of its own ends or hangs."""


class End(StrEnum):
    """How a run ended as a computation: with a log, with a crash of the process, or with a defect of mavfi."""

    FLOWN = "flown"
    DUE = "due"
    UNKNOWN = "unknown"


@dataclass(frozen=True, slots=True)
class EnergyTerms:
    """Integrals over the flight from which the energy is computed (see `mavfi.qof`).

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
        every = {f.name: getattr(self, f.name) for f in fields(self)}
        data = {name: value for name, value in every.items() if name == "end" or value != _DEFAULTS[name]}
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


_FOR_READERS = ("file", "line"), ("inlined", "line_is_near", "variable")
"""Where in the source an injected instruction is: of its injection, and of the injection's details."""


def without_source(text: str) -> str:
    """The text of a record in a ledger, without what is looked up in the source: files, lines, names of variables.

    Two records of one flight are equal without it, also if code was moved, renamed or commented in between.
    """
    if '"instruction"' not in text and '"lines"' not in text:
        return text  # most records: they need not be parsed
    record = json.loads(text)
    for injection in record.get("injections", ()):
        if injection["level"] == "instruction":
            for part, names in zip((injection, injection["details"]), _FOR_READERS, strict=True):
                for name in names:
                    part.pop(name, None)
    for counted in record.get("counts", {}).values():
        counted.pop("lines", None)
    return canonical(record)


def record_of(log: FlightLog) -> FlightRecord:
    """The record of a flight; course, time limit, latencies, publications and rejected commands come from `meta`."""
    duration, distance, energy = _motion(log)
    meta = log.meta
    events = Counter(event.kind for event in log.events)
    end = End.DUE if events[CONTROLLER_LOST] else End.FLOWN
    return FlightRecord(
        end, log.status.label, log.digest(), duration, distance, energy, meta.get("course_m", 0.0),
        meta.get("time_limit_s", 0.0), tuple(log.injections), tuple(kept_alarms(log.injections, log.alarms)),
        len(log.alarms), dict(Counter(f"{a.source}/{a.action}/{a.outcome}" for a in log.alarms)),
        dict(events), dict(meta.get("compute_us", {})),
        dict(meta.get("recompute_us", {})), dict(meta.get("publications", {})), {},
        meta.get("rejected_commands", 0), log.kernel,
    )  # fmt: skip


def kept_alarms(injections: Sequence[Injection], alarms: Sequence[AlarmRecord]) -> list[AlarmRecord]:
    """The first alarms of a flight, and all within `AFTERMATH` of an activated injection, in order of time."""
    instants = [injection.time_s for injection in injections if injection.activated]
    most = MOST_ALARMS if injections else MOST_GOLDEN_ALARMS
    return [
        alarm
        for place, alarm in enumerate(alarms)
        if place < most or any(-INSTANT < alarm.time_s - time_s <= AFTERMATH for time_s in instants)
    ]


def _motion(log: FlightLog) -> tuple[float, float, EnergyTerms]:
    """Flight time (s), distance (m) and energy terms, from the rows before the first one that is not finite."""
    rows = log.columns("time", "x", "y", "z", "vx", "vy", "vz")
    finite = np.isfinite(rows).all(axis=1)
    rows = rows if finite.all() else rows[: int(np.argmin(finite))]
    if len(rows) < 2:
        return 0.0, 0.0, EnergyTerms()
    time, position, velocity = rows[:, 0], rows[:, 1:4], rows[:, 4:7]
    interval = np.diff(time)
    acceleration = np.diff(velocity, axis=0) / interval[:, None]
    mean = 0.5 * (velocity[1:] + velocity[:-1])
    speed_xy, acceleration_xy = (np.sqrt(v[:, 0] * v[:, 0] + v[:, 1] * v[:, 1]) for v in (mean, acceleration))
    speed_z, acceleration_z = np.abs(mean[:, 2]), np.abs(acceleration[:, 2])
    terms = (
        np.ones(len(interval)), speed_xy, acceleration_xy, speed_xy * acceleration_xy, speed_z, acceleration_z,
        speed_z * acceleration_z,
    )  # fmt: skip
    distance = float(np.linalg.norm(np.diff(position, axis=0), axis=1).sum())
    return float(time[-1] - time[0]), distance, EnergyTerms(*(float((term * interval).sum()) for term in terms))


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
