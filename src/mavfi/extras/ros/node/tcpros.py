"""TCPROS, the protocol of ROS 1 messages (http://wiki.ros.org/ROS/TCPROS): headers, frames, and the subscriber."""

import socket
import struct
from collections.abc import Iterator, Mapping
from contextlib import suppress
from typing import Any

from mavfi.errors import BadInputError, MavfiError
from mavfi.extras.ros.node.master import CALLER, PATIENCE_S, call
from mavfi.faults.levels.message.definition import Definition

_LENGTH = struct.Struct("<I")
LARGEST_HEADER = 1 << 24


def encode_header(fields: Mapping[str, str]) -> bytes:
    """Encode a connection header."""
    parts = [f"{name}={value}".encode() for name, value in fields.items()]
    body = b"".join(_LENGTH.pack(len(part)) + part for part in parts)
    return _LENGTH.pack(len(body)) + body


def decode_header(body: bytes) -> dict[str, str]:
    """Inverse of `encode_header`, without the leading length."""
    fields, place = {}, 0
    while place < len(body):
        (size,) = _LENGTH.unpack_from(body, place)
        name, _, value = body[place + 4 : place + 4 + size].decode(errors="replace").partition("=")
        fields[name] = value
        place += 4 + size
    return fields


def read_frame(stream: Any, largest: int = 0) -> bytes:
    """Read one frame without its length (at most `largest` bytes, 0 = any); `EOFError` if the peer has closed."""
    head = stream.read(4)
    if len(head) < 4:
        raise EOFError
    (size,) = _LENGTH.unpack(head)
    if largest and size > largest:
        raise EOFError
    body: bytes = stream.read(size)
    if len(body) < size:
        raise EOFError
    return body


def frame(data: bytes) -> bytes:
    """A message with its length prefix."""
    return _LENGTH.pack(len(data)) + data


class Source:
    """A connection to one publisher of a topic, as node `caller`; not registered with the master.

    Raises:
        MavfiError: The publisher does not respond, or does not publish the topic.
        BadInputError: It does not send its message definition.
    """

    def __init__(self, node: str, uri: str, topic: str, caller: str = CALLER) -> None:
        self.node, self.uri, self.topic = node, uri, topic
        answer = call(uri, "requestTopic", caller, topic, [["TCPROS"]])
        if not answer or answer[0] != "TCPROS":
            raise MavfiError(f"{node}: offers {topic}, but not over TCPROS")
        try:
            self._socket = socket.create_connection((answer[1], int(answer[2])), PATIENCE_S)
        except OSError as error:
            raise MavfiError(f"{node}: does not send {topic} ({error})") from None
        self._stream = self._socket.makefile("rb")
        try:
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._socket.sendall(encode_header(
                {"callerid": caller, "topic": topic, "type": "*", "md5sum": "*", "tcp_nodelay": "1"}
            ))  # fmt: skip
            self.header = decode_header(read_frame(self._stream, LARGEST_HEADER))
        except (OSError, EOFError) as error:
            self.close()
            raise MavfiError(f"{node}: does not send {topic} ({error or 'connection closed'})") from None
        if "error" in self.header:
            self.close()
            raise MavfiError(f"{node}: does not send {topic}: {self.header['error']}")
        self._socket.settimeout(None)
        if not self.header.get("message_definition"):
            self.close()
            raise BadInputError(f"topic {topic}: {node} does not send the definition of {self.header.get('type')}")

    @property
    def is_latched(self) -> bool:
        """Whether new subscribers receive the last message immediately."""
        return self.header.get("latching") == "1"

    def definition(self) -> Definition:
        """Definition of the messages."""
        return Definition(self.header["type"], self.header["message_definition"])

    def messages(self) -> Iterator[bytes]:
        """Iterate over incoming messages until either side closes; then close this side."""
        try:
            while True:
                yield read_frame(self._stream)
        except (OSError, EOFError, ValueError):
            return
        finally:
            self.close()

    def close(self) -> None:
        """Close the connection; ends `messages` in the thread that iterates over it."""
        with suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
        with suppress(OSError):
            self._stream.close()  # blocks until the reading thread, just woken, releases it
        self._socket.close()
