"""The physics gate: what no vehicle of this kind can do, known without training.  It is its own source of alarms."""

import math
from typing import Any

import numpy as np

from mavfi.detectors.detector import Alarm
from mavfi.detectors.features import integer_at, real_at
from mavfi.numerics.jit import entry, kernel_jit
from mavfi.states import STATES, State, bytes_of, new_state

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
STATES_JUDGED = ("perception.collision_status", "planning.waypoint", "control.command")
_SLOTS = {name: slot for slot, name in enumerate(STATES_JUDGED)}
_STATUS, _WAYPOINT, _COMMAND = range(3)
_COUNTER, _COUNTED, _NUMBER, _NUMBERED, _POSITION = range(5)
_ACCEPTED = 7


def _places(slot: int, *names: str) -> list[int]:
    """Byte offsets of fields of a header, and then their places."""
    dtype = STATES[STATES_JUDGED[slot]].header_dtype
    known = list(dtype.names or ())
    return [
        *(sum(dtype[name].itemsize for name in known[: known.index(own)]) for own in names),
        *map(known.index, names),
    ]


_TIME_AT, _COUNTER_AT, _TIME_FIELD, _COUNTER_FIELD = _places(_STATUS, "time_to_collision", "future_collision_seq")
_NUMBER_AT, _ = _places(_WAYPOINT, "trajectory_seq")


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


@kernel_jit
def judge(content: np.ndarray, slot: int, limits: np.ndarray, kept: np.ndarray, then: np.ndarray) -> int:
    """Index of a field of a header that cannot be right, or -1.

    Args:
        content: Bytes of the header. Shape (size,), uint8.
        slot: Place of its state in `STATES_JUDGED`.
        limits: As of `implausible_command`.
        kept: What is remembered: collision counter and whether it is known, the same of the number of the last
            way-point's trajectory, and that way-point's position (m). Shape (7,).
        then: What will be remembered if this is accepted, and whether it was: then it is with the next call, so that
            there is one call for each publication. Shape (8,).
    """
    settle(kept, then)
    if slot == _STATUS:
        time, counter = real_at(content, _TIME_AT), integer_at(content, _COUNTER_AT)
        then[_COUNTER], then[_COUNTED] = counter, 1.0
        if not (0.0 <= time <= LONGEST_TIME_TO_COLLISION):
            return _TIME_FIELD
        growth = counter - kept[_COUNTER]
        return _FINE if kept[_COUNTED] == 0.0 or 0.0 <= growth <= 1.0 else _COUNTER_FIELD
    if slot == _COMMAND:
        return implausible_command(content[: 8 * _COMMAND_FLOATS].view(np.float64), limits)
    values, number = content[: 8 * _WAYPOINT_FLOATS].view(np.float64), integer_at(content, _NUMBER_AT)
    then[_NUMBER], then[_NUMBERED], then[_POSITION:_ACCEPTED] = number, 1.0, values[:3]
    same = kept[_NUMBERED] != 0.0 and kept[_NUMBER] == number
    return implausible_waypoint(values, kept[_POSITION : _ACCEPTED if same else _POSITION], limits)


@kernel_jit
def settle(kept: np.ndarray, then: np.ndarray) -> None:
    """Remember what was judged last, if it was accepted; arguments as of `judge`."""
    if then[_ACCEPTED] != 0.0:
        kept[:] = then[:_ACCEPTED]
    then[:_ACCEPTED], then[_ACCEPTED] = kept, 0.0


class PhysicsGate:
    """Finite numbers, the arena, speeds, steps of way-points, a collision counter that goes up by 0 or 1.

    What cannot be is an alarm for its own stage.

    Args:
        v_max: Speed limit of the mission (m/s).
        arena: Lower and upper corner that way-points must stay within (m).

    Attributes:
        states: Names of the states that it is to be shown.
    """

    states = frozenset(STATES_JUDGED)

    def __init__(self, v_max: float, arena: tuple[tuple[float, ...], tuple[float, ...]] = UNKNOWN_ARENA) -> None:
        self._given = v_max, arena
        self._limits = np.array([SPEED_MARGIN * v_max, *arena[0], *arena[1]], np.float64)
        self._kept, self._then = np.zeros(_ACCEPTED), np.zeros(_ACCEPTED + 1)
        self._candidate: State | None = None
        content = bytes_of(new_state(STATES_JUDGED[_WAYPOINT]).header)
        self._judge = entry(judge, content, _WAYPOINT, self._limits, self._kept, self._then)

    def start(self) -> None:
        """Forget the last flight."""
        self._candidate = None
        self._kept[:], self._then[:] = 0.0, 0.0

    def check(self, state: State, time_us: int) -> Alarm | None:
        """Judge a publication."""
        slot = _SLOTS.get(state.spec.name)
        if slot is None:
            return None
        self._candidate = state
        place = self._judge(bytes_of(state.header), slot, self._limits, self._kept, self._then)
        if place < 0:
            return None
        spec = state.spec
        return Alarm(SOURCE, spec.stage.value, score=IMPLAUSIBLE, fields=(f"{spec.name}.{spec.header[place].name}",))

    def score(self, state: State, time_us: int) -> float | None:
        """2 of what cannot be, else 0; None of states that are not judged."""
        if state.spec.name not in _SLOTS:
            return None
        return 0.0 if self.check(state, time_us) is None else IMPLAUSIBLE

    def accept(self, state: State, time_us: int) -> None:
        """Take note of a value that was published."""
        if state is not self._candidate:
            if state.spec.name not in _SLOTS:
                return
            self.check(state, time_us)
        self._then[_ACCEPTED] = 1.0

    def memory(self) -> bytes:
        """What is remembered, see `Detector`."""
        settle(self._kept, self._then)
        self._candidate = None
        return self._kept.tobytes()

    def restore(self, memory: bytes) -> None:
        """Inverse of `memory`."""
        self.start()
        self._kept[:] = np.frombuffer(memory)

    def __reduce__(self) -> tuple[Any, ...]:
        """Machine code stays in its process."""
        return PhysicsGate, self._given, self.memory()

    __setstate__ = restore
