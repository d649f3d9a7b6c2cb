"""Writer of telemetry logs (.tlog), for QGroundControl, Mission Planner, MAVExplorer and pymavlink.

A record is the time in microseconds (64 bits, big-endian) and a MAVLink 2 packet
(https://mavlink.io/en/guide/serialization.html).  Times are the instants of the flight, from 0.
"""

import math
import struct
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from mavfi.errors import writing
from mavfi.flight_log import FlightLog
from mavfi.flight_logs.lines import ERROR, INFO, WARN, Line, chunks_of, lines_of
from mavfi.flight_logs.ned import euler, geodetic, ned_of

Payload = tuple[tuple[int, int], bytes]
"""Message id with CRC_EXTRA, and payload."""
_SEVERITIES = {ERROR: 3, WARN: 4, INFO: 6}
"""MAV_SEVERITY of each level."""
_HEARTBEAT, _ATTITUDE, _LOCAL_POSITION, _GLOBAL_POSITION, _TEXT = (0, 50), (30, 39), (32, 185), (33, 104), (253, 83)
"""Message id and CRC_EXTRA, a checksum of the message's definition, from the dialect `common`."""
_QUADROTOR, _PX4, _ARMED_AUTO, _AUTO_MISSION, _ACTIVE, _VERSION = 2, 12, 0xDD, 4 << 16 | 4 << 24, 4, 3
_HEARTBEATS, _GLOBALS = 50, 5
"""Control periods between heartbeats (1 Hz), and between global positions (10 Hz)."""


def write_tlog(log: FlightLog, path: Path) -> int:
    """Write a flight; returns the number of messages."""
    texts = [(line.time_us, part) for number, line in enumerate(lines_of(log))
             for part in text_messages(line, number + 1)]  # fmt: skip
    motion = [(int(1e6 * max(0.0, row[0]) + 0.5), message) for place, row in enumerate(log.rows)
              for message in motion_messages(row, place)]  # fmt: skip
    messages = sorted([*motion, *texts], key=lambda message: message[0])
    with writing(path), path.open("wb") as file:
        for number, (time_us, message) in enumerate(messages):
            file.write(struct.pack(">Q", time_us) + packet(number, message))
    return len(messages)


def text_messages(line: Line, number: int) -> Iterator[Payload]:
    """The STATUSTEXT messages of a line; chunks of a long text share an id derived from `number`."""
    parts = chunks_of(line.text)
    own = 0 if len(parts) == 1 else number % 65_535 + 1
    for place, part in enumerate(parts):
        yield _TEXT, struct.pack("<B50sHB", _SEVERITIES[line.level], part, own, min(place, 255))


def motion_messages(row: np.ndarray, place: int) -> Iterator[Payload]:
    """Attitude and local position of one row of a flight log, its index; global position and heartbeat less often."""
    with np.errstate(over="ignore", invalid="ignore"):
        ned = ned_of(row[None])
        position, velocity, rates = (table[0].astype("<f4") for table in (ned.position, ned.velocity, ned.rates))
        angles = euler(ned.quaternion[0])
    ms = struct.pack("<I", int(ned.time_us[0]) // 1000 & 0xFFFFFFFF)
    if place % _HEARTBEATS == 0:
        body = struct.pack("<IBBBBB", _AUTO_MISSION, _QUADROTOR, _PX4, _ARMED_AUTO, _ACTIVE, _VERSION)
        yield _HEARTBEAT, body
    yield _ATTITUDE, ms + struct.pack("<3f", *angles) + rates.tobytes()
    yield _LOCAL_POSITION, ms + position.tobytes() + velocity.tobytes()
    if place % _GLOBALS == 0 and np.isfinite([*ned.position[0], *ned.velocity[0], *angles]).all():
        yield _GLOBAL_POSITION, ms + _global(ned.position[0], ned.velocity[0], angles[2])


def _global(position: np.ndarray, velocity: np.ndarray, yaw: float) -> bytes:
    """Degrees times 1e7, mm, cm/s and centidegrees; values that do not fit are limited."""
    latitude, longitude, altitude = geodetic(position)
    wide = [1e7 * latitude, 1e7 * longitude, 1e3 * altitude, -1e3 * float(position[2])]
    speeds = np.clip(100 * velocity, -32768, 32767).astype("<i2")
    heading = round(100 * (math.degrees(yaw) % 360)) % 36_000
    places = np.clip(wide, -(2**31), 2**31 - 1).astype("<i4")
    return bytes(places.tobytes() + speeds.tobytes() + struct.pack("<H", heading))


def packet(number: int, message: Payload) -> bytes:
    """A MAVLink 2 packet of system 1, component 1; trailing zeros of the payload are omitted."""
    (identity, extra), payload = message
    short = payload.rstrip(b"\0") or b"\0"
    header = struct.pack("<BBBBBB", len(short), 0, 0, number % 256, 1, 1) + identity.to_bytes(3, "little")
    return b"\xfd" + header + short + struct.pack("<H", checksum(header + short + bytes([extra])))


def checksum(content: bytes) -> int:
    """CRC-16/MCRF4XX, called X.25 in MAVLink's documentation."""
    crc = 0xFFFF
    for byte in content:
        value = (byte ^ crc) & 0xFF
        value = (value ^ value << 4) & 0xFF
        crc = crc >> 8 ^ value << 8 ^ value << 3 ^ value >> 4
    return crc
