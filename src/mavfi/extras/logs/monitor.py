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

    A number that is not finite is an alarm, and the detector does not see its message: it was fitted to finite numbers.
    Of all others it sees angles and quaternions without jumps (see `circular`).

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
        self._read: State | None = None

    def start(self) -> None:
        """Reset the memory at the start of a recording."""
        self._read = None
        self._seen = frozenset()
        self._unwrapper.start()
        self._detector.start()

    def _prepare(self, state: State) -> None:
        """Set what the detector sees of a state, unless that is done."""
        if self._read is not state:
            self._read = state
            self._continuous = self._unwrapper.unwrap(state)
            self._shown = scaled(self._continuous, self._scales)

    def check(self, state: State, time_us: int) -> Alarm | None:
        """Check a message."""
        not_finite = tuple(f"{state.spec.name}.{name}" for name in _not_finite(state))
        if not_finite:
            return Alarm(NOT_FINITE_RULE, state.spec.stage.value, score=NOT_FINITE, fields=not_finite)
        self._prepare(state)
        if self._compares and state.spec.name not in self._seen:
            return None
        return self._detector.check(self._shown, time_us)

    def accept(self, state: State, time_us: int) -> None:
        """Record a message."""
        if _not_finite(state):
            return
        self._prepare(state)
        self._detector.accept(self._shown, time_us)
        self._unwrapper.accept(self._continuous)
        if state.spec.name not in self._seen:
            self._seen |= {state.spec.name}
        self._read = None

    def memory(self) -> tuple[Any, ...]:
        """Memory between messages."""
        return self._detector.memory(), self._unwrapper.memory(), self._seen

    def restore(self, memory: tuple[Any, ...]) -> None:
        """Inverse of `memory`."""
        self._read = None
        detector, unwrapper, self._seen = memory
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
