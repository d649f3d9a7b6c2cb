"""Listens to topics of a ROS 1 graph, to monitor them."""

import os
import queue
from collections.abc import Sequence
from functools import partial

from mavfi.extras.ros.node.guardian import Guardian, Registration
from mavfi.extras.ros.node.master import Master, absolute
from mavfi.extras.ros.node.message import Composer
from mavfi.extras.ros.node.peer import Peer
from mavfi.extras.ros.node.relay import sources_of
from mavfi.extras.ros.watch import ALARM_TOPIC, MessageListener

_ALARM_TYPE = "std_msgs/String"
_POLL_S = 0.1


class TopicListener(MessageListener):
    """Listens in a graph of ROS 1, as a node.

    Raises:
        BadInputError: A topic is unknown or has no publisher.
    """

    def __init__(self, master: Master, topics: Sequence[str]) -> None:
        graph = master.graph()
        self.topics = list(dict.fromkeys(absolute(topic) for topic in topics))
        self._messages: queue.Queue[tuple[str, bytes]] = queue.Queue()
        self._master = master
        self.definitions = {}
        self.notices = []
        for topic in self.topics:
            sources = sources_of(master, graph, topic)
            self.definitions[topic] = sources[0].definition()
            for source in sources:
                source.close()

    def __enter__(self) -> "TopicListener":
        self._guardian = Guardian(self._master.uri)
        self._peer = Peer(self._master, f"/mavfi_watch_{os.getpid()}")
        for topic in self.topics:
            self._guardian.remember(Registration(topic, self._peer.name, self._peer.uri, "Subscriber"))
            self._peer.subscribe(topic, partial(self._arrived, topic))
        return self

    def __exit__(self, *_: object) -> None:
        self._guardian.undo()
        self._peer.close()

    def _arrived(self, topic: str, message: bytes) -> None:
        self._messages.put((topic, message))

    def receive(self, limit_s: float) -> tuple[str, bytes] | None:
        """See `MessageListener`."""
        try:
            return self._messages.get(timeout=min(limit_s, _POLL_S))
        except queue.Empty:
            return None

    def open_alarms(self) -> None:
        """See `MessageListener`."""
        self._composer = Composer(_ALARM_TYPE)
        self._guardian.remember(Registration(ALARM_TOPIC, self._peer.name, self._peer.uri))
        self._outlet = self._peer.advertise(ALARM_TOPIC, self._composer.header)

    def announce(self, text: str) -> None:
        """See `MessageListener`."""
        self._outlet.send(self._composer.pack({"data": text}))
