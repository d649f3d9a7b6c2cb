"""MAVLink telemetry logs (.tlog), with the library pymavlink (extra `mavlink`)."""

import struct
from collections.abc import Iterator, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

from mavfi.errors import BadInputError
from mavfi.extras.logs.reader import LoggedMessage, Record, check_topics, reading
from mavfi.faults.levels.message.definition import FORMATS, Leaf

_GROUND_STATION = 250
"""Systems from this number on are ground stations."""
_KINDS = {code: kind for kind, code in FORMATS.items() if kind not in ("byte", "char", "bool")}
_MAVLINK_2 = 0xFD
_HEADERS = {0xFE: 6, _MAVLINK_2: 10}
"""Size of the header by its first byte, for MAVLink 1 and 2."""
_STAMP, _CHECKSUM, _SIGNATURE = 8, 2, 13
"""Sizes of what comes before a packet, and behind it."""
_WITHOUT_NUMBERS = ("BAD_DATA", "STATUSTEXT")


def mavlink_dialect() -> Any:
    """The messages of MAVLink's dialect `common`, from pymavlink.

    Raises:
        BadInputError: It is not installed.
    """
    try:
        from pymavlink.dialects.v20 import common
    except ImportError:
        raise BadInputError("MAVLink needs pymavlink; allowed: pip install 'mavfi[mavlink]'") from None
    return common


class TlogReader:
    """Reads a telemetry log; see `FlightLogReader`.  Topics are names of messages, e.g. "ATTITUDE", of any vehicle."""

    recommended = {
        "ATTITUDE": ("roll", "pitch", "yaw", "rollspeed", "pitchspeed", "yawspeed"),
        "ATTITUDE_QUATERNION": ("q1", "q2", "q3", "q4"),
        "LOCAL_POSITION_NED": ("x", "y", "z", "vx", "vy", "vz"),
        "POSITION_TARGET_LOCAL_NED": ("x", "y", "z", "vx", "vy", "vz"),
        "VFR_HUD": ("airspeed", "groundspeed", "alt", "climb"),
    }

    def __init__(self, path: Path) -> None:
        self._path = path

    def messages(self, topics: Sequence[str]) -> Iterator[LoggedMessage]:
        """See `FlightLogReader`."""
        path, kind = self._path, "a telemetry log"
        mavlink_dialect()
        from pymavlink.mavutil import mavlogfile

        with reading(path, kind), closing(mavlogfile(str(path), notimestamps=False)) as link:
            found = list(_all_of(link))
        if not found:
            raise BadInputError(f"{path}: is not {kind} that can be read (no MAVLink message of a vehicle)")
        check_topics(path, topics, {message.topic for message in found})
        yield from (message for message in found if not topics or message.topic in topics)

    def is_cut(self) -> bool:
        """Whether the file ends within a message, as after a loss of power."""
        data, place = self._path.read_bytes(), 0
        while place < len(data):
            magic = data[place + _STAMP : place + _STAMP + 3]
            if len(magic) < 3:
                return True
            if magic[0] not in _HEADERS:
                return False  # damaged elsewhere
            signed = magic[0] == _MAVLINK_2 and magic[2] & 1
            place += _STAMP + _HEADERS[magic[0]] + magic[1] + _CHECKSUM + (_SIGNATURE if signed else 0)
        return place != len(data)


def _all_of(link: Any) -> Iterator[LoggedMessage]:
    """All messages of vehicles."""
    layouts: dict[str, Record] = {}
    while (message := link.recv_match()) is not None:
        topic = message.get_type()
        if topic in _WITHOUT_NUMBERS or topic.startswith("UNKNOWN") or message.get_srcSystem() >= _GROUND_STATION:
            continue
        layout = layouts.setdefault(topic, Record(topic, _leaves(type(message))))
        yield LoggedMessage(topic, round(1e6 * message._timestamp), layout, _payload(message))


def _payload(message: Any) -> bytes:
    """Payload of a received message, with the trailing zeros that MAVLink 2 omits."""
    packet, size = bytes(message.get_msgbuf()), message.unpacker.size
    begin = _HEADERS[packet[0]]
    return packet[begin : begin + min(packet[1], size)].ljust(size, b"\0")


def _leaves(kind: Any) -> dict[str, Leaf]:
    """Place of each number, arrays as name[0], name[1] ...; text is left out."""
    leaves: dict[str, Leaf] = {}
    offset = 0
    codes = bytes(kind.native_format).decode()[1:]
    for name, code, length in zip(kind.ordered_fieldnames, codes, kind.array_lengths, strict=True):
        size = struct.calcsize(f"<{code}")
        if code in _KINDS:
            names = [f"{name}[{index}]" for index in range(length)] if length else [name]
            leaves |= {own: Leaf(offset + index * size, _KINDS[code]) for index, own in enumerate(names)}
        offset += size * max(1, length)
    return leaves
