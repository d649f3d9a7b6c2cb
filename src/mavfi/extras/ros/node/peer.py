"""A ROS node implemented by mavfi: the XML-RPC interface of every ROS node, and topics that it publishes.

Only `advertise` and `subscribe` register with the master.
"""

import os
import socket
import struct
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from socketserver import ThreadingMixIn
from typing import Any
from xmlrpc.server import SimpleXMLRPCServer

from mavfi.errors import BadInputError, MavfiError
from mavfi.extras.ros.node.master import CALLER, PATIENCE_S, Master, call
from mavfi.faults.levels.message.definition import Definition

# ---- TCPROS: headers, frames, and the subscriber ---------------------------------------------------------------------
_LENGTH = struct.Struct("<I")
LARGEST_HEADER = 1 << 24


def encode_header(fields: Mapping[str, str]) -> bytes:
    """Encode a connection header."""
    parts = [f"{name}={value}".encode() for name, value in fields.items()]
    body = b"".join(_LENGTH.pack(len(part)) + part for part in parts)
    return _LENGTH.pack(len(body)) + body


def decode_header(body: bytes) -> dict[str, str]:
    """Inverse of `encode_header`, without the leading length."""
    fields = {}
    offset = 0
    while offset < len(body):
        (size,) = _LENGTH.unpack_from(body, offset)
        name, _, value = body[offset + 4 : offset + 4 + size].decode(errors="replace").partition("=")
        fields[name] = value
        offset += 4 + size
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


class TopicSource:
    """A connection to one publisher of a topic, as node `caller`; not registered with the master.

    Raises:
        MavfiError: The publisher does not respond, or does not publish the topic.
        BadInputError: It does not send its message definition.
    """

    def __init__(self, node: str, uri: str, topic: str, caller: str = CALLER) -> None:
        self.node = node
        self.uri = uri
        self.topic = topic

        # ask the publisher for its address
        answer = call(uri, "requestTopic", caller, topic, [["TCPROS"]])
        if not answer or answer[0] != "TCPROS":
            raise MavfiError(f"{node}: offers {topic}, but not over TCPROS")
        try:
            self._socket = socket.create_connection((answer[1], int(answer[2])), PATIENCE_S)
        except OSError as error:
            raise MavfiError(f"{node}: does not send {topic} ({error})") from None
        self._stream = self._socket.makefile("rb")

        # exchange headers: any type is accepted, and its definition is in the answer
        try:
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._socket.sendall(
                encode_header({"callerid": caller, "topic": topic, "type": "*", "md5sum": "*", "tcp_nodelay": "1"})
            )
            self.header = decode_header(read_frame(self._stream, LARGEST_HEADER))
        except (OSError, EOFError) as error:
            self.close()
            raise MavfiError(f"{node}: does not send {topic} ({error or 'connection closed'})") from None

        # refuse a publisher that refuses, or that does not say what it sends
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


# ---- the peer --------------------------------------------------------------------------------------------------------
LOOPBACK = "127.0.0.1"
_SEND_PATIENCE = struct.pack("ll", 1, 0)  # struct timeval: 1 s


class _Server(ThreadingMixIn, SimpleXMLRPCServer):
    daemon_threads = True


@dataclass(slots=True, eq=False)
class Reader:
    """A subscriber of this node; messages are sent only to active ones."""

    node: str
    connection: socket.socket
    active: bool


@dataclass(slots=True, eq=False)
class Outlet:
    """A published topic; `header` is sent to its subscribers, which are `active` at once or later.

    A latched topic keeps its `last` message for new subscribers.
    """

    topic: str
    header: Mapping[str, str]
    active: bool = True
    readers: list[Reader] = field(default_factory=list)
    last: bytes | None = None
    lock: threading.Lock = field(default_factory=threading.Lock)

    def send(self, data: bytes) -> int:
        """Send a message to all active subscribers; returns their number."""
        whole = frame(data)
        with self.lock:
            if self.header.get("latching") == "1":
                self.last = data
            return sum(self._send(reader, whole) for reader in list(self.readers) if reader.active)

    def _send(self, reader: Reader, whole: bytes) -> bool:
        try:
            reader.connection.sendall(whole)
        except OSError:
            self.readers.remove(reader)
            reader.connection.close()
            return False
        return True

    def reader(self, node: str) -> Reader | None:
        """The connection of a node."""
        with self.lock:
            return next((reader for reader in self.readers if reader.node == node), None)

    def join(self, reader: Reader) -> None:
        """Add a subscriber that has connected."""
        with self.lock:
            self.readers.append(reader)
            if reader.active and self.last is not None:
                self._send(reader, frame(self.last))

    def leave(self, reader: Reader) -> None:
        """Remove a subscriber that has disconnected."""
        with self.lock, suppress(ValueError):
            self.readers.remove(reader)
        reader.connection.close()


class Inlet:
    """A topic subscribed to as node `caller`; `failures`: errors of connections to publishers."""

    def __init__(self, topic: str, arrived: Callable[[bytes], None], caller: str) -> None:
        self.topic = topic
        self._arrived = arrived
        self._caller = caller
        self.sources: dict[str, TopicSource] = {}
        self.failures: list[str] = []
        self._lock = threading.Lock()

    def connect(self, uris: Sequence[str]) -> None:
        """Connect to exactly these publishers."""
        with self._lock:
            for uri in [uri for uri in self.sources if uri not in uris]:
                self.sources.pop(uri).close()
            for uri in uris:
                if uri not in self.sources:
                    try:
                        source = TopicSource(uri, uri, self.topic, self._caller)
                    except MavfiError as error:
                        self.failures.append(str(error))
                        continue
                    self.sources[uri] = source
                    threading.Thread(target=self._read, args=(uri, source), daemon=True).start()

    def _read(self, uri: str, source: TopicSource) -> None:
        for message in source.messages():
            self._arrived(message)
        with self._lock:
            if self.sources.get(uri) is source:
                del self.sources[uri]


class Peer:
    """A participant of the graph with a given name."""

    def __init__(self, master: Master, name: str) -> None:
        self.master = master
        self.name = name
        self._outlets: dict[str, Outlet] = {}
        self._inlets: dict[str, Inlet] = {}
        self._listener = socket.create_server((LOOPBACK, 0))
        self._server = _Server((LOOPBACK, 0), logRequests=False, allow_none=True)
        self.uri = f"http://{LOOPBACK}:{self._server.server_address[1]}/"
        for method, function in self._interface().items():
            self._server.register_function(function, method)
        threading.Thread(target=self._server.serve_forever, args=(0.05,), daemon=True).start()
        threading.Thread(target=self._accept, daemon=True).start()

    def close(self) -> None:
        """Stop listening, and close all connections."""
        self._server.shutdown()
        self._server.server_close()
        with suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        for inlet in self._inlets.values():
            inlet.connect([])
        for outlet in self._outlets.values():
            for reader in list(outlet.readers):
                with suppress(OSError):
                    reader.connection.shutdown(socket.SHUT_RDWR)
                outlet.leave(reader)

    def offer(self, topic: str, header: Mapping[str, str], active: bool = True) -> Outlet:
        """Publish a topic to nodes that are notified directly, without the master; see `Outlet`."""
        description = {
            name: header[name] for name in ("type", "md5sum", "message_definition", "latching") if name in header
        }
        self._outlets[topic] = Outlet(topic, {"callerid": self.name, **description}, active)
        return self._outlets[topic]

    def advertise(self, topic: str, header: Mapping[str, str]) -> Outlet:
        """Publish a topic and register it with the master."""
        outlet = self.offer(topic, header)
        self.master.call("registerPublisher", topic, header["type"], self.uri, caller=self.name)
        return outlet

    def subscribe(self, topic: str, arrived: Callable[[bytes], None]) -> Inlet:
        """Subscribe to a topic: `arrived` receives each message, in the thread of its publisher."""
        self._inlets[topic] = Inlet(topic, arrived, self.name)
        publishers = self.master.call("registerSubscriber", topic, "*", self.uri, caller=self.name)
        self._inlets[topic].connect(publishers)
        return self._inlets[topic]

    # ---- subscribers ------------------------------------------------------------------------------------------------
    def _accept(self) -> None:
        while True:
            try:
                connection, _ = self._listener.accept()
            except OSError:
                return
            threading.Thread(target=self._greet, args=(connection,), daemon=True).start()

    def _greet(self, connection: socket.socket) -> None:
        """Answer a subscriber's connection header, and wait until it disconnects."""
        stream = connection.makefile("rb")
        try:
            request = decode_header(read_frame(stream, LARGEST_HEADER))
            outlet = self._outlets.get(request.get("topic", ""))
            if outlet is None:
                connection.sendall(encode_header({"error": "no such topic here"}))
                return
            mismatch = _mismatch(request, outlet.header)
            if mismatch:
                connection.sendall(encode_header({"error": mismatch}))
                return
            # messages are small and time-critical; a subscriber that reads none for a second is dropped
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, _SEND_PATIENCE)
            connection.sendall(encode_header(outlet.header))
            reader = Reader(request.get("callerid", ""), connection, outlet.active)
            outlet.join(reader)
            try:
                while connection.recv(4096):  # subscribers send nothing after the header
                    pass
            finally:
                outlet.leave(reader)
        except (OSError, EOFError):
            return
        finally:
            stream.close()
            connection.close()

    # ---- the interface of a node ------------------------------------------------------------------------------------
    def _interface(self) -> dict[str, Callable[..., list[Any]]]:
        """Methods of http://wiki.ros.org/ROS/Slave_API; their first argument is the caller's name."""
        return {
            "getPid": lambda _: [1, "", os.getpid()],
            "getMasterUri": lambda _: [1, "", self.master.uri],
            "getBusStats": lambda _: [1, "", [[], [], []]],
            "getBusInfo": lambda _: [1, "", self._connections()],
            "getSubscriptions": lambda _: [1, "", [[topic, "*"] for topic in self._inlets]],
            "getPublications": lambda _: [1, "", [[out.topic, out.header["type"]] for out in self._outlets.values()]],
            "requestTopic": self._request_topic,
            "publisherUpdate": self._update_publishers,
            "paramUpdate": lambda *_: [1, "", 0],
            "shutdown": lambda *_: [0, "is ended by its user alone", 0],
        }

    def _connections(self) -> list[list[Any]]:
        ends = [(out.topic, "o", [reader.node for reader in list(out.readers)]) for out in self._outlets.values()]
        ends += [(inlet.topic, "i", list(inlet.sources)) for inlet in self._inlets.values()]
        return [
            [number, name, direction, "TCPROS", topic, True, "TCPROS connection"]
            for topic, direction, names in ends
            for number, name in enumerate(names)
        ]

    def _request_topic(self, caller: str, topic: str, protocols: list[Any]) -> list[Any]:
        if topic not in self._outlets or not any(protocol[:1] == ["TCPROS"] for protocol in protocols):
            return [0, "no such topic here", []]
        return [1, "ready", ["TCPROS", LOOPBACK, self._listener.getsockname()[1]]]

    def _update_publishers(self, caller: str, topic: str, uris: list[str]) -> list[Any]:
        if topic in self._inlets:
            threading.Thread(target=self._inlets[topic].connect, args=(uris,), daemon=True).start()
        return [1, "", 0]


def _mismatch(request: Mapping[str, str], header: Mapping[str, str]) -> str:
    """Why a subscriber's message type does not match; "" if it does."""
    wanted = request.get("md5sum", "*")
    if wanted in ("*", header["md5sum"]) or header["md5sum"] == "*":
        return ""
    return f"md5sum of {request.get('type')} is {wanted}, not {header['md5sum']}"
