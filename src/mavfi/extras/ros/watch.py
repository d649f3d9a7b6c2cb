"""Monitors numeric fields of any application's topics with GAD or AAD, trained from a recording or the first messages.

The detectors are observers: they withhold no message, and publish their alarms on a topic.
"""

import json
import time
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from mavfi.detectors.detector import Detector
from mavfi.detectors.foreign import foreign_state
from mavfi.errors import BadInputError, MavfiError
from mavfi.extras.logs.circular import Geometry, Numbers, recognise
from mavfi.extras.logs.monitor import fitted
from mavfi.faults.levels.message.definition import Definition
from mavfi.flight.log_readers import Probe, make_probes, open_flight_log
from mavfi.states import State, StateSpec, floats

ALARM_TOPIC = "/mavfi/alarm"
"""Where alarms are published, as JSON in the `data` of a std_msgs/String."""
FIRST_PATIENCE_S = 10.0
"""Time limit for the first message of a topic (s), which determines the available fields."""


class MessageListener(ABC):
    """Subscribes to topics of a running graph, from `__enter__` to `__exit__`, and publishes alarms in it.

    Messages of ROS 2 are converted to the serialization of ROS 1, in which numbers are located by `definitions`.

    Attributes:
        topics: The topics, each once.
        definitions: Definition of the messages by topic, from `__enter__` on.
        notices: What could not be read, and why, one line each.
    """

    topics: Sequence[str]
    definitions: dict[str, Definition]
    notices: list[str]

    @abstractmethod
    def __enter__(self) -> "MessageListener":
        """Subscribe; `BadInputError` if nobody publishes a topic."""

    @abstractmethod
    def __exit__(self, *_: object) -> None:
        """Leave the graph as it was."""

    @abstractmethod
    def receive(self, limit_s: float) -> tuple[str, bytes] | None:
        """The next message with its topic, in order of arrival; None if none comes within a limit (s)."""

    @abstractmethod
    def open_alarms(self) -> None:
        """Become a publisher of `ALARM_TOPIC`."""

    @abstractmethod
    def announce(self, text: str) -> None:
        """Publish a text on `ALARM_TOPIC`."""

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


def make_listener(topics: Sequence[str]) -> MessageListener:
    """The listener for topics of a running graph, see `master_of`.

    Raises:
        BadInputError: There is no ROS, or a topic is unknown.
    """
    from mavfi.extras.ros.node.watch import TopicListener
    from mavfi.extras.ros.ros2.environment import find_installation
    from mavfi.extras.ros.ros2.watch import GraphListener
    from mavfi.extras.ros.survey import master_of

    master = master_of(topics)
    if master is not None:
        return TopicListener(master, topics)
    try:
        return GraphListener(find_installation(), topics)
    except BadInputError as error:
        raise BadInputError(f"no master of ROS 1 answers; {error}") from None


@dataclass(frozen=True, slots=True)
class ForeignAlarm:
    """An alarm on one message.

    Attributes:
        time_s: Wall-clock time (s since 1970).
        message: Sequence number among the checked messages of its topic, from 1.
        score: Anomaly score, relative to the threshold; > 1 is an alarm.
        fields: The anomalous fields; `values`: their values as text.
    """

    time_s: float
    topic: str
    message: int
    detector: str
    score: float
    fields: tuple[str, ...]
    values: tuple[str, ...]

    def to_json(self) -> dict[str, Any]:
        """The alarm as plain data."""
        return asdict(self)


class TopicWatch:
    """Checks messages of an open listener, and publishes alarms on `ALARM_TOPIC`.

    Attributes:
        alarms: All alarms so far.
        judged: Number of checked messages by topic.
        skipped: Number of messages that lack a monitored field, by topic.
    """

    def __init__(self, listener: MessageListener, probes: dict[str, Probe], detector: Detector) -> None:
        self._probes = probes
        self._detector = detector
        self.alarms: list[ForeignAlarm] = []
        self.judged: Counter[str] = Counter()
        self.skipped: Counter[str] = Counter()
        self._detector.start()
        for probe in probes.values():  # compile in advance, as messages would queue up meanwhile
            self._detector.check(foreign_state(probe.spec, [0.0] * len(probe.spec.header)), 0)
        self._listener = listener
        self._listener.open_alarms()

    def judge(self, topic: str, message: bytes) -> ForeignAlarm | None:
        """Check a message; an alarm is published, stored and returned."""
        state = None
        if topic in self._probes:
            state = self._probes[topic].read(message)
        if state is None:
            self.skipped[topic] += 1
            return None
        self.judged[topic] += 1
        now = time.time()
        verdict = self._detector.check(state, int(1e6 * now))
        self._detector.accept(state, int(1e6 * now))
        if verdict is None:
            return None
        fields = tuple(name.removeprefix(f"{topic}.") for name in verdict.fields)
        values = tuple(
            repr(state.header[name][0].item()) for name in fields if name in (state.header.dtype.names or ())
        )
        alarm = ForeignAlarm(now, topic, self.judged[topic], verdict.source, verdict.score, fields, values)
        self.alarms.append(alarm)
        self._listener.announce(json.dumps(alarm.to_json()))
        return alarm


# ---- training --------------------------------------------------------------------------------------------------------
class MonitorTraining(NamedTuple):
    """A detector trained on messages.

    Attributes:
        probes: The monitored fields, by topic.
        detector: Trained on them.
        messages: Number of training messages.
    """

    probes: dict[str, Probe]
    detector: Detector
    messages: int


def train_online(
    listener: MessageListener, detector_and_profile: tuple[str, str], fields: list[str], seconds: float
) -> MonitorTraining:
    """Train a detector on what the topics publish now, for a duration (s)."""
    probes = make_probes(listener.first(), fields)
    return MonitorTraining(probes, *_train(*detector_and_profile, probes, listener.take(seconds)))


def train_on_file(
    source: Path,
    topics: Sequence[str],
    definitions: Mapping[str, Definition],
    detector_and_profile: tuple[str, str],
    fields: list[str],
) -> MonitorTraining:
    """Train a detector on the messages of a recording.

    Raises:
        BadInputError: It cannot be read, lacks a topic, has another type for it, or has an invalid message.
    """
    try:
        reader = open_flight_log(source)
        messages = list(reader.messages(topics))
        for notice in getattr(reader, "notices", ()):
            if any(notice.startswith(f"{topic}: not read") for topic in topics):
                raise BadInputError(notice)
        first = {message.topic: (message.layout, message.data) for message in reversed(messages)}
        for topic, definition in definitions.items():
            if topic in first and definition != first[topic][0]:
                raise BadInputError(f"{topic} has another type there than now ({definition.kind})")
        probes = make_probes(first, fields)
        parts = ((message.topic, message.data) for message in messages)
        return MonitorTraining(probes, *_train(*detector_and_profile, probes, parts))
    except MavfiError as error:
        raise BadInputError(f"{source}: {str(error).removeprefix(f'{source}: ')}") from None


def _train(
    kind: str, profile: str, probes: dict[str, Probe], messages: Iterator[tuple[str, bytes]]
) -> tuple[Detector, int]:
    """Train a detector on normal messages (topic and bytes, in order); also returns their number.

    Raises:
        BadInputError: See `learn`.
    """
    states: list[State] = []
    for topic, message in messages:
        if topic in probes:
            state = probes[topic].read(message)
            if state is not None:
                states.append(state)
    # Angles and quaternions are recognised as in recordings.
    specs = {topic: probe.spec for topic, probe in probes.items()}
    geometries = {topic: _geometry(spec, states) for topic, spec in specs.items()}
    return fitted(kind, profile, [states], specs, geometries), len(states)


def _geometry(spec: StateSpec, states: Sequence[State]) -> Geometry:
    """Angles and quaternions among the fields of a topic."""
    names = [field.name for field in spec.header]
    rows = [floats(state.header, len(names)) for state in states if state.spec is spec]
    return recognise([Numbers(names, np.array(rows).reshape(-1, len(names)))], {})
