"""Monitors numeric fields of any application's topics with GAD or AAD, trained from a bag or the first messages.

The detectors are observers: they withhold no message, and publish their alarms on a topic.
"""

import json
import os
import queue
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

from mavfi.detectors.detector import Detector
from mavfi.detectors.foreign import foreign_state, learn
from mavfi.errors import MavfiError
from mavfi.extras.ros.node.guardian import Guardian, Registration
from mavfi.extras.ros.node.master import Master, absolute
from mavfi.extras.ros.node.message import Composer
from mavfi.extras.ros.node.peer import Outlet, Peer
from mavfi.extras.ros.node.relay import sources_of
from mavfi.faults.levels.message.definition import Definition
from mavfi.flight.log_readers import Probe

ALARM_TOPIC = "/mavfi/alarm"
ALARM_TYPE = "std_msgs/String"
FIRST_PATIENCE_S = 10.0
"""Time limit for the first message of a topic (s), which determines the available fields."""
_POLL_S = 0.1


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


class TopicListener:
    """Subscribes to topics of a running graph, as a node, from `__enter__` to `__exit__`; collects one queue.

    Raises:
        BadInputError: A topic is unknown or has no publisher.
    """

    def __init__(self, master: Master, topics: Sequence[str]) -> None:
        graph = master.graph()
        self.topics = list(dict.fromkeys(absolute(topic) for topic in topics))
        self._messages: queue.Queue[tuple[str, bytes]] = queue.Queue()
        self._master = master
        self.definitions: dict[str, Definition] = {}
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

    def speak(self, topic: str, kind: str) -> tuple[Outlet, Composer]:
        """Publish on a topic until `__exit__`."""
        composer = Composer(kind)
        self._guardian.remember(Registration(topic, self._peer.name, self._peer.uri))
        return self._peer.advertise(topic, composer.header), composer

    def take(self, seconds: float) -> Iterator[tuple[str, bytes]]:
        """Messages in order of arrival, for a duration (s)."""
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            try:
                yield self._messages.get(timeout=min(left, _POLL_S))
            except queue.Empty:
                continue

    def first(self) -> dict[str, tuple[Definition, bytes]]:
        """Definition and one message of each topic; `MavfiError` if a topic has no messages."""
        messages: dict[str, tuple[Definition, bytes]] = {}
        for topic, message in self.take(FIRST_PATIENCE_S):
            messages.setdefault(topic, (self.definitions[topic], message))
            if len(messages) == len(self.topics):
                return messages
        silent = [topic for topic in self.topics if topic not in messages]
        raise MavfiError(f"topic {silent[0]}: no message within {FIRST_PATIENCE_S:g} s; nothing can be watched")


class TopicWatch:
    """Checks messages of an open listener, and publishes alarms on a topic, as JSON in a `std_msgs/String`.

    Attributes:
        alarms: All alarms so far.
        judged: Number of checked messages by topic.
        skipped: Number of messages that lack a monitored field, by topic.
    """

    def __init__(self, listener: TopicListener, probes: dict[str, Probe], detector: Detector) -> None:
        self._probes = probes
        self._detector = detector
        self.alarms: list[ForeignAlarm] = []
        self.judged: Counter[str] = Counter()
        self.skipped: Counter[str] = Counter()
        self._detector.start()
        for probe in probes.values():  # compile in advance, as messages would queue up meanwhile
            self._detector.check(foreign_state(probe.spec, [0.0] * len(probe.spec.header)), 0)
        self._outlet, self._composer = listener.speak(ALARM_TOPIC, ALARM_TYPE)

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
        self._outlet.send(self._composer.pack({"data": json.dumps(alarm.to_json())}))
        return alarm


def train(
    kind: str, profile: str, probes: dict[str, Probe], messages: Iterator[tuple[str, bytes]]
) -> tuple[Detector, int]:
    """Train a detector on normal messages (topic and bytes, in order); also returns their number.

    Raises:
        BadInputError: See `learn`.
    """
    states = []
    for topic, message in messages:
        if topic in probes:
            state = probes[topic].read(message)
            if state is not None:
                states.append(state)
    return learn(kind, profile, [states], {topic: probe.spec for topic, probe in probes.items()}), len(states)
