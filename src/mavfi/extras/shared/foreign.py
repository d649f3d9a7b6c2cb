"""The monitor of numbers of any program: logs, topics, calls.  Nothing is known of them but what normal messages show.

`recognise` says what the numbers are; `Monitor.fit` trains a detector on normal messages; the monitor
stands between messages and detector.  An angle jumps by a full turn where it passes the end of its range, and a
quaternion `q` is the same attitude as `-q`.  A detector that takes them for plain numbers learns these jumps as normal
changes, and no longer sees others.  So each value is replaced by the equal one nearest to the value before: an angle
plus a number of turns, a quaternion with or without the opposite sign.
"""

import math
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from mavfi.detectors.detector import Alarm, Detector
from mavfi.detectors.features import Events
from mavfi.detectors.model import Model
from mavfi.detectors.preprocess import Preprocessor
from mavfi.detectors.registry import detector_class, figures_of, of_monitored_fields, trainable
from mavfi.detectors.scoring import NOT_FINITE
from mavfi.detectors.training import join, sample_of
from mavfi.errors import BadInputError
from mavfi.states import Field, Stage, State, StateSpec, floats

SMALLEST_SAMPLE = 50
"""Messages required of each source."""
NOT_FINITE_RULE = "not finite"
"""Source of alarms on numbers that were finite in the training and are not now."""
TURNS = {"rad": 2.0 * math.pi, "deg": 360.0, "cdeg": 36_000.0, "degE7": 3.6e9}
"""A full turn in each unit of angles."""
QUATERNION = "quaternion"
COUNTER = "counter"
"""Other kinds of numbers; a counter counts messages or tells the time."""

# Codes: units of the numbers are unknown, so the zero threshold of the code is learned as well.
_BELOW_CODED = 3
_BELOW_CHANGE = 1
"""Octaves between the code threshold and the largest magnitude (profile `paper`) or difference."""
_BELOW_CONSTANT = 20
"""Octaves between the assumed difference of a field that never changes and its magnitude."""
_LARGEST_EXPONENT = 1000
"""Largest magnitude of the exponent threshold of a code."""
_ABOVE_OCTAVE = 1.01
"""Largest change in the training / the power of two below it, after scaling."""

# Quaternions and angles.
_NORM_ERROR = 2e-3
"""Largest deviation of a quaternion's norm from 1, as of numbers with three decimals."""
_UNIT_SHARE = 0.99
"""Share of the messages with at most that."""
_PARENT = re.compile(r"\[\d+\]$|[^.\[]*$")
"""What the path of a number adds to that of the structure or list that holds it."""
_LONGEST_RANGE = 1.005
"""Largest range of an angle, in turns, with its rounding."""
_SHORTEST_JUMP = 0.9
"""Smallest jump from one end of the range to the other, in turns."""
_LARGEST_STEP = 0.25
"""Largest other change of an angle, in turns."""
_MAX_TURNS = 3.0
"""Values beyond this many turns are no angles but corrupted: they are not changed."""
_MAX_COUNTED = 1e6
"""The same for values without jumps, whose turns add up."""

# Counters and clocks.
_RANGES = (256.0, 1e3, 65_536.0, 1e6, 1e9, 2.0**32)
"""Where counters, and the fractions of a second, begin again at 0."""
_USUAL_SHARE = 0.9
"""Share of the messages of a counter with its usual step."""
_MIN_MESSAGES = 10
_CLOCK_RATES = (1.0, 1e3, 1e6, 1e9)
"""Growth of clocks per second, by their units."""
_CLOCK_DRIFT = 1e-3
"""Largest relative difference between the rates of a clock and of the messages."""
_CLOCK_JITTER_S = 0.05
"""Largest difference between a clock and the time of the messages, in nearly all of them (s)."""
_MIN_SECONDS = 10
"""Shortest recording in which a count of whole seconds can be distinguished from other numbers (s)."""


# ---- messages --------------------------------------------------------------------------------------------------------
def foreign_spec(name: str, fields: Sequence[str]) -> StateSpec:
    """State specification for numbers that a source publishes together."""
    return StateSpec(name, "", Stage.SENSOR, "", tuple(Field(field, "f8", "-") for field in fields))


def foreign_state(spec: StateSpec, values: Sequence[float] | np.ndarray) -> State:
    """One publication of such a state."""
    header = np.array(values, np.float64).view(spec.header_dtype)
    return State(spec, header, np.zeros(0, spec.element_dtype))


def _values(state: State) -> np.ndarray:
    """The values of such a state. Shape (fields,)."""
    return floats(state.header, len(state.spec.header))


class NamedNumbers(NamedTuple):
    """A message: its topic, its time (us) and its numbers by path."""

    topic: str
    time_us: int
    numbers: Mapping[str, float]


class Numbers(NamedTuple):
    """Numbers of a topic in one recording, by message.

    Attributes:
        names: Their names.
        values: NaN where a message lacks the number. Shape (messages, numbers).
        times_us: Times of the messages (us).
    """

    names: Sequence[str]
    values: np.ndarray
    times_us: np.ndarray


# ---- what numbers are ------------------------------------------------------------------------------------------------
def recognise(recordings: Sequence[Numbers], units: Mapping[str, str] | None = None) -> dict[str, str]:
    """What the numbers of a topic are: `QUATERNION`, `COUNTER`, or an angle, a key of `TURNS`; plain ones are left out.

    They are recognised by what they do, not by their names, which name a rate like its angle.

    Args:
        recordings: Its numbers in each recording, with the same names.
        units: Units of numbers, as far as the format of the messages defines them.
    """
    kinds: dict[str, str] = {}
    longest = max(recordings, key=lambda numbers: len(numbers.times_us))
    for index, name in enumerate(longest.names):
        unit = (units or {}).get(name, "")
        kind = unit.replace("degheading", "deg")
        if not unit:
            kind = _angle_by_jumps([numbers.values[:, index] for numbers in recordings])
        if kind not in TURNS and _counts(longest.values[:, index], longest.times_us):
            kind = COUNTER
        if kind in (*TURNS, COUNTER):
            kinds[name] = kind
    return kinds | _quaternions(longest.names, np.concatenate([numbers.values for numbers in recordings]))


def _quaternions(names: Sequence[str], values: np.ndarray) -> dict[str, str]:
    """Components of quaternions: four neighbours of norm 1.

    No component is constant, as in flags of which one is set, unless the four are all that a structure or list holds.
    """
    values = values[np.isfinite(values).all(axis=1)]
    parents = [_PARENT.sub("", name) for name in names]
    kinds: dict[str, str] = {}
    for start in range(len(names) - 3):
        group = slice(start, start + 4)
        is_whole = len({*parents[group]}) == 1 and parents.count(parents[start]) == 4
        varies = (values[:, group] != values[:1, group]).any(axis=0).all()
        with np.errstate(over="ignore"):
            is_unit = np.abs(np.linalg.norm(values[:, group], axis=1) - 1.0) <= _NORM_ERROR
        is_quaternion = (is_whole or varies) and is_unit.sum() > _UNIT_SHARE * len(is_unit)
        if is_quaternion and kinds.keys().isdisjoint(names[group]):
            kinds |= dict.fromkeys(names[group], QUATERNION)
    return kinds


def _angle_by_jumps(columns: Sequence[np.ndarray]) -> str:
    """Unit of a number that jumps from one end of an angle's range to the other, by recording; "" = it does not."""
    columns = [column[np.isfinite(column)] for column in columns]
    values = np.concatenate(columns)
    with np.errstate(over="ignore"):
        steps = np.abs(np.concatenate([np.diff(column) for column in columns]))
        extent = values.max(initial=-np.inf) - values.min(initial=np.inf)
    for unit, turn in TURNS.items():
        is_jump = steps > _SHORTEST_JUMP * turn
        is_small = steps < _LARGEST_STEP * turn
        if extent <= _LONGEST_RANGE * turn and is_jump.any() and (is_jump | is_small).all():
            return unit
    return ""


def _counts(values: np.ndarray, times_us: np.ndarray) -> bool:
    """Whether a number grows by the same step from message to message, or with the time in a unit of time."""
    is_finite = np.isfinite(values)
    if is_finite.sum() < _MIN_MESSAGES:
        return False
    values = values[is_finite]
    passed_s = 1e-6 * (times_us - times_us[0])[is_finite]
    is_whole = bool((values == np.floor(values)).all())
    limit = next((limit for limit in _RANGES if limit > values.max()), None)
    with np.errstate(over="ignore", invalid="ignore"):
        if is_whole and limit is not None:
            values = np.unwrap(values, period=limit)  # begins again at the end of the range
        steps = np.diff(values)
    if not (steps >= 0.0).all():
        return False
    usual = np.median(steps)
    if is_whole and usual > 0.0 and np.mean(steps == usual) >= _USUAL_SHARE:
        return True
    for rate in _CLOCK_RATES:
        tolerance = max(float(is_whole), _CLOCK_JITTER_S * rate)
        difference = values - rate * passed_s
        error = np.quantile(np.abs(difference - np.median(difference)), 0.99)
        is_long = rate * passed_s[-1] >= _MIN_SECONDS * tolerance
        if is_long and error <= tolerance + _CLOCK_DRIFT * rate * passed_s[-1]:
            return True
    return False


# ---- the monitor -----------------------------------------------------------------------------------------------------
class Topic:
    """The monitored numbers of a topic, and what a detector sees of them.

    Args:
        spec: The numbers.
        kinds: What they are, see `recognise`; plain ones may be left out.

    Attributes:
        spec: The numbers.
        names: Their names.
        kinds: Which of them are angles and quaternions.
        is_circular: Whether each is an angle, or a component of a quaternion. Shape (fields,).
        factors: Factor of each number in what the detector sees, set by `Monitor.fit`. Shape (fields,).
    """

    def __init__(self, spec: StateSpec, kinds: Mapping[str, str]) -> None:
        self.spec = spec
        self.names = [field.name for field in spec.header]
        self.kinds = {name: kinds[name] for name in self.names if kinds.get(name) in (*TURNS, QUATERNION)}
        of_fields = [self.kinds.get(name, "") for name in self.names]
        self.is_circular = np.array([kind != "" for kind in of_fields])
        self.factors = np.ones(len(of_fields))
        self._turns = np.array([TURNS.get(kind, np.nan) for kind in of_fields])
        self._quaternions = np.flatnonzero([kind == QUATERNION for kind in of_fields]).reshape(-1, 4)

    def read(self, numbers: Mapping[str, float]) -> State | None:
        """The monitored numbers of a message; None if it lacks one."""
        try:
            return foreign_state(self.spec, [numbers[name] for name in self.names])
        except KeyError:
            return None

    def continued(self, state: State, last: np.ndarray | None) -> np.ndarray:
        """Values of a message without jumps: finite, equal to its own, and nearest to the last ones; None = none."""
        values = _values(state)
        if last is None:
            return values
        values = np.where(np.isfinite(values), values, last)
        with np.errstate(over="ignore", invalid="ignore"):
            is_angle = (np.abs(values) <= _MAX_TURNS * self._turns) & (np.abs(last) <= _MAX_COUNTED * self._turns)
            values = np.where(is_angle, values + self._turns * np.rint((last - values) / self._turns), values)
            for indices in self._quaternions:
                if (values[indices] * last[indices]).sum() < 0.0:
                    values[indices] = -values[indices]
        return values

    def shown(self, values: np.ndarray) -> State:
        """These values as the detector sees them."""
        with np.errstate(over="ignore"):
            return foreign_state(self.spec, self.factors * values)


class Monitor(Detector):
    """A detector of the numbers of messages, by topic.

    A number that is not finite is an alarm.  The detector, which was fitted to finite numbers, sees its last finite
    value instead: where a number is lost for long, alarms on others are not.

    Args:
        detector: The detector, with the same states.
        topics: The monitored numbers by topic.
        compares: Whether the detector judges changes only: the first message of a topic, which has none, passes.
    """

    def __init__(self, detector: Detector, topics: Mapping[str, Topic], *, compares: bool = False) -> None:
        self._topics = topics
        self._detector = detector
        self._compares = compares
        self._last: dict[str, np.ndarray] = {}  # values without jumps of the last message, by topic
        self._lost: dict[str, list[str]] = {}  # names of its numbers that were not finite
        self._prepared: tuple[State, np.ndarray, State] | None = None

    @classmethod
    def fit(
        cls, kind: str, profile: str, recordings: Sequence[Sequence[State]], topics: Mapping[str, Topic]
    ) -> "Monitor":
        """A detector of a kind in `trainable()`, fitted to normal messages with finite values.

        The messages of each recording are in order; differences are taken within a recording only.

        Raises:
            BadInputError: Unknown kind, or too few messages of a topic.
        """
        factory: Any = detector_class(kind)
        is_coded = kind in of_monitored_fields()
        if not (is_coded or hasattr(factory, "of_messages")):
            raise BadInputError(f"detector {kind!r}: is not fitted to messages; allowed: {', '.join(trainable())}")
        counts = Counter(state.spec.name for states in recordings for state in states)
        for name in topics:
            if counts[name] < SMALLEST_SAMPLE:
                raise BadInputError(f"training: {counts[name]} messages of {name}; allowed: {SMALLEST_SAMPLE} or more")
        specs = {name: topic.spec for name, topic in topics.items()}
        runs = [_continued(states, topics) for states in recordings if states]
        thresholds: list[int] = []
        circular: list[str] = []
        if is_coded:
            for name, topic in topics.items():
                tables = [np.array([values for owner, values in run if owner == name]) for run in runs]
                is_value = ~topic.is_circular & (profile == "paper")
                thresholds += _scale(topic, [table for table in tables if len(table)], is_value)
                circular += [f"{name}.{topic.names[index]}" for index in np.flatnonzero(topic.is_circular)]
        shown = [[topics[name].shown(values) for name, values in run] for run in runs]
        if not is_coded:
            return cls(factory.of_messages(shown, specs, figures_of(kind, "tuned")), topics, compares=True)

        # Of angles the difference is coded in both profiles: codes of their values would depend on the turns.
        preprocessor = Preprocessor.of(specs, profile, thresholds, circular)
        sample = join([sample_of(_events(states, list(topics)), preprocessor) for states in shown])
        parameters = factory.fit(sample, preprocessor, figures_of(kind, profile))
        model = Model(kind, profile, "", "", parameters, {})
        return cls(factory(model, preprocessor=preprocessor), topics, compares=True)

    def step(self, state: State, time_us: int) -> Alarm | None:
        """The alarm on a message, which is accepted in any case; None = there is none."""
        alarm = self.check(state, time_us)
        self.accept(state, time_us)
        return alarm

    def judge(self, message: NamedNumbers) -> Alarm | None:
        """The alarm on a message; None = there is none, or it lacks a monitored number."""
        topic = self._topics.get(message.topic)
        state = None
        if topic is not None:
            state = topic.read(message.numbers)
        if state is None:
            return None
        return self.step(state, message.time_us)

    def start(self) -> None:
        """Reset the memory at the start of a recording."""
        self._prepared = None
        self._last = {}
        self._lost = {}
        self._detector.start()

    def _prepare(self, state: State) -> tuple[State, np.ndarray, State]:
        """A message, its values without jumps, and what the detector sees of it."""
        if self._prepared is None or self._prepared[0] is not state:
            topic = self._topics[state.spec.name]
            values = topic.continued(state, self._last.get(state.spec.name))
            self._prepared = state, values, topic.shown(values)
        return self._prepared

    def check(self, state: State, time_us: int) -> Alarm | None:
        """Check a message."""
        topic = state.spec.name
        not_finite = _not_finite(state)
        lost = None
        if not_finite:
            fields = tuple(f"{topic}.{name}" for name in not_finite)
            lost = Alarm(NOT_FINITE_RULE, state.spec.stage.value, score=NOT_FINITE, fields=fields)
            # new, or without a value that could stand for it
            if self._lost.get(topic) != not_finite or topic not in self._last:
                return lost
        if self._compares and topic not in self._last:
            return lost
        return self._detector.check(self._prepare(state)[2], time_us) or lost

    def accept(self, state: State, time_us: int) -> None:
        """Record a message."""
        topic = state.spec.name
        self._lost[topic] = _not_finite(state)
        if self._lost[topic] and topic not in self._last:
            return
        _, self._last[topic], shown = self._prepare(state)
        self._detector.accept(shown, time_us)
        self._prepared = None

    def memory(self) -> tuple[Any, ...]:
        """Memory between messages."""
        return self._detector.memory(), dict(self._last), dict(self._lost)

    def restore(self, memory: tuple[Any, ...]) -> None:
        """Inverse of `memory`."""
        self._prepared = None
        detector, last, lost = memory
        self._last = dict(last)
        self._lost = dict(lost)
        self._detector.restore(detector)


def _not_finite(state: State) -> list[str]:
    """Names of the fields that are not finite."""
    values = _values(state).tolist()
    if math.isfinite(sum(values)):
        return []
    return [field.name for field, value in zip(state.spec.header, values, strict=True) if not math.isfinite(value)]


# ---- training --------------------------------------------------------------------------------------------------------
def train(kind: str, profile: str, recordings: Sequence[Sequence[NamedNumbers]]) -> Monitor:
    """A monitor fitted to normal messages: of the finite numbers that all messages of a topic have.

    Counters and clocks are no signal, and topics with few messages teach nothing: both are left out.

    Raises:
        BadInputError: There is no such number, or the detector is not fitted to messages.
    """
    topics: dict[str, Topic] = {}
    for topic in dict.fromkeys(message.topic for messages in recordings for message in messages):
        of_topic = [[message for message in messages if message.topic == topic] for messages in recordings]
        every = [message.numbers for messages in of_topic for message in messages]
        names = [name for name in every[0] if all(math.isfinite(numbers.get(name, math.nan)) for numbers in every)]
        kinds = recognise([_table(messages, names) for messages in of_topic])
        names = [name for name in names if kinds.get(name) != COUNTER]
        if names and len(every) >= SMALLEST_SAMPLE:
            topics[topic] = Topic(foreign_spec(topic, names), kinds)
    if not topics:
        raise BadInputError(
            f"detector {kind!r}: no number to monitor; allowed: {SMALLEST_SAMPLE} messages or more with finite numbers"
        )
    runs = []
    for messages in recordings:
        states = [topics[message.topic].read(message.numbers) for message in messages if message.topic in topics]
        runs.append([state for state in states if state is not None])
    return Monitor.fit(kind, profile, runs, topics)


def _table(messages: Sequence[NamedNumbers], names: Sequence[str]) -> Numbers:
    """Numbers of messages of one topic, which have all of them."""
    values = [[message.numbers[name] for name in names] for message in messages]
    times_us = [message.time_us for message in messages]
    return Numbers(names, np.array(values, np.float64).reshape(len(values), len(names)), np.array(times_us, np.int64))


def _continued(states: Sequence[State], topics: Mapping[str, Topic]) -> list[tuple[str, np.ndarray]]:
    """Topic and values without jumps of the messages of a recording."""
    last: dict[str, np.ndarray] = {}
    continued = []
    for state in states:
        name = state.spec.name
        last[name] = topics[name].continued(state, last.get(name))
        continued.append((name, last[name]))
    return continued


def _events(states: Sequence[State], names: Sequence[str]) -> Events:
    """Messages as one recorded flight, given the names of the topics in the order of their slots."""
    contents = [state.header.tobytes() for state in states]
    slots = np.array([names.index(state.spec.name) for state in states], np.int64)
    return Events(slots, np.cumsum([len(part) for part in contents]), np.frombuffer(b"".join(contents), np.uint8))


def _scale(topic: Topic, recordings: Sequence[np.ndarray], is_value: np.ndarray) -> list[int]:
    """Set the factors of a topic, and return the exponent threshold of each field's code, given its values.

    The factors bring the largest change of each field to just above a power of two, by which changes are coded:
    otherwise a slightly larger change might have another code, and be an alarm.  The threshold is a little below the
    largest number that is coded, a value or else a change; for a field that never changes, far below its value.
    """
    with np.errstate(over="ignore"):
        changes = np.max([np.abs(np.diff(table, axis=0)).max(axis=0, initial=0.0) for table in recordings], axis=0)
        changes = np.minimum(changes, np.finfo(np.float64).max)  # a difference may have overflowed
        mantissas = np.frexp(np.where(changes > 0.0, changes, 0.5 * _ABOVE_OCTAVE))[0]  # in [0.5, 1)
        topic.factors = 0.5 * _ABOVE_OCTAVE / mantissas
        values = topic.factors * np.abs(np.concatenate(recordings)).max(axis=0)
        coded = np.where(is_value, values, topic.factors * changes)
    exponents = np.where(coded > 0.0, np.frexp(coded)[1] - 1, np.frexp(values)[1] - 1 - _BELOW_CONSTANT)
    exponents -= np.where(is_value, _BELOW_CODED, _BELOW_CHANGE)
    return [int(exponent) for exponent in np.clip(exponents, -_LARGEST_EXPONENT, _LARGEST_EXPONENT)]
