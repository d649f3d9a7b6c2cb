"""PID tracking with feed-forward (the paper's kernel "PID"): way-point in force -> velocity and yaw-rate command."""

import math
from typing import NamedTuple

import numpy as np

from mavfi.numerics.elementary import atan2, cos, sin
from mavfi.numerics.jit import kernel_jit

MEMORY_WIDTH = 7
"""Memory: integral (3, m s), last error (3, m), whether there is a last error."""
_YAW_GAIN = 3.0
_HUGE = 1e150


class Gains(NamedTuple):
    """Gains and limits of the tracker.

    Attributes:
        p: Proportional gain (1/s). Shape (3,).
        i: Integral gain (1/s^2). Shape (3,).
        d: Derivative gain (-). Shape (3,).
        integral_limit: Limit of the integral (m s).
        velocity: Feed-forward gain of the reference velocity.
        acceleration: Feed-forward gain of the reference acceleration (s).
        limit: Largest commanded speed (m/s).
        slowdown_cap: Largest slow-down of reference time during saturation; 1 = none.
        yaw_rate: Largest yaw rate (rad/s).
    """

    p: np.ndarray
    i: np.ndarray
    d: np.ndarray
    integral_limit: float
    velocity: float
    acceleration: float
    limit: float
    slowdown_cap: float
    yaw_rate: float


@kernel_jit
def _saturate(command: np.ndarray, limit: float) -> float:
    """Scale a velocity down to `limit` if it exceeds it; returns the factor of the excess (1 = none)."""
    largest = max(abs(command[0]), max(abs(command[1]), abs(command[2])))
    if math.isnan(command[0] + command[1] + command[2]):
        largest = np.nan  # `max` checks only its first argument for NaN
    if not largest <= _HUGE:  # its square would overflow; NaN propagates and is rejected by the flight controller
        for axis in range(3):
            command[axis] /= largest
        norm = math.sqrt(command[0] ** 2 + command[1] ** 2 + command[2] ** 2)
        for axis in range(3):
            command[axis] *= limit / norm
        return _HUGE
    norm = math.sqrt(command[0] ** 2 + command[1] ** 2 + command[2] ** 2)
    if norm <= limit:
        return 1.0
    for axis in range(3):
        command[axis] *= limit / norm
    return norm / limit


@kernel_jit
def _anti_windup(integral: float, limit: float) -> float:
    """Clamp the integral; NaN is reset, since it would never vanish."""
    if integral > limit:
        return limit
    if integral < -limit:
        return -limit
    return 0.0 if math.isnan(integral) else integral


@kernel_jit
def track(
    waypoint: np.ndarray, odometry: np.ndarray, memory: np.ndarray, gains: Gains, dt: float, command: np.ndarray
) -> float:
    """One step of the tracker.

    Args:
        waypoint: Way-point in force: x y z yaw v(3) a(3) duration, world frame. Shape (11,).
        odometry: x y z v(3) quaternion wxyz, ..., world frame. Shape (13,).
        memory: See `MEMORY_WIDTH`; changed. Shape (7,).
        gains: Gains and limits.
        dt: Control period (s).
        command: Output: velocity, world frame (m/s), and yaw rate (rad/s). Shape (4,).

    Returns:
        Slow-down of reference time, 1 .. gains.slowdown_cap.
    """
    for axis in range(3):
        error = waypoint[axis] - odometry[axis]
        memory[axis] = _anti_windup(memory[axis] + error * dt, gains.integral_limit)
        rate = (error - memory[3 + axis]) / dt if memory[6] > 0.0 else 0.0
        if not abs(rate) < _HUGE:
            rate = 0.0
        memory[3 + axis] = error
        # without a gain the acceleration is not read: 0 x inf would be NaN
        lead = gains.acceleration * waypoint[7 + axis] if gains.acceleration != 0.0 else 0.0
        command[axis] = (
            gains.velocity * waypoint[4 + axis]
            + lead
            + gains.p[axis] * error
            + gains.i[axis] * memory[axis]
            + gains.d[axis] * rate
        )
    memory[6] = 1.0
    slowdown = _saturate(command, gains.limit)
    w, x, y, z = odometry[6], odometry[7], odometry[8], odometry[9]
    yaw = atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    turn = atan2(sin(waypoint[3] - yaw), cos(waypoint[3] - yaw))
    command[3] = min(gains.yaw_rate, max(-gains.yaw_rate, _YAW_GAIN * turn))
    return min(slowdown, gains.slowdown_cap)
