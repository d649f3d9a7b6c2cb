"""PX4's ULog files: a reader, with the library pyulog (extra `logs`), and a writer.

Format: https://docs.px4.io/main/en/dev_log/ulog_file_format.html, version 1; little-endian.  Time stamps are the
instants of the flight in microseconds.
"""

import struct
from collections.abc import Iterator, Mapping, Sequence
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np

from mavfi.errors import not_installed, writing
from mavfi.extras.logs.lines import ERROR, INFO, WARN, LogLine, line_of, lines_of
from mavfi.extras.logs.ned import ned_of
from mavfi.extras.shared.log_readers import LoggedMessage, RecordLayout, check_topics, numeric, reading
from mavfi.record import FlightLog

_FLIGHT_STATES = (
    ("vehicle_land_detected", "landed", 0),
    ("vehicle_status", "arming_state", 2),
    ("actuator_armed", "armed", 1),
)
"""Topic and field that tell whether the vehicle flies, and their value if it does; the first one in the file counts."""
_FILE_HEADER = 16
_HEADER = struct.Struct("<HB")
"""Of a message: size of what follows, type."""


def _indexed(name: str, count: int) -> tuple[str, ...]:
    """Names of the elements of an array."""
    return tuple(f"{name}[{index}]" for index in range(count))


class UlogReader:
    """Reads a ULog file; see `FlightLogReader`.

    Of topics with several instances, those after the first are named `topic.1`, `topic.2` ...  If the file says when
    the vehicle was on the ground (`vehicle_land_detected`), or else when it was armed (`vehicle_status`,
    `actuator_armed`), messages of all other times are left out.

    Attributes:
        notices: What could not be read, or was left out.
    """

    recommended = {  # outputs of flight software, from estimate to actuators, in old and new versions of PX4
        "vehicle_attitude": _indexed("q", 4),
        "vehicle_angular_velocity": _indexed("xyz", 3),
        "vehicle_local_position": ("x", "y", "z", "vx", "vy", "vz"),
        "vehicle_local_position_setpoint": (
            "x",
            "y",
            "z",
            "vx",
            "vy",
            "vz",
            *_indexed("acceleration", 3),
            *_indexed("thrust", 3),
        ),
        "trajectory_setpoint": (*_indexed("position", 3), *_indexed("velocity", 3), "yawspeed"),
        "vehicle_attitude_setpoint": (*_indexed("q_d", 4), "thrust_body[2]"),
        "vehicle_rates_setpoint": ("roll", "pitch", "yaw", "thrust_body[2]"),
        "actuator_controls_0": _indexed("control", 4),
        "actuator_motors": _indexed("control", 4),
        "vehicle_torque_setpoint": _indexed("xyz", 3),
        "actuator_outputs": _indexed("output", 4),
    }

    def __init__(self, path: Path) -> None:
        self._path = path
        self.notices: list[str] = []

    def messages(self, topics: Sequence[str]) -> Iterator[LoggedMessage]:
        """See `FlightLogReader`."""
        self.notices = []
        data_sets = self._data_sets()
        check_topics(self._path, topics, data_sets)
        spans = _airborne(data_sets)
        if not spans:
            self.notices.append("no flight: on the ground, or not armed, throughout")
        messages = []
        for topic, columns in data_sets.items():
            if topics and topic not in topics:
                continue
            times, rows = _rows(columns)
            flown = np.zeros(len(times), np.bool_)
            for begin, end in spans:
                flown |= (times >= begin) & (times < end)
            layout = RecordLayout.of(topic, rows.dtype)
            messages += [
                LoggedMessage(topic, time_us, layout, row.tobytes())
                for time_us, row in zip(times[flown].tolist(), rows[flown], strict=True)
            ]
        yield from sorted(messages, key=lambda message: message.time_us)

    def is_cut(self) -> bool:
        """Whether the file ends within a message, as after a loss of power."""
        data = self._path.read_bytes()
        offset = _FILE_HEADER
        while offset + _HEADER.size <= len(data):
            size, _ = _HEADER.unpack_from(data, offset)
            offset += _HEADER.size + size
        return offset != len(data)

    def _data_sets(self) -> dict[str, dict[str, np.ndarray]]:
        """Columns by topic; a damaged file, of which the library reads only the rest, is a BadInputError."""
        path = self._path
        try:
            import pyulog
        except ImportError:
            raise not_installed(f"{path}, a ULog file", "pyulog", "logs") from None
        with reading(path, "a ULog file"):
            with path.open("rb") as file, redirect_stdout(StringIO()):
                log: Any = pyulog.ULog(file)
            if log.file_corruption:
                self.notices.append("damaged: what could not be read was skipped")
            columns = {}
            for data_set in log.data_list:
                topic = data_set.name
                if data_set.multi_id:
                    topic = f"{data_set.name}.{data_set.multi_id}"
                if "timestamp" in data_set.data:
                    columns[topic] = data_set.data
                else:
                    self.notices.append(f"{topic}: not read, it has no timestamp")
            if not columns:
                raise ValueError("no topic with a timestamp")
            return columns


def _rows(columns: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Time stamps (us), and all other numbers as a structured array, row by row."""
    numbers = {
        name: column
        for name, column in columns.items()
        if name != "timestamp" and not name.startswith("_padding") and numeric(column.dtype)
    }
    rows = np.zeros(len(columns["timestamp"]), [(name, column.dtype) for name, column in numbers.items()])
    for name, column in numbers.items():
        rows[name] = column
    return columns["timestamp"].astype(np.int64), rows


def _airborne(data_sets: Mapping[str, Mapping[str, np.ndarray]]) -> list[tuple[int, int]]:
    """Times (us) in the air, from and until; everything if the file does not say."""
    forever = int(np.iinfo(np.int64).max)
    for topic, field, code in _FLIGHT_STATES:
        columns = data_sets.get(topic, {})
        if not len(columns.get(field, ())):
            continue
        times = [*columns["timestamp"].astype(np.int64).tolist(), forever]  # each state lasts until the next one
        in_flight = columns[field] == code
        return [(begin, end) for begin, end, flies in zip(times, times[1:], in_flight, strict=False) if flies]
    return [(0, forever)]


# ---- writer ------------------------------------------------------------------------------------------------------

FAULT_TOPIC = "mavfi_fault"
"""Topic that is 0 before and 1 from the first activated injection."""
FAULT_FIELD = "active"
"""The field of the topic that tells it."""
_MAGIC = b"ULog\x01\x12\x35\x01"
_LEVELS = {ERROR: b"3", WARN: b"4", INFO: b"6"}
"""Severities of syslog, as in Linux."""
FORMATS = {
    "vehicle_local_position": "uint64_t timestamp;float x;float y;float z;float vx;float vy;float vz;",
    "vehicle_attitude": "uint64_t timestamp;float[4] q;",
    "vehicle_angular_velocity": "uint64_t timestamp;float[3] xyz;",
    "trajectory_setpoint": "uint64_t timestamp;float[3] position;float[3] velocity;float yawspeed;",
    FAULT_TOPIC: f"uint64_t timestamp;uint8_t {FAULT_FIELD};",
}
"""Messages and fields as in PX4, NED and FRD."""


def write_ulog(log: FlightLog, path: Path) -> int:
    """Write a flight; returns the number of data samples and logged messages."""
    samples = _samples(log)
    logged = [(line.time_us, _logged(line)) for line in lines_of(log)]
    records = sorted([*samples, *logged], key=lambda record: record[0])
    with writing(path), path.open("wb") as file:
        file.write(_MAGIC + struct.pack("<Q", 0) + _definitions(log))
        file.writelines(content for _, content in records)
    return len(records)


def _message(kind: str, body: bytes) -> bytes:
    """A message of a type, a letter."""
    return struct.pack("<HB", len(body), ord(kind)) + body


def _definitions(log: FlightLog) -> bytes:
    """Flag bits, information, formats, and one subscription per topic."""
    scenario = log.meta.get("scenario", {})
    information = {"sys_name": "mavfi", "ver_hw": "simulation", "mavfi_status": log.status.label}
    information["mavfi_environment"] = str(scenario.get("environment", {}).get("name", ""))
    parts = [_message("B", bytes(40))]
    for key, value in information.items():
        typed = f"char[{len(value.encode())}] {key}".encode()
        parts.append(_message("I", bytes([len(typed)]) + typed + value.encode()))
    parts += [_message("F", f"{name}:{fields}".encode()) for name, fields in FORMATS.items()]
    parts += [_message("A", struct.pack("<BH", 0, number) + name.encode()) for number, name in enumerate(FORMATS)]
    return b"".join(parts)


def _samples(log: FlightLog) -> list[tuple[int, bytes]]:
    """Instant and bytes of every data sample."""
    # The topics of the flight, in the order of `FORMATS`.
    ned = ned_of(log.rows)
    tables = (
        np.hstack([ned.position, ned.velocity]),
        ned.quaternion,
        ned.rates,
        np.hstack([ned.reference, ned.command, ned.yaw_rate[:, None]]),
    )
    samples = []
    with np.errstate(over="ignore"):  # values of corrupted states beyond float32 become infinite
        narrow = [table.astype("<f4") for table in tables]
    for row, time_us in enumerate(ned.time_us.tolist()):
        for number, table in enumerate(narrow):
            samples.append((time_us, _message("D", struct.pack("<HQ", number, time_us) + table[row].tobytes())))
    # The fault: 0 at the start, 1 from the first activated injection on.
    number = list(FORMATS).index(FAULT_TOPIC)
    samples.append((0, _message("D", struct.pack("<HQB", number, 0, 0))))
    for injection in log.injections:
        line = line_of(injection)
        if injection.activated and line is not None:
            samples.append((line.time_us, _message("D", struct.pack("<HQB", number, line.time_us, 1))))
            break
    return samples


def _logged(line: LogLine) -> bytes:
    """A line of the log."""
    return _message("L", _LEVELS[line.level] + struct.pack("<Q", line.time_us) + line.text.encode())
