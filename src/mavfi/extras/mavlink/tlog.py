"""MAVLink messages of a flight, and telemetry logs (.tlog) of them, with the library pymavlink (extra `mavlink`).

QGroundControl, Mission Planner and MAVExplorer read these logs.  A record is the time in microseconds (64 bits,
big-endian) and a MAVLink 2 packet.  Times are the instants of the flight, from 0.
"""

import math
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from mavfi.errors import writing
from mavfi.extras.logs.tlog import mavlink_dialect
from mavfi.numerics.frames import Triple, euler, geodetic, ned_of
from mavfi.record import FlightLog
from mavfi.report.export.lines import ERROR, INFO, WARN, Line, chunks_of, lines_of

_SEVERITIES = {ERROR: 3, WARN: 4, INFO: 6}
"""MAV_SEVERITY of each level."""
_QUADROTOR, _PX4, _ARMED_AUTO, _AUTO_MISSION, _ACTIVE, _VERSION = 2, 12, 0xDD, 4 << 16 | 4 << 24, 4, 3
_HEARTBEATS, _GLOBALS = 50, 5
"""Control periods between heartbeats (1 Hz), and between global positions (10 Hz)."""


def write_tlog(log: FlightLog, path: Path) -> int:
    """Write a flight; returns the number of messages.

    Raises:
        BadInputError: pymavlink is not installed, or the file cannot be written.
    """
    messages = FlightMessages()
    texts = [(line.time_us, part) for number, line in enumerate(lines_of(log))
             for part in messages.text(line, number + 1)]  # fmt: skip
    motion = [(int(1e6 * max(0.0, row[0]) + 0.5), message) for place, row in enumerate(log.rows)
              for message in messages.motion(row, place)]  # fmt: skip
    records = sorted([*motion, *texts], key=lambda record: record[0])
    with writing(path), path.open("wb") as file:
        link = messages.link(file)
        for time_us, message in records:
            file.write(struct.pack(">Q", time_us))
            link.send(message)
    return len(records)


class FlightMessages:
    """Makes the messages of a flight; a `BadInputError` without pymavlink."""

    def __init__(self) -> None:
        self._dialect = mavlink_dialect()

    def link(self, file: Any) -> Any:
        """Packs messages of system 1, component 1, and writes each packet to a file-like object."""
        return self._dialect.MAVLink(file, srcSystem=1, srcComponent=1)

    def text(self, line: Line, number: int) -> Iterator[Any]:
        """The STATUSTEXT messages of a line; chunks of a long text share an id derived from `number`."""
        parts = chunks_of(line.text)
        shared_id = 0 if len(parts) == 1 else number % 65_535 + 1
        for place, part in enumerate(parts):
            yield self._dialect.MAVLink_statustext_message(_SEVERITIES[line.level], part, shared_id, min(place, 255))

    def motion(self, row: np.ndarray, place: int) -> Iterator[Any]:
        """Attitude and local position of a row of a flight log, its index; global position and heartbeat less often."""
        dialect = self._dialect
        with np.errstate(over="ignore", invalid="ignore"):  # values of corrupted states beyond float32 become infinite
            ned = ned_of(row[None])
            tables = ned.position, ned.velocity, ned.rates
            position, velocity, rates = (table[0].astype(np.float32).tolist() for table in tables)
            angles = euler(ned.quaternion[0])
        ms = int(ned.time_us[0]) // 1000 & 0xFFFFFFFF
        if place % _HEARTBEATS == 0:
            yield dialect.MAVLink_heartbeat_message(_QUADROTOR, _PX4, _ARMED_AUTO, _AUTO_MISSION, _ACTIVE, _VERSION)
        yield dialect.MAVLink_attitude_message(ms, *angles, *rates)
        yield dialect.MAVLink_local_position_ned_message(ms, *position, *velocity)
        if place % _GLOBALS == 0 and np.isfinite([*ned.position[0], *ned.velocity[0], *angles]).all():
            whole = _global(ned.position[0], ned.velocity[0], angles)
            yield dialect.MAVLink_global_position_int_message(ms, *whole)


def _global(position: np.ndarray, velocity: np.ndarray, angles: Triple) -> list[int]:
    """Degrees times 1e7, mm, cm/s and centidegrees; values that do not fit are limited."""
    latitude, longitude, altitude = geodetic(position)
    wide = [1e7 * latitude, 1e7 * longitude, 1e3 * altitude, -1e3 * float(position[2])]
    places = np.clip(wide, -(2**31), 2**31 - 1).astype(np.int32)
    speeds = np.clip(100 * velocity, -32768, 32767).astype(np.int16)
    heading = round(100 * (math.degrees(angles[2]) % 360)) % 36_000
    return [*places.tolist(), *speeds.tolist(), heading]
