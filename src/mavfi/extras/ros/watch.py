"""Monitors numeric fields of any application's topics with GAD or AAD, trained from a recording or the first messages.

The detectors are observers: they withhold no message, and publish their alarms on a topic.
"""

import json
import time
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
from mavfi.extras.ros.ros2.listener import GraphListener
from mavfi.faults.levels.message.definition import Definition
from mavfi.flight.log_readers import Probe, make_probes, open_flight_log
from mavfi.states import State, StateSpec, floats


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

    def __init__(self, listener: GraphListener, probes: dict[str, Probe], detector: Detector) -> None:
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
    listener: GraphListener, detector_and_profile: tuple[str, str], fields: list[str], seconds: float
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
