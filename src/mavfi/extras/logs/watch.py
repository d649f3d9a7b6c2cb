"""GAD or AAD on recorded flights: trained on some, applied to others, with injected flips and known faults."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from mavfi.analysis.statistics import EventRate, Rate, event_rate, wilson
from mavfi.detectors.foreign import SMALLEST_SAMPLE, foreign_spec, learn
from mavfi.errors import BadInputError, allowed
from mavfi.faults.levels.message.definition import AbsentError, Leaf, flip_bit
from mavfi.faults.strata import bits_of
from mavfi.flight.log_readers import LONGEST_LIST, LoggedMessage, Probe, check_topics, open_flight_log
from mavfi.states import Field, State

_EVENT_GAP_US = 1_000_000
"""Alarms that follow each other within this time are one event (us)."""
BIT_CLASSES = ("sign", "exponent", "mantissa")
_LONGEST_GAP_US = 1_000_000
"""Longer times without a message do not count as exposure (us)."""
_MIN_MESSAGES = 20
"""Messages that a monitored topic has in each recording."""
_FLOATS = {"float32": "f4", "float64": "f8"}
_INJECTION_STREAM = 1


@dataclass(frozen=True)
class LogRecording:
    """Messages of a recorded flight.

    Attributes:
        name: File name.
        messages: In order of time.
        onset_us: Start of a known fault (us, by the clock of the file); None = none known.
        recommended: Fields worth monitoring, by topic, as known by the reader; empty = all numbers.
        cut: Whether the file ends within a message.
    """

    name: str
    messages: list[LoggedMessage]
    onset_us: int | None = None
    recommended: Mapping[str, Sequence[str]] = field(default_factory=dict)
    cut: bool = False

    @property
    def normal(self) -> "LogRecording":
        """The part before the known fault."""
        if self.onset_us is None:
            return self
        return replace(self, messages=[message for message in self.messages if message.time_us < self.onset_us])

    def split(self, share: float) -> tuple["LogRecording", "LogRecording"]:
        """The first share of its messages, and the rest."""
        count = round(share * len(self.messages))
        first = replace(self, messages=self.messages[:count])
        rest = replace(self, messages=self.messages[count:])
        return first, rest


def read_recording(path: Path, fault: str = "", *, required: bool = True) -> LogRecording:
    """Read a recorded flight.

    Args:
        path: The file.
        fault: "TOPIC:FIELD" of a number whose first value other than 0 marks the start of a known fault; "" = none.
        required: Whether the file must have that number.

    Raises:
        BadInputError: The file cannot be read, or lacks a required field.
    """
    topic, _, number = fault.rpartition(":")
    if fault and not (topic and number):
        raise BadInputError(f"--fault: {fault!r}: allowed: TOPIC:FIELD, a number that is 0 before the fault")
    reader = open_flight_log(path)
    messages = list(reader.messages([]))
    # The topic that tells of the fault is not monitored.
    onset = None
    if fault:
        if required:
            check_topics(path, [topic], {message.topic for message in messages})
        onset = _onset([message for message in messages if message.topic == topic], number)
        messages = [message for message in messages if message.topic != topic]
    is_cut = getattr(reader, "is_cut", None)
    cut = is_cut is not None and is_cut()
    return LogRecording(path.name, messages, onset, getattr(reader, "recommended", {}), cut)


def _onset(messages: Sequence[LoggedMessage], number: str) -> int | None:
    """Time of the first message (us) in which a number is not 0."""
    for message in messages:
        message.layout.check(number)
        try:
            if message.layout.locate(message.data, number).value(message.data) != 0:
                return message.time_us
        except AbsentError as error:
            raise BadInputError(f"--fault: {error}") from None
    return None


# ---- selection of fields -------------------------------------------------------------------------------------------
def select(recordings: Sequence[LogRecording], wanted: Sequence[str] = ()) -> dict[str, Probe]:
    """Monitored fields by topic: those that all recordings have, with finite numbers in every message.

    Args:
        recordings: Normal parts of the recordings.
        wanted: "TOPIC:FIELD" or "FIELD"; empty = the recommended ones of the format, or all.

    Raises:
        BadInputError: A wanted field is not in all recordings, or there is none at all.
    """
    groups = [_by_topic(recording) for recording in recordings]
    shared = [topic for topic in groups[0] if all(len(group.get(topic, ())) >= _MIN_MESSAGES for group in groups)]
    # In each topic the numbers that are wanted, or recommended, and finite throughout.
    probes = {}
    for topic in shared:
        first = groups[0][topic][0]
        names = _candidates(topic, first, wanted, recordings[0].recommended)
        usable = [name for name in names if all(_is_finite(group[topic], name) for group in groups)]
        if usable:
            probes[topic] = Probe(first.layout, foreign_spec(topic, usable))
    cut = cut_text(recordings)
    if cut:
        cut = f" ({cut})"
    _check_wanted(wanted, probes, groups, shared, cut)
    if not probes:
        files = ", ".join(recording.name for recording in recordings)
        raise BadInputError(
            f"{files}: no numbers in common{cut}; allowed: topics with {_MIN_MESSAGES} messages or more "
            "in each recording, with finite numbers"
        )
    return probes


def cut_text(recordings: Sequence[LogRecording]) -> str:
    """Which files are cut; "" = none."""
    names = [recording.name for recording in recordings if recording.cut]
    if names:
        return f"{', '.join(names)}: cut, the last message is not complete"
    return ""


def _by_topic(recording: LogRecording) -> dict[str, list[LoggedMessage]]:
    """The messages of each topic."""
    groups: dict[str, list[LoggedMessage]] = {}
    for message in recording.messages:
        groups.setdefault(message.topic, []).append(message)
    return groups


def _candidates(
    topic: str, message: LoggedMessage, requested: Sequence[str], recommended: Mapping[str, Sequence[str]]
) -> list[str]:
    """Numbers of a topic, given a message of it, that are wanted; by default those that are recommended."""
    numbers = message.layout.numbers(message.data, LONGEST_LIST)
    if requested:
        requested_names = [name.rpartition(":") for name in requested]
        return [path for topic_of_name, _, path in requested_names if topic_of_name in ("", topic) and path in numbers]
    if not recommended:
        return numbers
    return [name for name in recommended.get(topic, ()) if name in numbers]


def _is_finite(messages: Sequence[LoggedMessage], name: str) -> bool:
    """Whether every message has the number, and it is finite."""
    try:
        values = [message.layout.locate(message.data, name).value(message.data) for message in messages]
    except (AbsentError, KeyError):
        return False
    return bool(np.isfinite(np.array(values, np.float64)).all())


def _check_wanted(
    wanted: Sequence[str],
    probes: Mapping[str, Probe],
    groups: Sequence[dict[str, list[LoggedMessage]]],
    shared: Sequence[str],
    cut: str,
) -> None:
    """Refuse wanted fields that are not monitored, and name the nearest ones."""
    monitored = {(topic, field.name) for topic, probe in probes.items() for field in probe.spec.header}
    for name in wanted:
        topic, _, path = name.rpartition(":")
        if any(path == monitored_path and topic in ("", owner) for owner, monitored_path in monitored):
            continue
        # What could be named instead: in the same topic if there is one, and in the same form.
        candidates: Sequence[str] = shared
        if topic in shared:
            candidates = [topic]
        numbers = []
        for candidate in candidates:
            first = groups[0][candidate][0]
            for number in first.layout.numbers(first.data, LONGEST_LIST):
                if not all(_is_finite(group[candidate], number) for group in groups):
                    continue
                if topic:
                    numbers.append(f"{candidate}:{number}")
                else:
                    numbers.append(number)
        raise BadInputError(
            f"--fields: {name}: not a finite number in all recordings, in {_MIN_MESSAGES} messages or more of "
            f"each{cut}; allowed: {allowed(numbers, name)}"
        )


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
    """

    place: int
    time_us: int
    topic: str
    score: float
    fields: tuple[str, ...]


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

    @property
    def events(self) -> int:
        """Alarms, with those within `_EVENT_GAP_US` of each other counted as one."""
        if not self.alarms:
            return 0
        times = [alarm.time_us for alarm in self.alarms]
        return 1 + sum(later - earlier > _EVENT_GAP_US for earlier, later in zip(times, times[1:], strict=False))


class LogWatch:
    """A detector trained on recordings.

    Args:
        kind: "gaussian" or "autoencoder".
        profile: "paper" or "tuned".
        probes: Monitored fields.
        training: Recordings of normal flights.

    Raises:
        BadInputError: Unknown kind, or too few messages.
    """

    def __init__(self, kind: str, profile: str, probes: Mapping[str, Probe], training: Sequence[LogRecording]) -> None:
        # Read all topics, then drop those with too few messages.
        self.probes = dict(probes)
        flights = [[state for _, state in self._states(recording)] for recording in training]
        counts = Counter(state.spec.name for states in flights for state in states)
        self.probes = {topic: probe for topic, probe in probes.items() if counts[topic] >= SMALLEST_SAMPLE}
        if not self.probes:
            raise BadInputError(f"--train: no topic has {SMALLEST_SAMPLE} messages; allowed: longer recordings")
        specs = {topic: probe.spec for topic, probe in self.probes.items()}
        training_states = [[state for state in states if state.spec.name in specs] for states in flights]
        self.detector: Any = learn(kind, profile, training_states, specs)
        self.trained_on = sum(map(len, training_states))

    def _states(self, recording: LogRecording) -> Iterator[Sample]:
        """The messages of a recording with monitored fields."""
        for message in recording.messages:
            state = self._read(message, message.data)
            if state is not None:
                yield message, state

    def _read(self, message: LoggedMessage, data: bytes) -> State | None:
        """The monitored fields of bytes with the layout of a message, which may differ from file to file."""
        probe = self.probes.get(message.topic)
        if probe is None:
            return None
        return replace(probe, layout=message.layout).read(data)

    def judge(self, recording: LogRecording, flips: int = 0, seed: int = 0) -> JudgedLog:
        """Judge a recording.

        Args:
            recording: The recording; what follows its known fault is judged apart.
            flips: Number of bits to flip in floating-point fields of its normal part, each alone and undone
                afterwards, as many in each of `BIT_CLASSES`.
            seed: Draws messages, fields and bits.
        """
        samples = list(self._states(recording))
        alarms = list(self._run(samples))
        # The normal part, and what follows the known fault.
        onset = recording.onset_us
        normal = samples
        faulty: list[Sample] = []
        false_alarms = alarms
        fault_delay_s = None
        if onset is not None:
            count = sum(message.time_us < onset for message, _ in samples)
            normal = samples[:count]
            faulty = samples[count:]
            false_alarms = [alarm for alarm in alarms if alarm.time_us < onset]
            for alarm in alarms:
                if alarm.time_us >= onset:
                    fault_delay_s = 1e-6 * (alarm.time_us - onset)
                    break
        injected = self._inject(normal, {alarm.place for alarm in false_alarms}, flips, seed)
        return JudgedLog(
            recording.name,
            _exposure_s(normal),
            len(normal),
            false_alarms,
            list(injected),
            has_fault=onset is not None,
            fault_delay_s=fault_delay_s,
            after_fault_s=_exposure_s(faulty),
            cut=recording.cut,
        )

    def _run(self, samples: Sequence[Sample]) -> Iterator[LogAlarm]:
        """The alarms of a flight."""
        self.detector.start()
        for index, (message, state) in enumerate(samples):
            alarm = self._step(state, message.time_us)
            if alarm is not None:
                fields = tuple(name.removeprefix(f"{message.topic}.") for name in alarm.fields)
                yield LogAlarm(index, message.time_us, message.topic, alarm.score, fields)

    def _step(self, state: State, time_us: int) -> Any:
        """The alarm on a message, which the detector accepts in any case; None = there is none."""
        alarm = self.detector.check(state, time_us)
        self.detector.accept(state, time_us)
        return alarm

    def _inject(self, samples: Sequence[Sample], alarmed: set[int], count: int, seed: int) -> Iterator[Flip]:
        """Flips in order of time; messages that raise an alarm without it, or before such a one, are not drawn."""
        usable = []
        for index, follower in enumerate(_next_of_topic(samples)):
            if follower is not None and not alarmed & {index, follower} and self._floats(samples[index][0]):
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
                self._step(state, message.time_us)
            position = max(position, index)
            yield self._flip(samples[index : follower + 1], BIT_CLASSES[number % len(BIT_CLASSES)], random)

    def _floats(self, message: LoggedMessage) -> list[tuple[str, str]]:
        """Monitored floating-point fields of a message, each with its kind."""
        names = [field.name for field in self.probes[message.topic].spec.header]
        kinds = [(name, message.layout.check(name)) for name in names]
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
        changed = self._read(message, flip_bit(message.data, leaf, bit))
        assert changed is not None  # it has the numbers of the original
        # Judge, and restore the detector.
        memory = self.detector.memory()
        detected = self._step(changed, message.time_us) is not None
        for later, state in samples[1:]:
            alarm = self._step(state, later.time_us)
            if alarm is not None and later.topic == message.topic:
                detected = True
        self.detector.restore(memory)
        return Flip(message.topic, name, bit, bit_class, detected)


def judge_rest(
    kind: str,
    profile: str,
    recording: LogRecording,
    share: float,
    fields: Sequence[str] = (),
    flips: int = 0,
    seed: int = 0,
) -> tuple[LogWatch, JudgedLog]:
    """Train a detector on the first share of a recording, and judge the rest."""
    first, rest = recording.split(share)
    log_watch = LogWatch(kind, profile, select([first.normal, rest.normal], fields), [first.normal])
    return log_watch, log_watch.judge(rest, flips, seed)


def _next_of_topic(samples: Sequence[Sample]) -> list[int | None]:
    """Index of the next message of the same topic, for each message."""
    following: list[int | None] = [None] * len(samples)
    latest: dict[str, int] = {}
    for index, (message, _) in enumerate(samples):
        if message.topic in latest:
            following[latest[message.topic]] = index
        latest[message.topic] = index
    return following


def _exposure_s(samples: Sequence[Sample]) -> float:
    """Duration of some messages without longer gaps (s)."""
    gaps = np.diff(np.array([message.time_us for message, _ in samples], np.int64))
    return 1e-6 * float(gaps[gaps <= _LONGEST_GAP_US].sum())


# ---- rates -----------------------------------------------------------------------------------------------------------

_MINUTE_S = 60.0
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
        flips = [flip for judged in self.recordings for flip in judged.flips]
        rates = {}
        for name in BIT_CLASSES:
            detected = [flip.detected for flip in flips if flip.bit_class == name]
            if detected:
                rates[name] = wilson(sum(detected), len(detected))
        return rates

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
        return f"{events} in {exposure}: {rate_text(rate)} per hour; {self.alarm_percent:.2g} % of messages"

    def to_json(self) -> dict[str, Any]:
        """Plain data."""
        return {
            "exposure_s": self.exposure_s,
            "alarms_per_hour": asdict(self.alarms),
            "flips": {name: asdict(rate) for name, rate in self.flips.items()},
            "faults": asdict(self.faults),
            "delays_s": self.delays_s,
            "recordings": [asdict(judged) | {"events": judged.events} for judged in self.recordings],
        }


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
