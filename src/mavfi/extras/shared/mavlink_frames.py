"""Frames of MAVLink 1 and 2: cut out of a stream of bytes, read, and rebuilt with a valid checksum.

    0xFE length                             sequence system component id      payload checksum
    0xFD length incompatible compatible     sequence system component id x 3  payload checksum [signature]

Numbers are little-endian.  The checksum covers everything between the first byte and itself, and one byte more, which
both sides derive from the definition of the message (https://mavlink.io/en/guide/serialization.html).
"""

import struct
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

from mavfi.errors import not_installed
from mavfi.extras.shared.message_definition import FORMATS, Leaf

_MAVLINK_2 = 0xFD
_HEADERS = {0xFE: 6, _MAVLINK_2: 10}
"""Size of the header by its first byte, for MAVLink 1 and 2."""
_SEQUENCE = {0xFE: 2, _MAVLINK_2: 4}
"""Where the sequence number is; system, component and message follow it."""
_CHECKSUM = 2
_SIGNATURE = 13
_SIGNED = 1
"""The bit of the incompatibility flags."""
_KINDS = {code: kind for kind, code in FORMATS.items() if kind not in ("byte", "char", "bool")}


def mavlink_dialect(what: str, extra: str = "mavlink") -> Any:
    """The messages of MAVLink's dialect `ardupilotmega`, which includes `common`, from pymavlink.

    Args:
        what: What needs it, for the message if it is missing.
        extra: The extra of mavfi that installs it.

    Raises:
        NotInstalledError: It is not installed.
    """
    try:
        from pymavlink.dialects.v20 import ardupilotmega
    except ImportError:
        raise not_installed(what, "pymavlink", extra) from None
    return ardupilotmega


def numbers_of(kind: Any) -> dict[str, Leaf]:
    """Place of each number in the payload of a message type of the dialect; arrays as name[0], name[1] ...; no text."""
    leaves: dict[str, Leaf] = {}
    offset = 0
    codes = bytes(kind.native_format).decode()[1:]
    for name, code, length in zip(kind.ordered_fieldnames, codes, kind.array_lengths, strict=True):
        size = struct.calcsize(f"<{code}")
        if code in _KINDS:
            names = [name]
            if length:
                names = [f"{name}[{index}]" for index in range(length)]
            leaves |= {path: Leaf(offset + index * size, _KINDS[code]) for index, path in enumerate(names)}
        offset += size * max(1, length)
    return leaves


def frame_size(data: bytes, start: int = 0) -> int | None:
    """Size of the frame that starts at an offset (bytes).

    Returns:
        0 = no frame starts there; None = too few bytes to tell.
    """
    head = data[start : start + 3]
    if head and head[0] not in _HEADERS:
        return 0
    if len(head) < 3:
        return None
    size = _HEADERS[head[0]] + head[1] + _CHECKSUM
    if head[0] == _MAVLINK_2 and head[2] & _SIGNED:
        size += _SIGNATURE
    return size


@dataclass(frozen=True, slots=True)
class MavlinkFrame:
    """A whole frame.

    Attributes:
        data: Its bytes.
        kind: The message type of the dialect; None = the dialect does not define it.
    """

    data: bytes
    kind: Any = None

    @property
    def sequence(self) -> int:
        """The sequence number, which each component of a system counts."""
        return self.data[_SEQUENCE[self.data[0]]]

    @property
    def source(self) -> bytes:
        """Number of the system that sends it, and of its component."""
        return self.data[_SEQUENCE[self.data[0]] + 1 :][:2]

    @property
    def is_signed(self) -> bool:
        """Whether only the owner of a secret key can change it."""
        return self.data[0] == _MAVLINK_2 and bool(self.data[2] & _SIGNED)

    @property
    def payload(self) -> bytes:
        """Its payload; with the zeros that MAVLink 2 omits at its end, if the message is known."""
        payload = self.data[_HEADERS[self.data[0]] :][: self.data[1]]
        if self.data[0] == _MAVLINK_2 and self.kind is not None:
            payload = payload.ljust(self.kind.unpacker.size, b"\0")
        return payload

    def checksum_extra(self) -> int | None:
        """The byte behind the content in the checksum, of an unknown message the one that fits; None = none does."""
        end = _HEADERS[self.data[0]] + self.data[1]
        stored = int.from_bytes(self.data[end : end + _CHECKSUM], "little")
        extras: Iterable[int] = range(256)
        if self.kind is not None:
            extras = [self.kind.crc_extra]
        before = _checksum(self.data[1:end])
        return next((extra for extra in extras if _checksum(bytes([extra]), before) == stored), None)

    def rebuilt(self, *, sequence: int, payload: bytes | None = None) -> "MavlinkFrame":
        """A copy with this sequence number and perhaps another payload; a signed frame is returned as it is."""
        extra = self.checksum_extra()
        if self.is_signed or extra is None:
            return self
        header = bytearray(self.data[: _HEADERS[self.data[0]]])
        header[_SEQUENCE[header[0]]] = sequence % 256
        content = self.data[len(header) :][: header[1]]
        if payload is not None:
            content = payload
            if header[0] == _MAVLINK_2:  # zeros at the end are left out, but one byte always stays
                content = payload[:1] + payload[1:].rstrip(b"\0")
            header[1] = len(content)
        checksum = _checksum(bytes(header[1:]) + content + bytes([extra]))
        return MavlinkFrame(bytes(header) + content + struct.pack("<H", checksum), self.kind)


def _checksum(content: bytes, before: int = 0xFFFF) -> int:
    """CRC-16/MCRF4XX of bytes, behind others that have the checksum `before`."""
    from pymavlink.mavutil import x25crc

    checksum = x25crc()
    checksum.crc = before
    checksum.accumulate(content)
    return int(checksum.crc)


class FrameSplitter:
    """Cuts a stream of bytes into frames and what lies between them; joined again, the pieces are the stream.

    Args:
        dialect: See `mavlink_dialect`.
    """

    def __init__(self, dialect: Any) -> None:
        self._kinds = dialect.mavlink_map
        self._rest = b""  # the beginning of a frame whose end has not come

    def feed(self, data: bytes) -> Iterator[MavlinkFrame | bytes]:
        """The pieces that are complete with these further bytes of the stream."""
        data = self._rest + data
        between = start = 0  # what lies between frames began at `between`
        while start < len(data):
            size = frame_size(data, start)
            if size is None or start + size > len(data):
                break
            frame = None
            if size > 0:
                number = data[start + _SEQUENCE[data[start]] + 3 : start + _HEADERS[data[start]]]
                kind = self._kinds.get(int.from_bytes(number, "little"))
                frame = MavlinkFrame(data[start : start + size], kind)
            if frame is None or frame.checksum_extra() is None:
                start += 1  # nothing, or a damaged frame: the next one may begin with any byte
                continue
            if between < start:
                yield data[between:start]
            yield frame
            start += size
            between = start
        if between < start:
            yield data[between:start]
        self._rest = data[start:]
