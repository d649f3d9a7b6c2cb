"""MAVLink messages of a flight, and telemetry logs (.tlog) of them, with the library pymavlink (extra `logs`).

QGroundControl, Mission Planner and MAVExplorer read these logs.  A record is the time in microseconds (64 bits,
big-endian) and a MAVLink 2 packet.  Times are the instants of the flight, from 0.
"""

import math
import socket
import struct
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from mavfi.errors import BadInputError, writing
from mavfi.extras.logs.lines import ERROR, INFO, WARN, LogLine, lines_at, lines_of
from mavfi.extras.logs.ned import euler, ned_of
from mavfi.extras.shared.frames import Triple, geodetic
from mavfi.extras.shared.log_readers import LoggedMessage, RecordLayout, check_topics, reading
from mavfi.extras.shared.mavlink_frames import MavlinkFrame, frame_size, mavlink_dialect, numbers_of
from mavfi.flight.loop import Loop
from mavfi.flight.observers import FlightItem
from mavfi.mission import MissionStatus
from mavfi.record import FlightLog
from mavfi.states import State

_GROUND_STATION = 250
"""Systems from this number on are ground stations."""
_STAMP = 8
"""Size of the time before a frame (bytes)."""
_LONGEST_TEXT = 50
"""Characters of one STATUSTEXT; longer texts are sent in chunks."""
_WITHOUT_NUMBERS = ("BAD_DATA", "STATUSTEXT")
_UNKNOWN = "UNKNOWN"
"""Start of the name of messages that the dialect does not define."""


def _chunks_of(text: str) -> list[bytes]:
    """The texts of the STATUSTEXT messages of a line: one or more."""
    content = text.encode("ascii", "replace")
    return [content[start : start + _LONGEST_TEXT] for start in range(0, len(content), _LONGEST_TEXT)] or [b""]


class TlogReader:
    """Reads a telemetry log; see `FlightLogReader`.

    Topics are names of messages, e.g. "ATTITUDE", of any vehicle.  Messages of further systems have the number of the
    system behind the name, "ATTITUDE.2"; those of further components of a system, both numbers, "ATTITUDE.1.191"; and
    those of one of several instances, e.g. batteries, its number or name, "BATTERY_STATUS[0]".

    Attributes:
        notices: What could not be read.
    """

    recommended = {
        "ATTITUDE": ("roll", "pitch", "yaw", "rollspeed", "pitchspeed", "yawspeed"),
        "ATTITUDE_QUATERNION": ("q1", "q2", "q3", "q4"),
        "LOCAL_POSITION_NED": ("x", "y", "z", "vx", "vy", "vz"),
        "POSITION_TARGET_LOCAL_NED": ("x", "y", "z", "vx", "vy", "vz"),
        "VFR_HUD": ("airspeed", "groundspeed", "alt", "climb"),
    }

    def __init__(self, path: Path) -> None:
        self._path = path
        self.notices: list[str] = []

    def messages(self, topics: Sequence[str]) -> Iterator[LoggedMessage]:
        """See `FlightLogReader`."""
        path = self._path
        kind = "a telemetry log"
        mavlink_dialect(f"{path}, {kind}", "logs")
        from pymavlink.mavutil import mavlogfile

        with reading(path, kind), closing(mavlogfile(str(path), notimestamps=False)) as link:
            received = list(_all_of(link))
        unknown = Counter(item.name for item in received if item.name.startswith(_UNKNOWN))
        self.notices = [f"{count} messages of type {name}: not read" for name, count in sorted(unknown.items())]
        logged = _by_source([item for item in received if item.name not in unknown])
        if not logged:
            raise BadInputError(f"{path}: is not {kind} that can be read (no MAVLink message of a vehicle)")
        check_topics(path, topics, {message.topic for message in logged})
        yield from (message for message in logged if not topics or message.topic in topics)

    def is_cut(self) -> bool:
        """Whether the file ends within a message, as after a loss of power."""
        data = self._path.read_bytes()
        offset = 0
        while offset < len(data):
            size = frame_size(data, offset + _STAMP)
            if size is None:
                return True
            if size == 0:
                return False  # damaged elsewhere
            offset += _STAMP + size
        return offset != len(data)


class _Received(NamedTuple):
    """A message of a vehicle.

    Attributes:
        name: Name of its type.
        source: Number of the system and of its component.
        instance: Which of several it is about, e.g. "[0]"; "" = there is only one.
        message: The message, without a topic.
    """

    name: str
    source: tuple[int, int]
    instance: str
    message: LoggedMessage


def _all_of(link: Any) -> Iterator[_Received]:
    """All messages of vehicles."""
    layouts: dict[str, RecordLayout] = {}
    nothing = RecordLayout("unknown", {})
    while (message := link.recv_match()) is not None:
        name = message.get_type()
        source = message.get_srcSystem(), message.get_srcComponent()
        if name in _WITHOUT_NUMBERS or source[0] >= _GROUND_STATION:
            continue
        if name.startswith(_UNKNOWN):
            yield _Received(name, source, "", LoggedMessage(name, 0, nothing, b""))
            continue
        kind = type(message)
        if name not in layouts:
            layouts[name] = RecordLayout(name, numbers_of(kind), getattr(kind, "fieldunits_by_name", {}))
        instance = ""
        field = getattr(kind, "instance_field", None)
        if field is not None:
            instance = f"[{getattr(message, field)}]"
        time_us = round(1e6 * message._timestamp)
        yield _Received(name, source, instance, LoggedMessage(name, time_us, layouts[name], _payload(message)))


def _by_source(received: Sequence[_Received]) -> list[LoggedMessage]:
    """The messages with topics that tell their sources apart, see `TlogReader`."""
    systems = {item.source[0] for item in received}
    components: dict[tuple[str, int], set[int]] = {}
    for item in received:
        components.setdefault((item.name, item.source[0]), set()).add(item.source[1])
    logged = []
    for item in received:
        system, component = item.source
        topic = item.name
        if component != min(components[item.name, system]):
            topic += f".{system}.{component}"
        elif system != min(systems):
            topic += f".{system}"
        logged.append(replace(item.message, topic=topic + item.instance))
    return logged


def _payload(message: Any) -> bytes:
    """Payload of a received message, with the trailing zeros that MAVLink 2 omits."""
    size = message.unpacker.size
    return MavlinkFrame(bytes(message.get_msgbuf()), message).payload[:size].ljust(size, b"\0")


# ---- writer ------------------------------------------------------------------------------------------------------

_SEVERITIES = {ERROR: 3, WARN: 4, INFO: 6}
"""MAV_SEVERITY of each level."""
_QUADROTOR = 2
_PX4 = 12
_ARMED_AUTO = 0xDD
_AUTO_MISSION = 4 << 16 | 4 << 24
_ACTIVE = 4
_VERSION = 3
_HEARTBEATS = 50
_GLOBALS = 5
"""Control periods between heartbeats (1 Hz), and between global positions (10 Hz)."""


def write_tlog(log: FlightLog, path: Path) -> int:
    """Write a flight; returns the number of messages.

    Raises:
        BadInputError: pymavlink is not installed, or the file cannot be written.
    """
    messages = FlightMessages()
    records: list[tuple[int, Any]] = []
    for index, row in enumerate(log.rows):
        time_us = int(1e6 * max(0.0, row[0]) + 0.5)
        records += [(time_us, message) for message in messages.motion(row, index)]
    for number, line in enumerate(lines_of(log), 1):
        records += [(line.time_us, message) for message in messages.text(line, number)]
    records.sort(key=lambda record: record[0])  # stable: at one instant motion comes before text
    with writing(path), path.open("wb") as file:
        link = messages.link(file)
        for time_us, message in records:
            file.write(struct.pack(">Q", time_us))
            link.send(message)
    return len(records)


class FlightMessages:
    """Makes the messages of a flight; a `BadInputError` without pymavlink."""

    def __init__(self) -> None:
        self._dialect = mavlink_dialect("MAVLink", "logs")

    def link(self, file: Any) -> Any:
        """Packs messages of system 1, component 1, and writes each packet to a file-like object."""
        return self._dialect.MAVLink(file, srcSystem=1, srcComponent=1)

    def text(self, line: LogLine, number: int) -> Iterator[Any]:
        """The STATUSTEXT messages of a line; chunks of a long text share an id derived from `number`."""
        parts = _chunks_of(line.text)
        shared_id = 0
        if len(parts) > 1:
            shared_id = number % 65_535 + 1
        for index, part in enumerate(parts):
            yield self._dialect.MAVLink_statustext_message(_SEVERITIES[line.level], part, shared_id, min(index, 255))

    def motion(self, row: np.ndarray, index: int) -> Iterator[Any]:
        """Attitude and local position of a row of a flight log, its index; global position and heartbeat less often."""
        dialect = self._dialect
        with np.errstate(over="ignore", invalid="ignore"):  # values of corrupted states beyond float32 become infinite
            ned = ned_of(row[None])
            tables = ned.position, ned.velocity, ned.rates
            position, velocity, rates = (table[0].astype(np.float32).tolist() for table in tables)
            angles = euler(ned.quaternion[0])
        ms = int(ned.time_us[0]) // 1000 & 0xFFFFFFFF
        if index % _HEARTBEATS == 0:
            yield dialect.MAVLink_heartbeat_message(_QUADROTOR, _PX4, _ARMED_AUTO, _AUTO_MISSION, _ACTIVE, _VERSION)
        yield dialect.MAVLink_attitude_message(ms, *angles, *rates)
        yield dialect.MAVLink_local_position_ned_message(ms, *position, *velocity)
        if index % _GLOBALS == 0 and np.isfinite([*ned.position[0], *ned.velocity[0], *angles]).all():
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


# ---- running flights -------------------------------------------------------------------------------------------------

HOST = "127.0.0.1"


class Telemetry:
    """Sends the messages of a telemetry log to a port on loopback, until `close`; an observer of flights.

    Events, alarms and injections are sent as STATUSTEXT.

    Args:
        port: UDP port of the ground station.

    Raises:
        BadInputError: pymavlink is not installed.
    """

    def __init__(self, port: int) -> None:
        self._messages = FlightMessages()
        self._link = self._messages.link(self)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._to = HOST, port
        self._rows = 0
        self._texts = 0

    def begin(self, loop: Loop) -> None:
        """See `Observer`."""

    def published(self, state: State, time_us: int) -> None:
        """See `Observer`."""

    def tick(self, row: np.ndarray, items: list[FlightItem], status: MissionStatus | None) -> None:
        """See `Observer`."""
        for message in self._messages.motion(row, self._rows):
            self._link.send(message)
        self._rows += 1
        for line in lines_at(float(row[0]), items, status):
            self._texts += 1
            for message in self._messages.text(line, self._texts):
                self._link.send(message)

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()

    def write(self, packet: bytes) -> None:
        """Send a packet."""
        with writing(f"udp://{HOST}:{self._to[1]}"):
            try:
                self._socket.sendto(packet, self._to)
            except ConnectionRefusedError:  # no ground station listens yet
                pass
