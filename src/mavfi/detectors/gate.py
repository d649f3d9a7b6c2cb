"""Physics gate: checks against what a vehicle of this kind can do, without training; a separate alarm source."""

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from mavfi.detectors.detector import Alarm, Detector
from mavfi.detectors.features import integer_at, real_at
from mavfi.numerics.jit import entry, is_compiled, kernel_jit
from mavfi.numerics.stored import Stored, kind_of, load
from mavfi.states import STATES, State, bytes_of

SOURCE = "physics_gate"
SPEED_MARGIN = 1.5
"""Largest plausible speed / v_max: planned trajectories exceed v_max by less."""
STEP_MARGIN = 1.0
"""Allowance added to the step that the plausible speed covers between way-points of a trajectory (m)."""
LONGEST_TIME_TO_COLLISION = 100.0
"""Largest plausible time to collision (s); 30 s is published if there is none."""
LARGEST_YAW = 2.0 * math.pi
"""Largest plausible yaw (rad)."""
UNKNOWN_ARENA = ((-1e4, -1e4, -1e4), (1e4, 1e4, 1e4))
"""Bounds of positions if the arena is unknown (m)."""
IMPLAUSIBLE = 2.0
"""Score of an implausible publication."""
_FINE = -1
"""Index of no field: the publication is plausible."""

# ---- what is judged, and where its fields are ------------------------------------------------------------------------
STATES_JUDGED = ("perception.collision_status", "planning.waypoint", "control.command")
_SLOTS = {name: slot for slot, name in enumerate(STATES_JUDGED)}
_STATUS, _WAYPOINT, _COMMAND = range(3)
"""Slots of these states."""
_STATUS_SPEC = STATES["perception.collision_status"]
_STATUS_FIELDS = [field.name for field in _STATUS_SPEC.header]
_TIME_FIELD = _STATUS_FIELDS.index("time_to_collision")
_COUNTER_FIELD = _STATUS_FIELDS.index("future_collision_seq")
"""Indices of fields in the header of a collision status."""
_TIME_AT = _STATUS_SPEC.offset("time_to_collision")
_COUNTER_AT = _STATUS_SPEC.offset("future_collision_seq")
_NUMBER_AT = STATES["planning.waypoint"].offset("trajectory_seq")
"""Byte offsets in the headers of a collision status and of a way-point."""
_WAYPOINT_FLOATS = 11
_COMMAND_FLOATS = 5
"""Numbers of leading float64 fields of a way-point and of a command."""

# ---- arrays of the compiled functions --------------------------------------------------------------------------------
_SPEED = 0
_LOWER = 1
_UPPER = 4
"""Indices in the limits: largest speed (m/s), first coordinates of the corners of the arena (m)."""
_COUNTER, _COUNTED, _NUMBER, _NUMBERED, _POSITION = range(5)
"""Indices in the memory, see `judge`; the position has three elements."""
_ACCEPTED = 7
"""Size of the memory, and index of the accepted flag behind the next memory."""
_NAMES = ("future_collision_seq", "counted", "trajectory_seq", "numbered", "position")
"""Names of the parts of the memory, as sites of faults."""


@kernel_jit
def first_not_finite(values: np.ndarray) -> int:
    """Index of the first value that is not finite, or -1. `values` has shape (n,)."""
    for index in range(len(values)):
        if not math.isfinite(values[index]):
            return index
    return _FINE


@kernel_jit
def too_fast(velocity: np.ndarray, limit: float) -> int:
    """Index of the largest component of a velocity above the limit, or -1.

    Args:
        velocity: Finite (m/s); scaled internally, so that squares cannot overflow. Shape (3,).
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
    """Index of an implausible field, or -1.

    Args:
        values: vx, vy, vz (m/s), then further fields. Shape (>= 3,).
        limits: Largest speed (m/s), lower and upper corner of the arena (m). Shape (7,).
    """
    index = first_not_finite(values)
    return index if index >= 0 else too_fast(values[:3], limits[_SPEED])


@kernel_jit
def implausible_waypoint(values: np.ndarray, before: np.ndarray, limits: np.ndarray) -> int:
    """Index of an implausible field, or -1.

    Args:
        values: x, y, z (m), yaw (rad), velocity (m/s), acceleration (m/s^2), duration (s). Shape (11,).
        before: Position of the previous way-point of the same trajectory (m). Shape (3,), or (0,) if there is none.
        limits: As for `implausible_command`.
    """
    index = first_not_finite(values)
    if index >= 0:
        return index
    step = limits[_SPEED] * abs(values[10]) + STEP_MARGIN
    for axis in range(3):
        if not (limits[_LOWER + axis] <= values[axis] <= limits[_UPPER + axis]):
            return axis
        if len(before) == 3 and not (abs(values[axis] - before[axis]) <= step):
            return axis
    if not (abs(values[3]) <= LARGEST_YAW):
        return 3
    index = too_fast(values[4:7], limits[_SPEED])
    return _FINE if index < 0 else index + 4


@kernel_jit
def judge(content: np.ndarray, slot: int, limits: np.ndarray, memory: np.ndarray, next_memory: np.ndarray) -> int:
    """Index of an implausible header field, or -1.

    Args:
        content: Bytes of the header. Shape (size,), uint8.
        slot: Index of its state in `STATES_JUDGED`.
        limits: As for `implausible_command`.
        memory: Memory between publications: collision counter, whether it is known, trajectory number of the last
            way-point, whether that is known, position of that way-point (m). Shape (7,).
        next_memory: Memory if this publication is accepted, then the accepted flag. The next call commits it, so that
            each publication costs one call. Shape (8,).
    """
    settle(memory, next_memory)
    if slot == _STATUS:
        time, counter = real_at(content, _TIME_AT), integer_at(content, _COUNTER_AT)
        next_memory[_COUNTER], next_memory[_COUNTED] = counter, 1.0
        if not (0.0 <= time <= LONGEST_TIME_TO_COLLISION):
            return _TIME_FIELD
        growth = counter - memory[_COUNTER]
        return _FINE if memory[_COUNTED] == 0.0 or 0.0 <= growth <= 1.0 else _COUNTER_FIELD
    if slot == _COMMAND:
        return implausible_command(content[: 8 * _COMMAND_FLOATS].view(np.float64), limits)
    values, number = content[: 8 * _WAYPOINT_FLOATS].view(np.float64), integer_at(content, _NUMBER_AT)
    next_memory[_NUMBER], next_memory[_NUMBERED], next_memory[_POSITION:_ACCEPTED] = number, 1.0, values[:3]
    same = memory[_NUMBERED] != 0.0 and memory[_NUMBER] == number
    return implausible_waypoint(values, memory[_POSITION : _ACCEPTED if same else _POSITION], limits)


@kernel_jit
def settle(memory: np.ndarray, next_memory: np.ndarray) -> None:
    """Commit the publication judged last if it was accepted; arguments as for `judge`."""
    if next_memory[_ACCEPTED] != 0.0:
        memory[:] = next_memory[:_ACCEPTED]
    next_memory[:_ACCEPTED], next_memory[_ACCEPTED] = memory, 0.0


_KIND = kind_of(np.zeros(1), np.zeros(1), np.zeros(1))


@kernel_jit
def _judge_at(content: np.ndarray, slot: int, address: int) -> int:
    """`judge` with the address of its other arguments, see `numerics.stored`."""
    limits, memory, next_memory = load(address, _KIND)
    return judge(content, slot, limits, memory, next_memory)


class PhysicsGate(Detector):
    """Checks for finite numbers, the arena, speeds, way-point steps, and a collision counter that grows by 0 or 1.

    An implausible field is an alarm for the stage that publishes it.

    Args:
        v_max: Speed limit of the mission (m/s).
        arena: Lower and upper corner of the volume for way-points (m).
    """

    source = SOURCE
    states = frozenset(STATES_JUDGED)

    def __init__(self, v_max: float, arena: tuple[tuple[float, ...], tuple[float, ...]] = UNKNOWN_ARENA) -> None:
        self._arguments = v_max, arena
        self._limits = np.array([SPEED_MARGIN * v_max, *arena[0], *arena[1]], np.float64)
        self._memory = np.zeros(_ACCEPTED)
        self._next_memory = np.zeros(_ACCEPTED + 1)
        self._candidate: State | None = None
        self.instrument({})

    @property
    def compiled(self) -> Mapping[str, Callable[..., Any]]:
        """See `Detector`."""
        return {"judge_gate": judge}

    def instrument(self, instrumented: Mapping[str, Callable[..., Any]]) -> None:
        """See `Detector`."""
        function: Callable[..., int] = instrumented.get("judge_gate", judge)
        arrays = self._limits, self._memory, self._next_memory
        self._stored = Stored(_KIND, *arrays)
        self._address = self._stored.address
        if is_compiled(function):
            self._judge: Callable[..., int] = entry(_judge_at, np.zeros(1, np.uint8), 0, 0)
        else:
            self._judge = lambda content, slot, _: function(content, slot, *arrays)

    def start(self) -> None:
        """Reset the memory at the start of a flight."""
        self._candidate = None
        self._memory[:] = 0.0
        self._next_memory[:] = 0.0

    def check(self, state: State, time_us: int) -> Alarm | None:
        """Check a publication."""
        slot = _SLOTS.get(state.spec.name)
        if slot is None:
            return None
        self._candidate = state
        field_index = self._judge(bytes_of(state.header), slot, self._address)
        if field_index < 0:
            return None
        spec = state.spec
        field = f"{spec.name}.{spec.header[field_index].name}"
        return Alarm(SOURCE, spec.stage.value, score=IMPLAUSIBLE, fields=(field,))

    def score(self, state: State, time_us: int) -> float | None:
        """2 for an implausible publication, else 0; None for states that are not checked."""
        if state.spec.name not in _SLOTS:
            return None
        if self.check(state, time_us) is None:
            return 0.0
        return IMPLAUSIBLE

    def accept(self, state: State, time_us: int) -> None:
        """Record a published value."""
        if state is not self._candidate:
            if state.spec.name not in _SLOTS:
                return
            self.check(state, time_us)
        self._next_memory[_ACCEPTED] = 1.0

    def memory(self) -> bytes:
        """Memory between publications, see `Detector`."""
        settle(self._memory, self._next_memory)
        self._candidate = None
        return self._memory.tobytes()

    def restore(self, memory: bytes) -> None:
        """Inverse of `memory`."""
        self.start()
        self._memory[:] = np.frombuffer(memory)

    def arrays(self) -> dict[str, np.ndarray]:
        """Memory between publications by name, see `Detector`."""
        self.memory()
        return dict(zip(_NAMES, np.split(self._memory, range(_COUNTED, _POSITION + 1)), strict=True))

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle without machine code, which is valid in one process only."""
        return PhysicsGate, self._arguments, self.memory()

    __setstate__ = restore
