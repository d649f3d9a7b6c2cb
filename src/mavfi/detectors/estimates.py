"""Rule of the estimated odometry: its motion stays within the IMU's range and the corrections by position fixes.

The limits are those of an error-state Kalman filter with gated fixes, for arbitrary inputs: sensor failures do not
violate the rule, since recomputation from the same inputs would not repair them.  Only flights with an estimator have
this rule and its memory.
"""

import math

import numpy as np

from mavfi.detectors.gate import first_not_finite, too_fast
from mavfi.detectors.limits import MissionLimits
from mavfi.detectors.rules import EXACT, FINE, outside
from mavfi.kernels.perception.state_estimation import GATE, GRAVITY, LARGEST_FORCE, LARGEST_RATE
from mavfi.numerics.jit import kernel_jit
from mavfi.states import ODOMETRY

ESTIMATE = ODOMETRY["estimator"]
"""The state that is checked."""
FIX = "sensor.position"
"""The state that corrects it."""
VELOCITY = 3
"""First column of the velocity (m/s)."""
ATTITUDE = 6
"""First column of the quaternion."""
WIDTH = 10
"""Number of leading columns that consumers read."""
_ACCELERATION = math.sqrt(3.0) * LARGEST_FORCE + GRAVITY
"""Largest acceleration in a step of the filter: that of a sample in the corner of the sensor's range (m/s^2)."""
_RATE = math.sqrt(3.0) * LARGEST_RATE
"""Largest turn rate in a step of the filter: that of a sample in the corner of the gyro's range (rad/s)."""
_VELOCITY_JUMP = 1.0
_TILT_JUMP = 0.1
"""Largest corrections of velocity (m/s) and tilt (rad) by a fix.

In golden flights of both profiles in four environments, also with 0.001 to 20 times the shipped noise of fixes and up
to 100 times that of the IMU, the largest are 0.32 m/s and 0.01 rad.
"""
_SETTLING_US = 3_000_000
"""Time after re-initialization at a fix in which further fixes may correct velocity and attitude by any amount: the
filter has no information on them."""
_NEVER = -(1 << 62)
"""Instant of what has not happened yet (us)."""
RECORD = np.dtype(
    [
        ("jump", "f8"),
        ("turn", "f8"),
        ("lower", "f8", (3,)),
        ("upper", "f8", (3,)),
        ("speed", "f8"),
        ("last", "f8", (WIDTH,)),
        ("time_us", "i8"),
        ("aligned_us", "i8"),
        ("fix", "f8", (4,)),
    ]
)
"""Limits: the largest correction of position (m) and attitude (rad) by a fix, flight box (m), speed (m/s).  Memory: the
last published estimate, its time, time of the last re-initialization in flight (us), the last fix (m, rad)."""


@kernel_jit
def judge_estimate(content: np.ndarray, now: int, record: np.ndarray) -> int:
    """Index of the field of an estimate that violates the rule, or -1.

    See docs/reference/detectors.md: finite values, unit quaternion; flight box and speed for the first estimate; IMU
    range and corrections by fixes for later ones.

    Args:
        content: Bytes of the header: position (m), velocity (m/s), quaternion.  Shape (>= 80,), uint8.
        now: Instant (us).
        record: See `RECORD`.  Shape (1,).
    """
    new = content.view(np.float64)
    memory = record[0]
    field = first_not_finite(new[:WIDTH])
    if field >= 0:
        return field
    norm = 0.0
    dot = 0.0
    for axis in range(ATTITUDE, WIDTH):
        norm += new[axis] ** 2
        dot += new[axis] * memory["last"][axis]
    if not abs(norm - 1.0) <= EXACT:
        return _turned(new, memory["last"])
    # Without a predecessor only the flight box and the speed limit are known.
    if memory["time_us"] == _NEVER or first_not_finite(memory["last"]) >= 0:
        return _first(new, record)
    elapsed = 1e-6 * max(now - memory["time_us"], 0)
    field = _moved(new, elapsed, record)
    if field >= 0 or _settling(new, now, record):
        return field
    angle = 0.5 * (memory["turn"] + _RATE * elapsed)
    if not 1.0 - dot * dot <= angle * angle:  # sin^2 of half the angle between them
        return _turned(new, memory["last"])
    return _accelerated(new, elapsed, record)


@kernel_jit
def _first(new: np.ndarray, record: np.ndarray) -> int:
    """Field in which an estimate without a predecessor lies outside the flight box or is too fast, or -1."""
    axis = outside(new[:3], record[0]["lower"], record[0]["upper"])
    if axis >= 0:
        return axis
    axis = too_fast(new[VELOCITY:ATTITUDE], record[0]["speed"])
    return axis if axis < 0 else VELOCITY + axis


@kernel_jit
def _moved(new: np.ndarray, elapsed: float, record: np.ndarray) -> int:
    """Axis along which a position is near neither the one predicted from the last velocity nor the last fix, or -1."""
    memory = record[0]
    reach = memory["jump"] + 0.5 * _ACCELERATION * elapsed**2
    for axis in range(3):
        predicted = memory["last"][axis] + memory["last"][VELOCITY + axis] * elapsed
        if not (abs(new[axis] - predicted) <= reach or abs(new[axis] - memory["fix"][axis]) <= memory["jump"]):
            return axis
    return FINE


@kernel_jit
def _accelerated(new: np.ndarray, elapsed: float, record: np.ndarray) -> int:
    """Column of a velocity that changes by more than the IMU's range and a fix allow, or -1."""
    for axis in range(VELOCITY, ATTITUDE):
        if not abs(new[axis] - record[0]["last"][axis]) <= _VELOCITY_JUMP + _ACCELERATION * elapsed:
            return axis
    return FINE


@kernel_jit
def _settling(new: np.ndarray, now: int, record: np.ndarray) -> bool:
    """Whether the filter was re-initialized at a fix within `_SETTLING_US`, or is with this estimate."""
    return _aligned(new, record) or now - record[0]["aligned_us"] <= _SETTLING_US


@kernel_jit
def _aligned(new: np.ndarray, record: np.ndarray) -> bool:
    """Whether a position is bit-identical to the last fix, as only that of a re-initialized filter is."""
    for axis in range(3):
        if new[axis] != record[0]["fix"][axis]:
            return False
    return True


@kernel_jit
def _turned(new: np.ndarray, last: np.ndarray) -> int:
    """The component of a quaternion that differs most from the last one; a filter never negates all of it."""
    component, largest = ATTITUDE, -1.0
    for axis in range(ATTITUDE, WIDTH):
        change = abs(new[axis] - last[axis])
        if change > largest:
            component, largest = axis, change
    return component


@kernel_jit
def note_estimate(content: np.ndarray, now: int, record: np.ndarray) -> None:
    """Record an estimate published at `now` (us)."""
    memory = record[0]
    new = content.view(np.float64)
    if memory["time_us"] != _NEVER and _aligned(new, record):
        memory["aligned_us"] = now
    memory["time_us"] = now
    for column in range(WIDTH):
        memory["last"][column] = new[column]


@kernel_jit
def note_fix(content: np.ndarray, record: np.ndarray) -> None:
    """Record a fix: position (m) and heading (rad)."""
    fix = content.view(np.float64)
    for column in range(4):
        record[0]["fix"][column] = fix[column]


def new_record(limits: MissionLimits) -> np.ndarray:
    """The record at the start of a flight.  Shape (1,)."""
    position, heading = limits.fix_noise or (0.0, 0.0)
    record = np.zeros(1, RECORD)
    numbers = limits.numbers()
    record["jump"] = math.sqrt(GATE) * position
    record["turn"] = math.sqrt(GATE) * heading + _TILT_JUMP
    for name in ("lower", "upper", "speed"):
        record[name] = numbers[name]
    forget(record)
    return record


def forget(record: np.ndarray) -> None:
    """Reset the memory at the start of a flight."""
    record["last"] = 0.0
    record["fix"] = np.nan
    record["time_us"] = record["aligned_us"] = _NEVER


def named_memory(record: np.ndarray) -> dict[str, np.ndarray]:
    """The memory by name: the arrays themselves, not copies."""
    return {f"estimate.{name}": record[name].reshape(-1) for name in ("last", "time_us", "aligned_us", "fix")}
