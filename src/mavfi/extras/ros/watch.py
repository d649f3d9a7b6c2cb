"""Monitors numeric fields of any application's topics with GAD or AAD, trained from a recording or the first messages.

The detectors are observers: they withhold no message, and publish their alarms on a topic.
"""

import json
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mavfi.errors import BadInputError, MavfiError
from mavfi.extras.logs.recording import LogRecording
from mavfi.extras.logs.selection import Wanted, select
from mavfi.extras.logs.watch import LogWatch
from mavfi.extras.ros.ros2.graph import absolute
from mavfi.extras.ros.ros2.listener import GraphListener
from mavfi.extras.shared.foreign import foreign_state
from mavfi.extras.shared.log_readers import LoggedMessage, open_flight_log
from mavfi.extras.shared.message_definition import Definition


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

    def __init__(self, listener: GraphListener, trained: LogWatch) -> None:
        self._trained = trained
        self.alarms: list[ForeignAlarm] = []
        self.judged: Counter[str] = Counter()
        self.skipped: Counter[str] = Counter()
        for monitored in trained.selection.topics.values():  # compile in advance: messages would queue up meanwhile
            for _ in range(2):
                trained.detector.step(foreign_state(monitored.spec, np.zeros(len(monitored.names))), 0)
        trained.detector.start()
        self._listener = listener
        self._listener.open_alarms()

    def judge(self, topic: str, message: bytes) -> ForeignAlarm | None:
        """Check a message; an alarm is published, stored and returned."""
        state = self._trained.read(topic, self._listener.definitions[topic], message)
        if state is None:
            self.skipped[topic] += 1
            return None
        self.judged[topic] += 1
        now = time.time()
        verdict = self._trained.detector.step(state, int(1e6 * now))
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
def train_online(
    listener: GraphListener, detector_and_profile: tuple[str, str], fields: Sequence[str], seconds: float
) -> LogWatch:
    """Train a detector on what the topics publish now, for a duration (s)."""
    listener.first()
    messages = []
    for topic, data in listener.take(seconds):
        messages.append(LoggedMessage(topic, int(1e6 * time.time()), listener.definitions[topic], data))
    return _train("online", messages, detector_and_profile, fields)


def train_on_file(
    source: Path,
    topics: Sequence[str],
    definitions: Mapping[str, Definition],
    detector_and_profile: tuple[str, str],
    fields: Sequence[str],
) -> LogWatch:
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
        for message in messages:
            if message.topic in definitions and definitions[message.topic] != message.layout:
                raise BadInputError(f"{message.topic} has another type there than now ({message.layout.kind})")
        return _train(str(source), messages, detector_and_profile, fields)
    except MavfiError as error:
        raise BadInputError(f"{source}: {str(error).removeprefix(f'{source}: ')}") from None


def _train(
    name: str, messages: list[LoggedMessage], detector_and_profile: tuple[str, str], fields: Sequence[str]
) -> LogWatch:
    """Train a detector on normal messages in their order, as on a recorded flight."""
    recording = LogRecording(name, messages)
    wanted = []
    for field in fields:
        topic, colon, path = field.rpartition(":")
        if colon:
            topic = absolute(topic)
        wanted.append(f"{topic}{colon}{path}")
    return LogWatch(*detector_and_profile, select([recording], wanted=Wanted(wanted)), [recording])
