"""The rules of the detector `recommended` that recorded messages can be checked with, see docs/concepts/engineers.md.

Rule 1: a counter stays or grows by one.  Rule 3: a motion respects the vehicle's dynamics: its speed, the change of its
velocity, the step of its position along its velocity, the turn of its attitude, and the distance of the set-point from
the vehicle.  Limits of rule 3 are the largest values of the training, with a margin.  Rules 2, 4 and 5 need the
protocol of missions (numbers of plans, copies of trajectory points, restarts), which no autopilot's log holds.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from mavfi.detectors.acceptance import COUNTERS, DYNAMICS
from mavfi.detectors.detector import Alarm, Detector
from mavfi.detectors.gate import IMPLAUSIBLE, SPEED_MARGIN
from mavfi.extras.logs.mapping import Mapper, UsedMapping, values_by_name
from mavfi.extras.logs.recording import longest_gap_us
from mavfi.states import ODOMETRY, VECTORS, State

_ODOMETRY = ODOMETRY["truth"]
_POSITION, _VELOCITY, _ = VECTORS
_QUATERNION = ("qw", "qx", "qy", "qz")
_FLOOR = 1e-3
"""Smallest limit: of values that are constant in the training (m, m/s, rad)."""
_UNITS = {
    "speed": "m/s",
    "velocity change": "m/s",
    "step along the velocity": "m",
    "turn": "rad",
    "yaw rate": "rad/s",
    "distance from the vehicle": "m",
}
"""What rule 3 limits, with units."""


class RuleInput(NamedTuple):
    """A quantity that a rule limits.

    Attributes:
        state: State of which it is one.
        name: What it is, a key of `_UNITS`.
        value: Its value, in that unit.
        field: The field of the state that contributes most.
    """

    state: str
    name: str
    value: float
    field: str


class LogRules(Detector):
    """Checks messages by the rules that apply to what is mapped.

    Args:
        used: What is mapped.
        training: Normal messages of each recording, with their times (us); mapped numbers are finite.

    Attributes:
        limits: Limit of each quantity, by state and name.
    """

    source = "acceptance"

    def __init__(self, used: UsedMapping, training: Sequence[Sequence[tuple[int, State]]]) -> None:
        self._mapper = Mapper(used)
        self._counters: dict[str, list[str]] = {}
        for name in used.counters:
            topic, _, path = name.rpartition(":")
            self._counters.setdefault(topic, []).append(path)
        self.limits: dict[tuple[str, str], float] = {}
        # Steps after longer times without a message are not judged.
        gaps_us = [longest_gap_us([time_us for time_us, _ in recording]) for recording in training]
        self._longest_step_s = 1e-6 * max(gaps_us)
        self.start()
        for recording in training:
            self._learn(recording)
        self.start()

    def start(self) -> None:
        """Reset the memory at the start of a recording."""
        self._mapper.start()
        self._last: dict[str, tuple[int, Mapping[str, float]]] = {}

    def _learn(self, recording: Sequence[tuple[int, State]]) -> None:
        """Raise the limits to the largest values of a normal recording, with a margin."""
        self.start()
        for time_us, state in recording:
            for made in self._mapper.made_of(state):
                for measure in self._measures(made, time_us):
                    key = measure.state, measure.name
                    self.limits[key] = max(self.limits.get(key, _FLOOR), SPEED_MARGIN * measure.value)
            self.accept(state, time_us)

    def check(self, state: State, time_us: int) -> Alarm | None:
        """Check a message; the alarm names the rule, the field, its value and the limit."""
        counter = self._wrong_counter(state)
        if counter is not None:
            return counter
        worst: RuleInput | None = None
        worst_ratio = 1.0
        for made in self._mapper.made_of(state):
            for measure in self._measures(made, time_us):
                limit = self.limits.get((measure.state, measure.name))
                if limit is not None and not measure.value <= limit * worst_ratio:
                    worst = measure
                    worst_ratio = measure.value / limit
        if worst is None:
            return None
        limit = self.limits[worst.state, worst.name]
        source = f"rule {DYNAMICS}, {worst.name} {worst.value:.3g}, limit {limit:.3g} {_UNITS[worst.name]}"
        field = self._mapper.name_of(f"{worst.state}.{worst.field}")
        return Alarm(source, state.spec.stage.value, score=max(worst_ratio, 1.0), fields=(field,), hard=True)

    def _wrong_counter(self, state: State) -> Alarm | None:
        """The alarm on a counter that falls, or grows by more than one."""
        topic = state.spec.name
        if topic not in self._counters or topic not in self._last:
            return None
        values = values_by_name(state)
        _, before = self._last[topic]
        for path in self._counters[topic]:
            growth = values[path] - before[path]
            is_wrapped = values[path] == 0.0 and before[path] > 0.0  # at the end of its range
            if growth not in (0.0, 1.0) and not is_wrapped:
                source = f"rule {COUNTERS}, counter {before[path]:g} -> {values[path]:g}"
                return Alarm(source, state.spec.stage.value, score=IMPLAUSIBLE, fields=(f"{topic}:{path}",), hard=True)
        return None

    def accept(self, state: State, time_us: int) -> None:
        """Record a message."""
        for made in self._mapper.made_of(state):
            self._last[made.spec.name] = time_us, values_by_name(made)
        self._last[state.spec.name] = time_us, values_by_name(state)
        self._mapper.accept(state)

    def memory(self) -> tuple[Any, Any]:
        """Memory between messages."""
        return dict(self._last), self._mapper.memory()

    def restore(self, memory: tuple[Any, Any]) -> None:
        """Inverse of `memory`."""
        self._last = dict(memory[0])
        self._mapper.restore(memory[1])

    def _measures(self, state: State, time_us: int) -> Iterator[RuleInput]:
        """All quantities of a state whose fields are mapped."""
        name = state.spec.name
        now = values_by_name(state)
        if self._mapper.has(name, _VELOCITY):
            yield RuleInput(name, "speed", _norm([now[axis] for axis in _VELOCITY]), _largest(now, _VELOCITY))
        if self._mapper.has(name, ("yaw_rate",)):
            yield RuleInput(name, "yaw rate", abs(now["yaw_rate"]), "yaw_rate")
        has_vehicle = _ODOMETRY in self._last and self._mapper.has(_ODOMETRY, _POSITION)
        if name != _ODOMETRY and has_vehicle and self._mapper.has(name, _POSITION):
            _, vehicle = self._last[_ODOMETRY]
            apart = {axis: now[axis] - vehicle[axis] for axis in _POSITION}
            yield RuleInput(name, "distance from the vehicle", _norm(apart.values()), _largest(apart, _POSITION))
        # Changes since the last message.
        if name not in self._last:
            return
        last_us, before = self._last[name]
        period_s = 1e-6 * (time_us - last_us)
        if not 0.0 < period_s <= self._longest_step_s:
            return
        if self._mapper.has(name, _VELOCITY):
            change = {axis: now[axis] - before[axis] for axis in _VELOCITY}
            yield RuleInput(name, "velocity change", _norm(change.values()), _largest(change, _VELOCITY))
        if self._mapper.has(name, _POSITION):
            step = {axis: now[axis] - before[axis] for axis in _POSITION}
            if self._mapper.has(name, _VELOCITY):
                for axis, speed in zip(_POSITION, _VELOCITY, strict=True):
                    step[axis] -= 0.5 * (now[speed] + before[speed]) * period_s
            yield RuleInput(name, "step along the velocity", _norm(step.values()), _largest(step, _POSITION))
        if self._mapper.has(name, _QUATERNION):
            change = {part: now[part] - before[part] for part in _QUATERNION}
            yield RuleInput(name, "turn", 2.0 * _norm(change.values()), _largest(change, _QUATERNION))


def _norm(components: Any) -> float:
    """Length of a vector; infinite where its square overflows."""
    return math.hypot(*components)


def _largest(values: Mapping[str, float], fields: Sequence[str]) -> str:
    """The field of the largest magnitude."""
    return max(fields, key=lambda name: abs(values[name]))
