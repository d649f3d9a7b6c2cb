"""The physics gate: what no vehicle of this kind can do, known without training.  It is its own source of alarms."""

import math
from collections.abc import Callable

import numpy as np

from mavfi.detectors.parts import Reading, Scorer, ScoringDetector, Threshold, Verdict
from mavfi.numerics.jit import kernel_jit
from mavfi.states import STATES, State, StateSpec, floats

SOURCE = "physics_gate"
SPEED_MARGIN = 1.5
"""Largest plausible speed / v_max: planned trajectories may exceed v_max by less."""
STEP_MARGIN = 1.0
"""Largest step between way-points of a trajectory beyond what the plausible speed covers (m)."""
LONGEST_TIME_TO_COLLISION = 100.0
"""Largest plausible time to collision (s); published as 30 s when there is none."""
LARGEST_YAW = 2.0 * math.pi
"""Largest plausible yaw (rad)."""
UNKNOWN_ARENA = ((-1e4, -1e4, -1e4), (1e4, 1e4, 1e4))
"""Bounds of positions where the arena is not known (m)."""
IMPLAUSIBLE = 2.0
"""Score of what cannot be."""
_FINE = -1
_WAYPOINT_FLOATS, _COMMAND_FLOATS = 11, 5
_SPEED, _LOWER, _UPPER = 0, 1, 4
_SEQUENCE, _TRAJECTORY = 0, 1


@kernel_jit
def first_not_finite(values: np.ndarray) -> int:
    """Index of the first value that is not finite, or -1. `values` has shape (n,)."""
    for index in range(len(values)):
        if not math.isfinite(values[index]):
            return index
    return _FINE


@kernel_jit
def too_fast(velocity: np.ndarray, limit: float) -> int:
    """Index of the largest component of a velocity that is too large, or -1.

    Args:
        velocity: Finite (m/s); scaled, so that squares cannot overflow. Shape (3,).
        limit: Largest speed (m/s).
    """
    largest = 0
    for axis in range(1, 3):
        if abs(velocity[axis]) > abs(velocity[largest]):
            largest = axis
    scale = abs(velocity[largest])
    if not (scale > 0.0):
        return _FINE
    total = 0.0
    for axis in range(3):
        total += (velocity[axis] / scale) ** 2
    return _FINE if scale * math.sqrt(total) <= limit else largest


@kernel_jit
def implausible_command(values: np.ndarray, limits: np.ndarray) -> int:
    """Index of a field that cannot be right, or -1.

    Args:
        values: vx, vy, vz (m/s), then others. Shape (>= 3,).
        limits: Largest speed (m/s), lower and upper corner of the arena (m). Shape (7,).
    """
    found = first_not_finite(values)
    return found if found >= 0 else too_fast(values[:3], limits[_SPEED])


@kernel_jit
def implausible_waypoint(values: np.ndarray, before: np.ndarray, limits: np.ndarray) -> int:
    """Index of a field that cannot be right, or -1.

    Args:
        values: x, y, z (m), yaw (rad), velocity (m/s), acceleration (m/s^2), duration (s). Shape (11,).
        before: Position of the way-point before it on the same trajectory (m). Shape (3,), or (0,) if there is none.
        limits: As of `implausible_command`.
    """
    found = first_not_finite(values)
    if found >= 0:
        return found
    step = limits[_SPEED] * abs(values[10]) + STEP_MARGIN
    for axis in range(3):
        if not (limits[_LOWER + axis] <= values[axis] <= limits[_UPPER + axis]):
            return axis
        if len(before) == 3 and not (abs(values[axis] - before[axis]) <= step):
            return axis
    if not (abs(values[3]) <= LARGEST_YAW):
        return 3
    found = too_fast(values[4:7], limits[_SPEED])
    return _FINE if found < 0 else found + 4


class PlausibilityScorer(Scorer):
    """Finite numbers, the arena, speeds, steps of way-points, a collision counter that goes up by 0 or 1.

    A field is IMPLAUSIBLE away from what can be, or 0.

    Args:
        v_max: Speed limit of the mission (m/s).
        arena: Lower and upper corner that way-points must stay within (m).
    """

    def __init__(self, v_max: float, arena: tuple[tuple[float, ...], tuple[float, ...]]) -> None:
        self._limits = np.array([SPEED_MARGIN * v_max, *arena[0], *arena[1]], np.float64)
        self._rules: dict[str, Callable[[State], int]] = {
            "perception.collision_status": self._judge_status,
            "planning.waypoint": self._judge_waypoint,
            "control.command": self._judge_command,
        }
        watched = [(STATES[name], field.name) for name in self._rules for field in STATES[name].header]
        self.fields = tuple(f"{spec.name}.{field}" for spec, field in watched)
        self.stages = tuple(spec.stage.value for spec, _ in watched)
        owners = [spec.name for spec, _ in watched]
        self._ranges = {name: (owners.index(name), owners.index(name) + owners.count(name)) for name in self._rules}
        self._distance, self._unit = np.zeros(len(owners)), np.ones(len(owners))
        self._known, self._numbers, self._position = np.zeros(2, bool), np.zeros(2, np.int64), np.zeros(3)
        self.kept = self._known, self._numbers, self._position

    def read(self, state: State) -> Reading | None:
        """Measure a publication."""
        rule = self._rules.get(state.spec.name)
        if rule is None:
            return None
        first, last = self._ranges[state.spec.name]
        self._distance[first:last] = 0.0
        found = rule(state)
        if found >= 0:
            self._distance[first + found] = IMPLAUSIBLE
        return Reading(self._distance, self._unit, first, last, 0)

    def accept(self, state: State, verdict: Verdict | None) -> None:
        """Take note of a value that was published."""
        if state.spec.name == "perception.collision_status":
            self._known[_SEQUENCE], self._numbers[_SEQUENCE] = True, state.header["future_collision_seq"][0]
        elif state.spec.name == "planning.waypoint":
            self._known[_TRAJECTORY], self._numbers[_TRAJECTORY] = True, state.header["trajectory_seq"][0]
            self._position[:] = floats(state.header, 3)

    def _judge_status(self, state: State) -> int:
        if not (0.0 <= float(state.header["time_to_collision"][0]) <= LONGEST_TIME_TO_COLLISION):
            return _index(state.spec, "time_to_collision")
        step = int(state.header["future_collision_seq"][0]) - int(self._numbers[_SEQUENCE])
        return _FINE if step in (0, 1) or not self._known[_SEQUENCE] else _index(state.spec, "future_collision_seq")

    def _judge_waypoint(self, state: State) -> int:
        same = self._known[_TRAJECTORY] and self._numbers[_TRAJECTORY] == state.header["trajectory_seq"][0]
        before = self._position if same else self._position[:0]
        return int(implausible_waypoint(floats(state.header, _WAYPOINT_FLOATS), before, self._limits))

    def _judge_command(self, state: State) -> int:
        return int(implausible_command(floats(state.header, _COMMAND_FLOATS), self._limits))


class PhysicsGate(ScoringDetector):
    """What cannot be is an alarm for its own stage; arguments as of `PlausibilityScorer`."""

    def __init__(self, v_max: float, arena: tuple[tuple[float, ...], tuple[float, ...]] = UNKNOWN_ARENA) -> None:
        scorer = PlausibilityScorer(v_max, arena)
        size = len(scorer.fields)
        super().__init__(SOURCE, scorer, Threshold(np.ones((size, 1)), size))


def _index(spec: StateSpec, field: str) -> int:
    return [candidate.name for candidate in spec.header].index(field)
