"""What stands between the fields of messages and a detector: numbers that are not finite, angles, scales."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from mavfi.detectors.detector import Alarm, Detector
from mavfi.detectors.foreign import foreign_state, learn
from mavfi.detectors.registry import of_monitored_fields
from mavfi.detectors.scoring import NOT_FINITE
from mavfi.extras.logs.circular import Geometry, Unwrapper
from mavfi.states import State, StateSpec, floats

NOT_FINITE_RULE = "not finite"
"""Source of alarms on numbers that were finite in the training and are not now."""
_ABOVE_OCTAVE = 1.01
"""Largest change in the training / the power of two below it, after scaling."""


class Monitor(Detector):
    """A detector of the fields of messages.

    A number that is not finite is an alarm.  The detector, which was fitted to finite numbers, sees its last finite
    value instead: where a number is lost for long, alarms on others are not.  It sees angles and quaternions without
    jumps (see `circular`).

    Args:
        detector: The detector, with the same states.
        geometries: Angles and quaternions by topic.
        scales: Factor of each field by topic, see `fitted`; empty = 1.
        compares: Whether the detector judges changes only: the first message of a topic, which has none, passes.
    """

    def __init__(
        self,
        detector: Detector,
        geometries: Mapping[str, Geometry],
        scales: Mapping[str, np.ndarray] | None = None,
        *,
        compares: bool = False,
    ) -> None:
        self._detector = detector
        self._unwrapper = Unwrapper(geometries)
        self._scales = scales or {}
        self._compares = compares
        self._seen: frozenset[str] = frozenset()
        self._last: dict[str, State] = {}
        self._lost: dict[str, list[str]] = {}
        self._read: State | None = None

    def start(self) -> None:
        """Reset the memory at the start of a recording."""
        self._read = None
        self._seen = frozenset()
        self._last = {}
        self._lost = {}
        self._unwrapper.start()
        self._detector.start()

    def _prepare(self, state: State) -> None:
        """Set what the detector sees of a state, unless that is done."""
        if self._read is not state:
            self._read = state
            self._continuous = self._unwrapper.unwrap(self._finite(state))
            self._shown = scaled(self._continuous, self._scales)

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
        self._prepare(state)
        if self._compares and topic not in self._seen:
            return lost
        return self._detector.check(self._shown, time_us) or lost

    def accept(self, state: State, time_us: int) -> None:
        """Record a message."""
        topic = state.spec.name
        not_finite = _not_finite(state)
        self._lost[topic] = not_finite
        if not_finite and topic not in self._last:
            return
        self._prepare(state)
        self._detector.accept(self._shown, time_us)
        self._unwrapper.accept(self._continuous)
        self._last[topic] = self._finite(state)
        if topic not in self._seen:
            self._seen |= {topic}
        self._read = None

    def _finite(self, state: State) -> State:
        """The state with the last finite values of numbers that are not."""
        last = self._last.get(state.spec.name)
        if last is None or not _not_finite(state):
            return state
        width = len(state.spec.header)
        values = floats(state.header, width)
        finite = np.where(np.isfinite(values), values, floats(last.header, width))
        return foreign_state(state.spec, finite.tolist())

    def memory(self) -> tuple[Any, ...]:
        """Memory between messages."""
        return self._detector.memory(), self._unwrapper.memory(), self._seen, dict(self._last), dict(self._lost)

    def restore(self, memory: tuple[Any, ...]) -> None:
        """Inverse of `memory`."""
        self._read = None
        detector, unwrapper, self._seen, last, lost = memory
        self._last = dict(last)
        self._lost = dict(lost)
        self._detector.restore(detector)
        self._unwrapper.restore(unwrapper)


def fitted(
    kind: str,
    profile: str,
    recordings: Sequence[Sequence[State]],
    specs: Mapping[str, StateSpec],
    geometries: Mapping[str, Geometry],
) -> Monitor:
    """A detector of monitored fields, see `learn`, fitted to the messages of normal recordings.

    GAD and AAD code changes by powers of two.  The scales bring the largest change of each field in the training to
    just above such a power: otherwise a change slightly larger than all of the training might have another code, and
    be an alarm.

    Raises:
        BadInputError: See `learn`.
    """
    unwrapper = Unwrapper(geometries)
    continuous = []
    for states in recordings:
        unwrapper.start()
        continuous.append([_advance(unwrapper, state) for state in states])
    scales: dict[str, np.ndarray] = {}
    if kind in of_monitored_fields():
        scales = {topic: _scales_of(spec, continuous) for topic, spec in specs.items()}
    circular = {f"{topic}.{name}" for topic, geometry in geometries.items() for name in geometry.fields}
    shown = [[scaled(state, scales) for state in states] for states in continuous]
    return Monitor(learn(kind, profile, shown, specs, circular), geometries, scales, compares=True)


def _advance(unwrapper: Unwrapper, state: State) -> State:
    """The state without jumps, which is accepted."""
    continuous = unwrapper.unwrap(state)
    unwrapper.accept(continuous)
    return continuous


def _scales_of(spec: StateSpec, recordings: Sequence[Sequence[State]]) -> np.ndarray:
    """Factor of each field of a topic. Shape (fields,)."""
    width = len(spec.header)
    largest = np.zeros(width)
    for states in recordings:
        table = np.array([floats(state.header, width) for state in states if state.spec is spec])
        if len(table) > 1:
            with np.errstate(over="ignore", invalid="ignore"):
                largest = np.maximum(largest, np.abs(np.diff(table, axis=0)).max(axis=0))
    usable = np.isfinite(largest) & (largest > 0.0)
    mantissa = np.frexp(np.where(usable, largest, 1.0))[0]  # in [0.5, 1)
    return np.where(usable, 0.5 * _ABOVE_OCTAVE / mantissa, 1.0)


def scaled(state: State, scales: Mapping[str, np.ndarray]) -> State:
    """A state with each field multiplied by its factor."""
    factors = scales.get(state.spec.name)
    if factors is None:
        return state
    with np.errstate(over="ignore"):
        return foreign_state(state.spec, factors * floats(state.header, len(factors)))


def _not_finite(state: State) -> list[str]:
    """Names of the fields that are not finite."""
    values = floats(state.header, len(state.spec.header)).tolist()
    if math.isfinite(sum(values)):
        return []
    return [field.name for field, value in zip(state.spec.header, values, strict=True) if not math.isfinite(value)]
