"""Detectors by name, for recorded messages."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np

from mavfi.detectors.detector import Alarm, Detector, class_of
from mavfi.detectors.gate import UNKNOWN_ARENA
from mavfi.detectors.limits import MissionLimits
from mavfi.detectors.registry import detector_class, is_named, load_detector
from mavfi.detectors.training import TrainedDetector
from mavfi.errors import BadInputError, MavfiError
from mavfi.extras.logs.log_rules import LogRules
from mavfi.extras.logs.mapping import Mapper, UsedMapping, values_by_name
from mavfi.extras.logs.selection import LogSelection
from mavfi.extras.shared.foreign import Monitor
from mavfi.plugins import reason
from mavfi.states import ODOMETRY, STATES, VECTORS, State

TimedState = tuple[int, State]
"""A time (us), and a state."""
_RULES = "acceptance"
"""Source of the alarms of rules."""


def uses_rules(kind: str) -> bool:
    """Whether a detector of this name consists of rules, which need a mapping: `recommended`, `acceptance`."""
    return is_named(kind, _RULES)


def is_fitted(kind: str) -> bool:
    """Whether a detector of this name is fitted to the monitored fields, and reads no others.

    Raises:
        BadInputError: There is no such detector.
    """
    factory = detector_class(kind)
    return isinstance(factory, type) and issubclass(factory, TrainedDetector)


def log_detector(
    kind: str,
    profile: str,
    selection: LogSelection,
    mapping: UsedMapping,
    training: Sequence[Sequence[TimedState]],
    seed: int = 0,
) -> Monitor:
    """A detector for the messages of recordings.

    Args:
        kind: Its name, or "package:Class".
        profile: "paper" or "tuned", of a detector of monitored fields.
        selection: What is monitored.
        mapping: Which messages become states of missions, for rules and custom detectors.
        training: The monitored fields of normal recordings.
        seed: Seed of its random draws.

    Raises:
        BadInputError: There is no such detector, or it cannot judge recordings; the message says why.
    """
    if is_fitted(kind):
        return Monitor.fit(
            kind, profile, [[state for _, state in recording] for recording in training], selection.topics
        )
    if uses_rules(kind):
        return Monitor(LogRules(mapping, training), selection.topics)
    limits = _mission_limits(mapping, training)
    detector = load_detector(kind, profile, None, {"limits": limits, "seed": seed, "v_max": limits.v_max}).detector
    if detector.seals or detector.duplicates:
        raise BadInputError(
            f"--detector: {kind}: compares values with those that were sent, or computed twice; a recording has neither"
        )
    return Monitor(MappedDetector(detector, mapping), selection.topics)


class MappedDetector(Detector):
    """A detector of missions, or of messages, which is shown both: each message, and the states that become of it.

    Args:
        detector: The detector; with `states` it is shown these only.
        mapping: Which messages become states of missions.
    """

    def __init__(self, detector: Detector, mapping: UsedMapping) -> None:
        self._detector = detector
        self._mapper = Mapper(mapping)

    def start(self) -> None:
        """Reset the memory at the start of a recording."""
        self._mapper.start()
        self._detector.start()

    def _shown(self, state: State) -> Iterator[State]:
        """What the detector reads of a message."""
        states = self._detector.states
        for shown in (state, *self._mapper.made_of(state)):
            if states is None or shown.spec.name in states:
                yield shown

    @contextmanager
    def _naming(self, method: str, state: State) -> Iterator[None]:
        """Name the detector and its method in what it raises: its code is a user's own."""
        try:
            yield
        except MavfiError:
            raise
        except Exception as error:  # noqa: BLE001 - any exception of a user's code
            where = f"--detector: {class_of(self._detector)}: {method} of {state.spec.name}"
            raise BadInputError(f"{where}: {reason(error)}") from error

    def check(self, state: State, time_us: int) -> Alarm | None:
        """The first alarm on a message, or on a state that becomes of it."""
        for shown in self._shown(state):
            with self._naming("check", shown):
                alarm = self._detector.check(shown, time_us)
            if alarm is not None:
                return _named(alarm, self._mapper)
        return None

    def accept(self, state: State, time_us: int) -> None:
        """Record a message."""
        for shown in self._shown(state):
            with self._naming("accept", shown):
                self._detector.accept(shown, time_us)
        self._mapper.accept(state)

    def memory(self) -> tuple[Any, Any]:
        """Memory between messages."""
        return self._detector.memory(), self._mapper.memory()

    def restore(self, memory: tuple[Any, Any]) -> None:
        """Inverse of `memory`."""
        self._detector.restore(memory[0])
        self._mapper.restore(memory[1])


def _named(alarm: Any, mapper: Mapper) -> Alarm:
    """A custom detector's alarm, with the numbers of the message as its fields."""
    if not isinstance(alarm, Alarm):
        raise BadInputError(f"--detector: check returned {alarm!r:.60}; allowed: an Alarm, or None")
    fields = tuple(mapper.name_of(name) for name in alarm.fields)
    return Alarm(alarm.source, alarm.stage, score=float(alarm.score), fields=fields)


def _mission_limits(mapping: UsedMapping, training: Sequence[Sequence[TimedState]]) -> MissionLimits:
    """Limits of a vehicle whose mission is unknown, for detectors that need them: measured in the training."""
    mapper = Mapper(mapping)
    speeds = [1.0]
    accelerations = [1.0]
    periods: dict[str, list[float]] = {name: [] for name in STATES}
    goal = (0.0, 0.0, 0.0)
    for recording in training:
        mapper.start()
        last: dict[str, tuple[int, np.ndarray]] = {}
        for time_us, state in recording:
            for made in mapper.made_of(state):
                values = values_by_name(made)
                velocity = np.array([values.get(axis, np.nan) for axis in VECTORS[1]])
                if made.spec.name in last:
                    before_us, before = last[made.spec.name]
                    period_s = 1e-6 * (time_us - before_us)
                    if period_s > 0.0:
                        periods[made.spec.name].append(period_s)
                        accelerations.append(float(np.linalg.norm(velocity - before)) / period_s)
                speeds.append(float(np.linalg.norm(velocity)))
                last[made.spec.name] = time_us, velocity
                if made.spec.name == ODOMETRY["truth"] and mapper.has(made.spec.name, VECTORS[0]):
                    goal = (values["x"], values["y"], values["z"])
            mapper.accept(state)
    return MissionLimits(
        v_max=float(np.nanmax(speeds)),
        a_max=float(np.nanquantile(accelerations, 0.999)),
        flight=UNKNOWN_ARENA,
        goal=goal,
        held=False,
        every_map=False,
        point_period=_usual(periods["planning.waypoint"]),
        control_period=_usual(periods["control.command"]),
        look_ahead=0.0,
        planner_latency=0.0,
        plan_latency=1.0,
        velocity_lag=0.5,
    )


def _usual(periods_s: Sequence[float]) -> float:
    """The usual period (s)."""
    if periods_s:
        return float(np.median(periods_s))
    return 0.02
