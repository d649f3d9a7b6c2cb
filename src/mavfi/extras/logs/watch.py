"""Detectors on recorded flights: trained on some, applied to others, with injected flips and known faults."""

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import numpy as np

from mavfi.analysis.statistics import EventRate, Rate, event_rate, wilson
from mavfi.extras.logs.detectors import log_detector
from mavfi.extras.logs.recording import LogRecording, Silence, exposure_s, longest_gap_us, silences
from mavfi.extras.logs.selection import LogSelection, NotMonitored
from mavfi.extras.shared.foreign import NOT_FINITE_RULE, foreign_state
from mavfi.extras.shared.log_readers import Layout, LoggedMessage
from mavfi.extras.shared.message_definition import AbsentError, Leaf, flip_bit
from mavfi.faults.strata import bits_of
from mavfi.states import Field, State

_EVENT_GAP_US = 1_000_000
"""Alarms that follow each other within this time are one event (us), in logs of more than 1 Hz."""
BIT_CLASSES = ("sign", "exponent", "mantissa")
_MAX_NAMED = 4
"""Most fields that a cause of an event names in a line."""
_MAX_CAUSES = 3
"""Most causes that an event names in a line."""
_FLOATS = {"float32": "f4", "float64": "f8"}
_INJECTION_STREAM = 1


# ---- judging -------------------------------------------------------------------------------------------------------
Sample = tuple[LoggedMessage, State]
"""A message, and its monitored fields."""


@dataclass(frozen=True)
class LogAlarm:
    """An alarm on one message of a recording; its attributes are keys of the JSON output.

    Attributes:
        place: Index of the message among the judged ones.
        time_us: Its time (us).
        topic: Its topic.
        score: Relative to the threshold.
        fields: The fields that raised the alarm.
        source: The detector or rule that raised it.
    """

    place: int
    time_us: int
    topic: str
    score: float
    fields: tuple[str, ...]
    source: str = ""


class LogEvent(NamedTuple):
    """Alarms that follow each other.

    Attributes:
        begin_us: Time of the first (us).
        end_us: Time of the last (us).
        alarms: Their number.
        topics: Their topics, those with most alarms first.
        fields: The fields that raised them, in the same order.
        sources: Their detectors and rules.
        score: The largest score.
        causes: What raised them, in order of time: one line for each topic and kind of alarm.
    """

    begin_us: int
    end_us: int
    alarms: int
    topics: tuple[str, ...]
    fields: tuple[str, ...]
    sources: tuple[str, ...]
    score: float
    causes: tuple[str, ...]

    def text(self) -> str:
        """When, which fields, and why."""
        when = f"{1e-6 * self.begin_us:.3f} s"
        if self.alarms > 1:
            when = f"{1e-6 * self.begin_us:.3f} to {1e-6 * self.end_us:.3f} s"
        causes = "; ".join(self.causes[:_MAX_CAUSES])
        if len(self.causes) > _MAX_CAUSES:
            causes += f"; {len(self.causes) - _MAX_CAUSES} more causes"
        return f"{when}: {causes}"


@dataclass(frozen=True)
class Flip:
    """An injected flip; its attributes are keys of the JSON output.

    Attributes:
        topic: Topic of the message.
        field: The changed number.
        bit: The flipped bit.
        bit_class: Its class, as in `BIT_CLASSES`.
        detected: Whether there was an alarm on the message, or on the next one of its topic.
    """

    topic: str
    field: str
    bit: int
    bit_class: str
    detected: bool


@dataclass(frozen=True)
class JudgedLog:
    """What a detector found in one recording.

    Attributes:
        name: File name.
        exposure_s: Duration of the normal part, without gaps (s).
        messages: Number of messages judged in it.
        alarms: Alarms in it.
        flips: Flips injected into it.
        fault_delay_s: Time from the start of the known fault to the first alarm (s); None = no alarm.
        has_fault: Whether a fault is known.
        after_fault_s: Duration of the part with the known fault (s).
        cut: Whether the file ends within a message.
        event_gap_us: Alarms that follow each other within this time are one event (us).
        not_monitored: Numbers that are not monitored in this recording, with the reason.
        fault_alarm: The first alarm after the start of the known fault; None = there is none.
        silences: Where topics fall silent.
    """

    name: str
    exposure_s: float
    messages: int
    alarms: list[LogAlarm]
    flips: list[Flip]
    has_fault: bool = False
    fault_delay_s: float | None = None
    after_fault_s: float = 0.0
    cut: bool = False
    event_gap_us: int = _EVENT_GAP_US
    not_monitored: Sequence[NotMonitored] = ()
    fault_alarm: LogAlarm | None = None
    silences: Sequence[Silence] = ()

    @property
    def events(self) -> int:
        """Alarms, with those within `event_gap_us` of each other counted as one."""
        return len(self.event_list)

    @property
    def event_list(self) -> list[LogEvent]:
        """The same, one by one."""
        groups: list[list[LogAlarm]] = []
        for alarm in self.alarms:
            if groups and alarm.time_us - groups[-1][-1].time_us <= self.event_gap_us:
                groups[-1].append(alarm)
            else:
                groups.append([alarm])
        return [_event_of(group) for group in groups]


def _event_of(alarms: Sequence[LogAlarm]) -> LogEvent:
    """Alarms as one event."""
    by_cause: dict[tuple[str, bool], list[LogAlarm]] = {}
    for alarm in alarms:
        by_cause.setdefault((alarm.topic, alarm.source == NOT_FINITE_RULE), []).append(alarm)
    causes = tuple(_cause_text(group, alarms[0].time_us) for group in by_cause.values())
    return LogEvent(
        alarms[0].time_us,
        alarms[-1].time_us,
        len(alarms),
        _by_frequency(alarm.topic for alarm in alarms),
        _by_frequency(name for alarm in alarms for name in alarm.fields),
        _by_frequency(alarm.source for alarm in alarms),
        max(alarm.score for alarm in alarms),
        causes,
    )


def _by_frequency(names: Iterable[str]) -> tuple[str, ...]:
    """Different names, the most frequent ones first."""
    return tuple(name for name, _ in Counter(names).most_common())


def _cause_text(alarms: Sequence[LogAlarm], event_begin_us: int) -> str:
    """Fields and cause of alarms of one topic and kind, and when they began if this is later than their event."""
    names = _by_frequency(name for alarm in alarms for name in alarm.fields)
    fields = ", ".join(names[:_MAX_NAMED])
    if len(names) > _MAX_NAMED:
        fields += f" and {len(names) - _MAX_NAMED} more"
    cause = _by_frequency(alarm.source for alarm in alarms)[0]
    if cause != NOT_FINITE_RULE:
        cause += f", score {max(alarm.score for alarm in alarms):.3g}"
    if len(alarms) > 1:
        cause += f", {len(alarms)} messages"
    if alarms[0].time_us > event_begin_us:
        cause += f" from {1e-6 * alarms[0].time_us:.3f} s"
    return f"{alarms[0].topic} {fields}: {cause}"


class LogWatch:
    """A detector trained on recordings.

    Args:
        kind: Name of a detector, or "package:Class".
        profile: "paper" or "tuned".
        selection: What is monitored.
        training: Recordings of normal flights.
        seed: Seed of the detector's random draws.

    Raises:
        BadInputError: See `log_detector`.
    """

    def __init__(
        self, kind: str, profile: str, selection: LogSelection, training: Sequence[LogRecording], seed: int = 0
    ) -> None:
        self.selection = selection
        self._training = training
        flights = [[(message.time_us, state) for message, state in self._states(recording)] for recording in training]
        self.detector = log_detector(kind, profile, selection, selection.mapping, flights, seed)
        self.trained_on = sum(map(len, flights))

    def _states(self, recording: LogRecording) -> list[Sample]:
        """The messages of a recording with monitored fields.

        Fields that are not finite at the beginning of the training have their first finite value before it.
        """
        samples = []
        for message in recording.messages:
            state = self.read(message.topic, message.layout, message.data)
            if state is not None:
                samples.append((message, state))
        for topic, names in self.selection.late.items():
            headers = [state.header for message, state in samples if message.topic == topic]
            for name in names:
                _fill_beginning([header[name] for header in headers])
        return samples

    def read(self, topic: str, layout: Layout, data: bytes) -> State | None:
        """The monitored fields of a message; None if it lacks one, or nothing of its topic is monitored."""
        monitored = self.selection.topics.get(topic)
        if monitored is None:
            return None
        try:
            leaves = [layout.locate(data, name) for name in monitored.names]
        except AbsentError:
            return None
        return foreign_state(monitored.spec, [float(leaf.value(data)) for leaf in leaves])

    def judge(self, recording: LogRecording, flips: int = 0, seed: int = 0) -> JudgedLog:
        """Judge a recording.

        Args:
            recording: The recording; what follows its known fault is judged apart.
            flips: Number of bits to flip in floating-point fields of its normal part, each alone and undone
                afterwards, as many in each of `BIT_CLASSES`.
            seed: Draws messages, fields and bits.
        """
        samples = self._states(recording)
        alarms = list(self._run(samples))
        # The normal part, and what follows the known fault.
        onset_us = math.inf
        if recording.onset_us is not None:
            onset_us = recording.onset_us
        normal = [sample for sample in samples if sample[0].time_us < onset_us]
        faulty = samples[len(normal) :]
        false_alarms = [alarm for alarm in alarms if alarm.time_us < onset_us]
        fault_alarm = next((alarm for alarm in alarms if alarm.time_us >= onset_us), None)
        fault_delay_s = None
        if fault_alarm is not None:
            fault_delay_s = 1e-6 * (fault_alarm.time_us - onset_us)
        injected = self._inject(normal, {alarm.place for alarm in false_alarms}, flips, seed)
        gap_us = longest_gap_us([message.time_us for message, _ in samples])
        return JudgedLog(
            recording.name,
            exposure_s([message.time_us for message, _ in normal], gap_us),
            len(normal),
            false_alarms,
            list(injected),
            has_fault=recording.onset_us is not None,
            fault_delay_s=fault_delay_s,
            after_fault_s=exposure_s([message.time_us for message, _ in faulty], gap_us),
            cut=recording.cut,
            event_gap_us=gap_us,
            not_monitored=self._silent(recording, samples),
            fault_alarm=fault_alarm,
            silences=silences(recording, self._training),
        )

    def _silent(self, recording: LogRecording, samples: Sequence[Sample]) -> list[NotMonitored]:
        """Monitored topics of which a recording has no message, or messages without a monitored field."""
        counts = Counter(message.topic for message in recording.messages)
        judged = Counter(message.topic for message, _ in samples)
        silent = []
        for topic in self.selection.topics:
            if not counts[topic]:
                silent.append(NotMonitored(topic, "", f"silent in {recording.name}"))
            elif judged[topic] < counts[topic]:
                lacking = counts[topic] - judged[topic]
                silent.append(NotMonitored(topic, "", f"fields absent in {lacking} messages of {recording.name}"))
        return silent

    def _run(self, samples: Sequence[Sample]) -> Iterator[LogAlarm]:
        """The alarms of a flight."""
        self.detector.start()
        for index, (message, state) in enumerate(samples):
            alarm = self.detector.step(state, message.time_us)
            if alarm is not None:
                topic, fields = self._names(message.topic, alarm.fields)
                yield LogAlarm(index, message.time_us, topic, alarm.score, fields, alarm.source)

    def _names(self, topic: str, names: Sequence[str]) -> tuple[str, tuple[str, ...]]:
        """Topic and names of the fields that an alarm names: "topic.field", or "topic:field" if they are mapped."""
        for owner in self.selection.topics:
            fields = tuple(name.removeprefix(f"{owner}:") for name in names if name.startswith(f"{owner}:"))
            if fields:
                return owner, fields
        return topic, tuple(name.removeprefix(f"{topic}.") for name in names)

    def _inject(self, samples: Sequence[Sample], alarmed: set[int], count: int, seed: int) -> Iterator[Flip]:
        """Flips in order of time; messages that raise an alarm without it, or before such a one, are not drawn."""
        usable = []
        for index, follower in enumerate(_next_of_topic(samples)):
            message, state = samples[index]
            if follower is None or alarmed & {index, follower} or not self._floats(message):
                continue
            # a message before the first finite value of a field is not judged as it is
            original = self.read(message.topic, message.layout, message.data)
            if original is not None and original.header.tobytes() == state.header.tobytes():
                usable.append((index, follower))
        if not usable or not count:
            return
        random = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_INJECTION_STREAM,)))
        drawn = sorted((*usable[int(random.integers(len(usable)))], number) for number in range(count))
        # One pass over the flight: each flip is undone before the next message is judged.
        self.detector.start()
        position = 0
        for index, follower, number in drawn:
            for message, state in samples[position:index]:
                self.detector.step(state, message.time_us)
            position = max(position, index)
            yield self._flip(samples[index : follower + 1], BIT_CLASSES[number % len(BIT_CLASSES)], random)

    def _floats(self, message: LoggedMessage) -> list[tuple[str, str]]:
        """Monitored floating-point fields of a message, each with its kind."""
        kinds = [(name, message.layout.check(name)) for name in self.selection.topics[message.topic].names]
        return [(name, kind) for name, kind in kinds if kind in _FLOATS]

    def _flip(self, samples: Sequence[Sample], bit_class: str, random: np.random.Generator) -> Flip:
        """Flip a bit of the first message, and judge until the next one of its topic; the detector forgets it."""
        # Draw a number and its bit.
        message = samples[0][0]
        floats = self._floats(message)
        name, kind = floats[int(random.integers(len(floats)))]
        bits = bits_of(Field(name, _FLOATS[kind], "-"), bit_class)
        bit = int(random.integers(bits.start, bits.stop))
        leaf = Leaf(message.layout.locate(message.data, name).offset, kind)
        changed = self.read(message.topic, message.layout, flip_bit(message.data, leaf, bit))
        assert changed is not None  # it has the numbers of the original
        # Judge, and restore the detector.
        memory = self.detector.memory()
        detected = self.detector.step(changed, message.time_us) is not None
        for later, state in samples[1:]:
            alarm = self.detector.step(state, later.time_us)
            if alarm is not None and later.topic == message.topic:
                detected = True
        self.detector.restore(memory)
        return Flip(message.topic, name, bit, bit_class, detected)


def _fill_beginning(values: Sequence[np.ndarray]) -> None:
    """Set the values of a field before its first finite value to this value, in place; each has the shape (1,)."""
    first = next((value for value in values if np.isfinite(value[0])), None)
    if first is None:
        return  # each message is an alarm
    for value in values:
        if value is first:
            break
        value[:] = first


def _next_of_topic(samples: Sequence[Sample]) -> list[int | None]:
    """Index of the next message of the same topic, for each message."""
    following: list[int | None] = [None] * len(samples)
    latest: dict[str, int] = {}
    for index, (message, _) in enumerate(samples):
        if message.topic in latest:
            following[latest[message.topic]] = index
        latest[message.topic] = index
    return following


# ---- rates -----------------------------------------------------------------------------------------------------------

_MINUTE_S = 60.0
_ENOUGH = 5
"""Flips after which a field without any detection is called blind."""
_HOUR_S = 3600.0


@dataclass(frozen=True)
class LogRates:
    """Rates over several recordings."""

    recordings: Sequence[JudgedLog]

    @property
    def exposure_s(self) -> float:
        """Normal flight judged (s)."""
        return sum(judged.exposure_s for judged in self.recordings)

    @property
    def alarms(self) -> EventRate:
        """Alarm events per hour of normal flight, with the exact interval of Poisson counts."""
        return event_rate(sum(judged.events for judged in self.recordings), self.exposure_s / _HOUR_S)

    @property
    def flips(self) -> Mapping[str, Rate]:
        """Share of detected flips by class of the bit."""
        return _rates(flip for judged in self.recordings for flip in judged.flips)

    @property
    def flips_by_field(self) -> dict[str, dict[str, Rate]]:
        """Share of detected flips by field, "TOPIC:FIELD", and class of the bit."""
        flips: dict[str, list[Flip]] = {}
        for judged in self.recordings:
            for flip in judged.flips:
                flips.setdefault(f"{flip.topic}:{flip.field}", []).append(flip)
        return {field: _rates(of_field) for field, of_field in flips.items()}

    @property
    def blind(self) -> list[str]:
        """Fields of which no flipped sign or exponent is detected, of `_ENOUGH` or more."""
        fields = []
        for field, rates in self.flips_by_field.items():
            large = [rates[bits] for bits in ("sign", "exponent") if bits in rates]
            if sum(rate.n for rate in large) >= _ENOUGH and not any(rate.rate for rate in large):
                fields.append(field)
        return fields

    @property
    def faults(self) -> Rate:
        """Share of the known faults that were followed by an alarm."""
        faulty = [judged for judged in self.recordings if judged.has_fault]
        return wilson(sum(judged.fault_delay_s is not None for judged in faulty), len(faulty))

    @property
    def delays_s(self) -> list[float]:
        """Delays of the detected known faults (s), ascending."""
        return sorted(judged.fault_delay_s for judged in self.recordings if judged.fault_delay_s is not None)

    @property
    def alarm_percent(self) -> float:
        """Share of normal messages with an alarm (%)."""
        alarms = sum(len(judged.alarms) for judged in self.recordings)
        return 100 * alarms / max(1, sum(judged.messages for judged in self.recordings))

    def headline(self) -> str:
        """Alarm events per hour and share of messages with an alarm, in one line."""
        rate = self.alarms
        events = f"{rate.events} false alarm events"
        if rate.events == 1:
            events = "1 false alarm event"
        exposure = f"{self.exposure_s / _MINUTE_S:.1f} min of normal flight"
        return f"{events} in {exposure}: {rate_text(rate)} per hour; {self.alarm_percent:.3g} % of messages"

    def to_json(self) -> dict[str, Any]:
        """Plain data."""
        return {
            "exposure_s": self.exposure_s,
            "alarms_per_hour": asdict(self.alarms),
            "flips": {name: asdict(rate) for name, rate in self.flips.items()},
            "flips_by_field": {
                field: {bits: asdict(rate) for bits, rate in rates.items()}
                for field, rates in self.flips_by_field.items()
            },
            "faults": asdict(self.faults),
            "delays_s": self.delays_s,
            "recordings": [
                asdict(judged)
                | {
                    "events": judged.events,
                    "not_monitored": [item._asdict() for item in judged.not_monitored],
                    "silences": [silence._asdict() for silence in judged.silences],
                    "event_list": [event._asdict() for event in judged.event_list],
                }
                for judged in self.recordings
            ],
        }


def _rates(flips: Iterable[Flip]) -> dict[str, Rate]:
    """Share of detected flips by class of the bit."""
    detected: dict[str, list[bool]] = {}
    for flip in sorted(flips, key=lambda flip: BIT_CLASSES.index(flip.bit_class)):
        detected.setdefault(flip.bit_class, []).append(flip.detected)
    return {bits: wilson(sum(flags), len(flags)) for bits, flags in detected.items()}


def rate_text(rate: EventRate) -> str:
    """Events per hour with interval; three digits, as rates in minutes of flight span decades."""
    if rate.per_hour is None or rate.low is None or rate.high is None:
        return "not counted"
    value, low, high = map(_three_digits, (rate.per_hour, rate.low, rate.high))
    return f"{value} [{low}, {high}]"


def _three_digits(number: float) -> str:
    """A number with three digits, or in full if it has more of them before the point."""
    if number >= 1000.0:
        return f"{number:,.0f}"
    return f"{number:.3g}"


def delay_text(judged: JudgedLog) -> str:
    """Delay of the first alarm after the known fault."""
    if not judged.has_fault:
        return ""
    if judged.fault_delay_s is None:
        return "no alarm"
    return f"{judged.fault_delay_s:.2f} s"
