"""Our end of the graph: the interface that every ROS node has, and topics that others can read from us.

Nothing is registered with the master unless `advertise` is called.
"""

import os
import socket
import struct
import threading
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from socketserver import ThreadingMixIn
from typing import Any
from xmlrpc.server import SimpleXMLRPCServer

from mavfi.errors import MavfiError
from mavfi.hosts.node.master import Master
from mavfi.hosts.node.tcpros import LARGEST_HEADER, Source, decode_header, encode_header, frame, read_frame

LOOPBACK = "127.0.0.1"
_SEND_PATIENCE_S = 1.0


class _Server(ThreadingMixIn, SimpleXMLRPCServer):
    daemon_threads = True


@dataclass(slots=True, eq=False)
class Reader:
    """A node that reads from us.

    Attributes:
        node: Its name.
        connection: To it.
        active: Whether it is sent what is published.
    """

    node: str
    connection: socket.socket
    active: bool


@dataclass(slots=True, eq=False)
class Outlet:
    """A topic that others can read from us.

    Attributes:
        topic: Its name.
        header: Type, md5sum, message_definition and latching, as sent to readers.
        active: Whether new readers are active at once.
        readers: Those that are connected.
        last: For a latched topic: what is sent to new readers.
    """

    topic: str
    header: Mapping[str, str]
    active: bool = True
    readers: list[Reader] = field(default_factory=list)
    last: bytes | None = None
    lock: threading.Lock = field(default_factory=threading.Lock)

    def send(self, data: bytes) -> int:
        """Send a message to all active readers, and answer how many there were."""
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
        """A node has connected."""
        with self.lock:
            self.readers.append(reader)
            if reader.active and self.last is not None:
                self._send(reader, frame(self.last))

    def leave(self, reader: Reader) -> None:
        """A node has disconnected."""
        with self.lock, suppress(ValueError):
            self.readers.remove(reader)
        reader.connection.close()


class Inlet:
    """A topic that we read.

    Args:
        topic: Its name.
        arrived: Called with each message.
        caller: As which node.

    Attributes:
        sources: Connections by the publisher's address.
        failures: Why publishers could not be read, the last ones.
    """

    def __init__(self, topic: str, arrived: Callable[[bytes], None], caller: str) -> None:
        self.topic, self._arrived, self._caller = topic, arrived, caller
        self.sources: dict[str, Source] = {}
        self.failures: list[str] = []
        self._lock = threading.Lock()

    def connect(self, uris: Sequence[str]) -> None:
        """Read from these publishers, and from no others."""
        with self._lock:
            for uri in [uri for uri in self.sources if uri not in uris]:
                self.sources.pop(uri).close()
            for uri in uris:
                if uri not in self.sources:
                    try:
                        source = Source(uri, uri, self.topic, self._caller)
                    except MavfiError as error:
                        self.failures.append(str(error))
                        continue
                    self.sources[uri] = source
                    threading.Thread(target=self._read, args=(uri, source), daemon=True).start()

    def _read(self, uri: str, source: Source) -> None:
        for message in source.messages():
            self._arrived(message)
        with self._lock:
            if self.sources.get(uri) is source:
                del self.sources[uri]


class Station:
    """A participant of the graph.

    Args:
        master: The graph.
        name: As which node.
    """

    def __init__(self, master: Master, name: str) -> None:
        self.master, self.name = master, name
        self._outlets: dict[str, Outlet] = {}
        self._inlets: dict[str, Inlet] = {}
        self._listener = socket.create_server((LOOPBACK, 0))
        self._server = _Server((LOOPBACK, 0), logRequests=False, allow_none=True)
        self.uri = f"http://{LOOPBACK}:{self._server.server_address[1]}/"
        for method in _METHODS:
            self._server.register_function(getattr(self, f"_{method}"), method)
        for work in (self._serve, self._accept):
            threading.Thread(target=work, daemon=True).start()

    def _serve(self) -> None:
        self._server.serve_forever(0.05)

    def close(self) -> None:
        """Stop listening, and close every connection."""
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
        """Offer a topic to nodes that are told of us; the master is not.

        Args:
            topic: Its name.
            header: Type, md5sum, message_definition and latching.
            active: Whether readers are sent messages from the beginning.
        """
        kept = {name: header[name] for name in ("type", "md5sum", "message_definition", "latching") if name in header}
        self._outlets[topic] = Outlet(topic, {"callerid": self.name, **kept}, active)
        return self._outlets[topic]

    def advertise(self, topic: str, header: Mapping[str, str]) -> Outlet:
        """Offer a topic to everybody."""
        outlet = self.offer(topic, header)
        self.master.call("registerPublisher", topic, header["type"], self.uri, caller=self.name)
        return outlet

    def subscribe(self, topic: str, arrived: Callable[[bytes], None]) -> "Inlet":
        """Read a topic like any other node: the master tells us who publishes it.

        Args:
            topic: Its name.
            arrived: Called with each message, in the thread of its publisher.
        """
        self._inlets[topic] = Inlet(topic, arrived, self.name)
        publishers = self.master.call("registerSubscriber", topic, "*", self.uri, caller=self.name)
        self._inlets[topic].connect(publishers)
        return self._inlets[topic]

    # ---- readers ----------------------------------------------------------------------------------------------------
    def _accept(self) -> None:
        while True:
            try:
                connection, _ = self._listener.accept()
            except OSError:
                return
            threading.Thread(target=self._greet, args=(connection,), daemon=True).start()

    def _greet(self, connection: socket.socket) -> None:
        """Answer the header of a reader, and wait until it goes."""
        stream = connection.makefile("rb")
        try:
            told = decode_header(read_frame(stream, LARGEST_HEADER))
            outlet = self._outlets.get(told.get("topic", ""))
            refusal = "no such topic here" if outlet is None else _mismatch(told, outlet.header)
            if outlet is None or refusal:
                connection.sendall(encode_header({"error": refusal}))
                return
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, _timeval(_SEND_PATIENCE_S))
            connection.sendall(encode_header(outlet.header))
            reader = Reader(told.get("callerid", ""), connection, outlet.active)
            outlet.join(reader)
            try:
                while connection.recv(4096):  # readers say nothing more
                    pass
            finally:
                outlet.leave(reader)
        except (OSError, EOFError):
            return
        finally:
            stream.close()
            connection.close()

    # ---- the interface of a node ------------------------------------------------------------------------------------
    def _getPid(self, caller: str) -> list[Any]:  # noqa: N802 - names of ROS
        return [1, "", os.getpid()]

    def _getMasterUri(self, caller: str) -> list[Any]:  # noqa: N802
        return [1, "", self.master.uri]

    def _getBusStats(self, caller: str) -> list[Any]:  # noqa: N802
        return [1, "", [[], [], []]]

    def _getBusInfo(self, caller: str) -> list[Any]:  # noqa: N802
        rows = [
            [number, reader.node, "o", "TCPROS", topic, True, "TCPROS connection"]
            for topic, outlet in self._outlets.items()
            for number, reader in enumerate(list(outlet.readers))
        ]
        rows += [
            [number, uri, "i", "TCPROS", topic, True, "TCPROS connection"]
            for topic, inlet in self._inlets.items()
            for number, uri in enumerate(list(inlet.sources))
        ]
        return [1, "", rows]

    def _getSubscriptions(self, caller: str) -> list[Any]:  # noqa: N802
        return [1, "", [[topic, "*"] for topic in self._inlets]]

    def _getPublications(self, caller: str) -> list[Any]:  # noqa: N802
        return [1, "", [[topic, outlet.header["type"]] for topic, outlet in self._outlets.items()]]

    def _requestTopic(self, caller: str, topic: str, protocols: list[Any]) -> list[Any]:  # noqa: N802
        if topic not in self._outlets or not any(protocol[:1] == ["TCPROS"] for protocol in protocols):
            return [0, "no such topic here", []]
        return [1, "ready", ["TCPROS", LOOPBACK, self._listener.getsockname()[1]]]

    def _publisherUpdate(self, caller: str, topic: str, uris: list[str]) -> list[Any]:  # noqa: N802
        if topic in self._inlets:
            threading.Thread(target=self._inlets[topic].connect, args=(uris,), daemon=True).start()
        return [1, "", 0]

    def _paramUpdate(self, caller: str, key: str, value: Any) -> list[Any]:  # noqa: N802
        return [1, "", 0]

    def _shutdown(self, caller: str, reason: str = "") -> list[Any]:
        return [0, "is ended by its user alone", 0]


_METHODS = (
    "getPid", "getMasterUri", "getBusStats", "getBusInfo", "getSubscriptions", "getPublications", "requestTopic",
    "publisherUpdate", "paramUpdate", "shutdown",
)  # fmt: skip


def _mismatch(told: Mapping[str, str], header: Mapping[str, str]) -> str:
    """Why a reader's idea of the type does not fit; "" if it does."""
    wanted = told.get("md5sum", "*")
    if wanted in ("*", header["md5sum"]) or header["md5sum"] == "*":
        return ""
    return f"md5sum of {told.get('type')} is {wanted}, not {header['md5sum']}"


def _timeval(seconds: float) -> bytes:
    return struct.pack("ll", int(seconds), int(1e6 * (seconds % 1)))
