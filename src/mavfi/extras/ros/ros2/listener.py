"""Listens to topics of a ROS 2 graph, to monitor them."""

import time
from collections.abc import Iterator, Sequence

from mavfi.errors import BadInputError, MavfiError
from mavfi.extras.ros.ros2.environment import Installation
from mavfi.extras.ros.ros2.graph import DISCOVERY_S, AgentClient, absolute
from mavfi.extras.ros.ros2.message_types import TypeLibrary
from mavfi.extras.shared.message_definition import Definition

ALARM_TOPIC = "/mavfi/alarm"
"""Where alarms are published, as JSON in the `data` of a std_msgs/String."""
FIRST_PATIENCE_S = 10.0
"""Time limit for the first message of a topic (s), which determines the available fields."""
_ALARM_TYPE = "std_msgs/msg/String"
_READERS_S = 2.0
"""Time limit for readers of alarms to be there before the first alarm (s)."""
_PATIENCE_S = 2 * DISCOVERY_S
"""Time limit for the publisher of a topic to be discovered (s)."""


class GraphListener:
    """Subscribes to topics of a running graph, from `__enter__` to `__exit__`, and publishes alarms in it.

    An agent does so, in a process of the installation.  Messages are converted to the serialization
    of ROS 1, in which numbers are located by `definitions`.

    Attributes:
        topics: The topics, each once.
        definitions: Definition of the messages by topic, from `__enter__` on.
        notices: What could not be read, and why, one line each.
    """

    def __init__(self, installation: Installation, topics: Sequence[str]) -> None:
        self.topics = list(dict.fromkeys(absolute(topic) for topic in topics))
        self.definitions: dict[str, Definition] = {}
        self._agent = AgentClient(installation)
        self.notices = self._agent.notices
        self._types = TypeLibrary(installation.distribution, self._agent.definition)
        self._kinds: dict[str, str] = {}

    def __enter__(self) -> "GraphListener":
        """Subscribe; `BadInputError` if nobody publishes a topic."""
        self._agent.__enter__()
        try:
            for topic in self.topics:
                self._subscribe(topic)
        except MavfiError:
            self._agent.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        """Leave the graph as it was."""
        self._agent.close()

    def _subscribe(self, topic: str) -> None:
        try:
            kind = self._agent.subscribe(topic, limit_s=_PATIENCE_S).kind
        except BadInputError:
            self._agent.snapshot().topic(topic)  # if there is no such topic, raises: names those that there are
            raise
        self._types.require(kind)
        self.definitions[topic] = self._types.definition(kind)
        self._kinds[topic] = kind

    def receive(self, limit_s: float) -> tuple[str, bytes] | None:
        """The next message with its topic, in order of arrival; None if none comes within a limit (s)."""
        message = self._agent.receive(limit_s)
        if message is None:
            return None
        try:
            return message.topic, self._types.to_ros1(self._kinds[message.topic], message.data)
        except MavfiError as error:
            raise MavfiError(f"topic {message.topic}: {error}") from None

    def take(self, seconds: float) -> Iterator[tuple[str, bytes]]:
        """Messages in order of arrival, for a duration (s)."""
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            message = self.receive(left)
            if message is not None:
                yield message

    def first(self) -> dict[str, tuple[Definition, bytes]]:
        """Definition and one message of each topic; `MavfiError` if a topic has no messages."""
        messages: dict[str, tuple[Definition, bytes]] = {}
        for topic, message in self.take(FIRST_PATIENCE_S):
            messages.setdefault(topic, (self.definitions[topic], message))
            if len(messages) == len(self.topics):
                return messages
        silent = [topic for topic in self.topics if topic not in messages]
        raise MavfiError(f"topic {silent[0]}: no message within {FIRST_PATIENCE_S:g} s; nothing can be watched")

    def open_alarms(self) -> None:
        """Become a publisher of `ALARM_TOPIC`."""
        self._agent.advertise(ALARM_TOPIC, _ALARM_TYPE, latched=True, limit_s=_READERS_S)

    def announce(self, text: str) -> None:
        """Publish a text on `ALARM_TOPIC`."""
        self._agent.say(ALARM_TOPIC, text)
