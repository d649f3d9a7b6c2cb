"""Listens to topics of a ROS 2 graph, to monitor them."""

from collections.abc import Sequence

from mavfi.errors import BadInputError, MavfiError
from mavfi.extras.ros.ros2.environment import Installation
from mavfi.extras.ros.ros2.graph import DISCOVERY_S, AgentClient, absolute
from mavfi.extras.ros.ros2.message_types import TypeLibrary
from mavfi.extras.ros.watch import ALARM_TOPIC, MessageListener

_ALARM_TYPE = "std_msgs/msg/String"
_READERS_S = 2.0
"""Time limit for readers of alarms to be there before the first alarm (s)."""
_PATIENCE_S = 2 * DISCOVERY_S
"""Time limit for the publisher of a topic to be discovered (s)."""


class GraphListener(MessageListener):
    """Listens in a graph of ROS 2, with an agent."""

    def __init__(self, installation: Installation, topics: Sequence[str]) -> None:
        self.topics = list(dict.fromkeys(absolute(topic) for topic in topics))
        self.definitions = {}
        self._agent = AgentClient(installation)
        self.notices = self._agent.notices
        self._types = TypeLibrary(installation.distribution, self._agent.definition)
        self._kinds: dict[str, str] = {}

    def __enter__(self) -> "GraphListener":
        self._agent.__enter__()
        try:
            for topic in self.topics:
                self._subscribe(topic)
        except MavfiError:
            self._agent.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
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
        """See `MessageListener`."""
        message = self._agent.receive(limit_s)
        if message is None:
            return None
        try:
            return message.topic, self._types.to_ros1(self._kinds[message.topic], message.data)
        except MavfiError as error:
            raise MavfiError(f"topic {message.topic}: {error}") from None

    def open_alarms(self) -> None:
        """See `MessageListener`."""
        self._agent.advertise(ALARM_TOPIC, _ALARM_TYPE, latched=True, limit_s=_READERS_S)

    def announce(self, text: str) -> None:
        """See `MessageListener`."""
        self._agent.say(ALARM_TOPIC, text)
