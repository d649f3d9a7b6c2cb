"""Writer of PX4's ULog files, for PlotJuggler, Flight Review and pyulog.

Format: https://docs.px4.io/main/en/dev_log/ulog_file_format.html, version 1; little-endian.  Time stamps are the
instants of the flight in microseconds.
"""

import struct
from pathlib import Path

import numpy as np

from mavfi.errors import writing
from mavfi.numerics.frames import ned_of
from mavfi.record import FlightLog
from mavfi.report.export.lines import ERROR, INFO, WARN, Line, line_of, lines_of

FAULT_TOPIC = "mavfi_fault"
"""Topic that is 0 before and 1 from the first activated injection."""
_MAGIC = b"ULog\x01\x12\x35\x01"
_LEVELS = {ERROR: b"3", WARN: b"4", INFO: b"6"}
"""Severities of syslog, as in Linux."""
FORMATS = {
    "vehicle_local_position": "uint64_t timestamp;float x;float y;float z;float vx;float vy;float vz;",
    "vehicle_attitude": "uint64_t timestamp;float[4] q;",
    "vehicle_angular_velocity": "uint64_t timestamp;float[3] xyz;",
    "trajectory_setpoint": "uint64_t timestamp;float[3] position;float[3] velocity;float yawspeed;",
    FAULT_TOPIC: "uint64_t timestamp;uint8_t active;",
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
    return struct.pack("<HB", len(body), ord(kind)) + body


def _definitions(log: FlightLog) -> bytes:
    """Flag bits, information, formats, and one subscription per topic."""
    scenario = log.meta.get("scenario", {})
    information = {"sys_name": "mavfi", "ver_hw": "simulation", "mavfi_status": log.status.label}
    information |= {"mavfi_environment": str(scenario.get("environment", {}).get("name", ""))}
    parts = [_message("B", bytes(40))]
    for key, value in information.items():
        typed = f"char[{len(value.encode())}] {key}".encode()
        parts.append(_message("I", bytes([len(typed)]) + typed + value.encode()))
    parts += [_message("F", f"{name}:{fields}".encode()) for name, fields in FORMATS.items()]
    parts += [_message("A", struct.pack("<BH", 0, number) + name.encode()) for number, name in enumerate(FORMATS)]
    return b"".join(parts)


def _samples(log: FlightLog) -> list[tuple[int, bytes]]:
    """Instant and bytes of every data sample."""
    ned = ned_of(log.rows)
    tables = (
        np.hstack([ned.position, ned.velocity]), ned.quaternion, ned.rates,
        np.hstack([ned.reference, ned.command, ned.yaw_rate[:, None]]),
    )  # fmt: skip
    found = []
    with np.errstate(over="ignore"):  # values of corrupted states beyond float32 become infinite
        narrow = [table.astype("<f4") for table in tables]
    for row, time_us in enumerate(ned.time_us.tolist()):
        for number, table in enumerate(narrow):
            found.append((time_us, _message("D", struct.pack("<HQ", number, time_us) + table[row].tobytes())))
    number = list(FORMATS).index(FAULT_TOPIC)
    active = [line.time_us for item in log.injections if item.activated and (line := line_of(item)) is not None]
    onset = [(0, 0), *((instant, 1) for instant in active[:1])]
    return found + [(instant, _message("D", struct.pack("<HQB", number, instant, on))) for instant, on in onset]


def _logged(line: Line) -> bytes:
    return _message("L", _LEVELS[line.level] + struct.pack("<Q", line.time_us) + line.text.encode())
