"""Relay between the publishers of a running topic and its subscribers.

Every subscriber is notified, as by the master, that mavfi is the only publisher; its original publishers are restored
at the end.  Messages pass as bytes; only messages to be modified are decoded.
"""

import os
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress

from mavfi.errors import BadInputError, MavfiError, allowed
from mavfi.extras.ros.node.guardian import Guardian, RedirectedSubscriber
from mavfi.extras.ros.node.master import MASTER_CALLER, Master, RosGraph, call, check_known
from mavfi.extras.ros.node.peer import Peer, Reader, TopicSource
from mavfi.faults.levels.message.definition import Definition

TURN_PATIENCE_S = 2.0
_WATCH_S = 0.1
_LOOK_EVERY = 10
"""Watch rounds between two queries of the graph."""
_POLL_S = 0.001
Change = Callable[[bytes, "Relay"], bytes]
"""Sends what replaces a message through the relay, and returns what was sent now."""


def sources_of(master: Master, graph: RosGraph, topic: str, skipped: Sequence[str] = ()) -> list[TopicSource]:
    """Connect to every live publisher of a topic.

    Raises:
        BadInputError: The topic is unknown or has no publisher.
    """
    topic = check_known("topic", topic, graph.topics)
    sources = []
    failures = []
    for node in graph.publishers.get(topic, ()):
        if node not in skipped:
            try:
                sources.append(TopicSource(node, master.node_uri(node), topic))
            except BadInputError:
                raise
            except MavfiError as error:
                failures.append(str(error))
    if not sources:
        reason = ""
        if failures:
            reason = f": {failures[0]}"
        raise BadInputError(f"topic {topic}: nobody publishes it{reason}; start its publisher first")
    return sources


class Relay:
    """Relays the messages of a topic from `__enter__` to `__exit__`.

    Args:
        master: The master of the graph.
        topic: The topic.
        change: Called with each message; sends its replacement.
        accepts: Validates the message definition, and raises if it is unsuitable.
        reader: Only this subscriber is redirected; None = all.

    Attributes:
        passed: Number of messages passed to subscribers.
        failures: Why subscribers could not be redirected.
        error: Exception while relaying.

    Raises:
        BadInputError: Topic or subscriber is unknown; there is no publisher or subscriber.
    """

    def __init__(
        self,
        master: Master,
        topic: str,
        change: Change,
        accepts: Callable[[Definition], object],
        reader: str | None = None,
    ) -> None:
        self.master = master
        self._change = change
        graph = master.graph()
        self.topic = check_known("topic", topic, graph.topics)
        self._only_reader = None
        if reader is not None:
            self._only_reader = check_known("node", reader, graph.nodes)
        self._check(graph)
        self._sources = sources_of(master, graph, self.topic)
        self.definition: Definition = self._sources[0].definition()
        try:
            accepts(self.definition)
        except BaseException:
            self._close_sources()
            raise
        self._lock = threading.Lock()
        self._end = threading.Event()
        self._all_redirected = False
        self.passed = 0
        self.failures: list[str] = []
        self.error: Exception | None = None

    def _check(self, graph: RosGraph) -> None:
        readers = graph.subscribers.get(self.topic, [])
        if self._only_reader is not None and self._only_reader not in readers:
            raise BadInputError(f"node {self._only_reader}: does not read {self.topic}; allowed: {allowed(readers)}")
        if not readers:
            raise BadInputError(f"topic {self.topic}: nobody reads it, so a change would have no effect")

    def __enter__(self) -> "Relay":
        self._guardian = Guardian(self.master.uri)
        self._peer = Peer(self.master, f"/mavfi_{os.getpid()}")
        try:
            self._begin()
        except BaseException:
            self.__exit__()
            raise
        return self

    def _begin(self) -> None:
        self._outlet = self._peer.offer(self.topic, self._sources[0].header, active=False)
        latched = self._sources[0].is_latched
        if not latched:
            self._pump(self._sources)
        self._turn_all(self.master.graph())
        self._all_redirected = True
        if latched:  # the only message must not be relayed before there are subscribers
            self._pump(self._sources)
        threading.Thread(target=self._watch, daemon=True).start()

    def __exit__(self, *_: object) -> None:
        self._end.set()
        with self._lock:  # no subscriber is redirected after this point
            self._guardian.undo()
        self._close_sources()
        self._peer.close()

    def _close_sources(self) -> None:
        for source in self._sources:
            source.close()

    # ---- messages ---------------------------------------------------------------------------------------------------
    def _pump(self, sources: Sequence[TopicSource]) -> None:
        for source in sources:
            threading.Thread(target=self._pass_on, args=(source,), daemon=True).start()

    def _pass_on(self, source: TopicSource) -> None:
        try:
            for message in source.messages():
                if not self._all_redirected:  # not all subscribers are redirected yet
                    self.send(message)
                elif any(reader.active for reader in self._outlet.readers):
                    self.passed += 1
                    self._change(message, self)
        except Exception as error:  # noqa: BLE001 - any cause: reported to the caller
            self.error = error

    def send(self, message: bytes) -> int:
        """Send a message to the subscribers; returns their number."""
        return self._outlet.send(message)

    # ---- subscribers ------------------------------------------------------------------------------------------------
    def _turn_all(self, graph: RosGraph) -> None:
        """Redirect the remaining subscribers; `MavfiError` if none is redirected in the end."""
        readers = graph.subscribers.get(self.topic, [])
        if self._only_reader:
            readers = [self._only_reader]
        failures: list[str] = []
        for node in readers:
            reader = self._outlet.reader(node)
            if reader is None or not reader.active:
                try:
                    self._turn(node, graph)
                except MavfiError as error:
                    failures.append(str(error))
        self.failures = failures
        if failures and not any(reader.active for reader in self._outlet.readers):
            raise MavfiError(failures[0])

    def _turn(self, node: str, graph: RosGraph) -> None:
        """Connect a subscriber to mavfi in addition to its publishers, then remove those: no message is lost."""
        uri = self.master.node_uri(node)
        publishers = []
        for name in graph.publishers.get(self.topic, ()):
            with suppress(MavfiError):
                publishers.append(self.master.node_uri(name))
        with self._lock:
            if self._end.is_set():
                return
            self._guardian.remember(RedirectedSubscriber(self.topic, node, uri, tuple(publishers)))
            call(uri, "publisherUpdate", MASTER_CALLER, self.topic, [*publishers, self._peer.uri])
            reader = self._wait_for(node)
            call(uri, "publisherUpdate", MASTER_CALLER, self.topic, [self._peer.uri])
            reader.active = True

    def _wait_for(self, node: str) -> Reader:
        end = time.monotonic() + TURN_PATIENCE_S
        while time.monotonic() < end:
            reader = self._outlet.reader(node)
            if reader is not None:
                return reader
            time.sleep(_POLL_S)
        raise MavfiError(f"node {node}: does not connect to mavfi within {TURN_PATIENCE_S:g} s; is it on this machine?")

    def _watch(self) -> None:
        """Redirect again subscribers that the master has notified of new publishers."""
        rounds = 0
        while not self._end.wait(_WATCH_S):
            rounds += 1
            with suppress(MavfiError):
                if rounds % _LOOK_EVERY == 0 or not self._outlet.readers:
                    graph = self.master.graph()
                    self._read_new(graph)
                    self._turn_all(graph)

    def _read_new(self, graph: RosGraph) -> None:
        """Connect to publishers that have joined."""
        connected = {source.uri for source in self._sources}
        for node in graph.publishers.get(self.topic, ()):
            uri = self.master.node_uri(node)
            if uri not in connected and node != self._peer.name:
                source = TopicSource(node, uri, self.topic)
                self._sources.append(source)
                self._pump([source])
