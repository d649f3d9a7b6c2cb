"""Rules for way-point in force, command and tracking report.  Return values and limits as in `rules`."""

import math

import numpy as np

from mavfi.detectors.rules import ACCELERATION, DURATION, EXACT, FINE, VELOCITY, YAW, places
from mavfi.numerics.jit import kernel_jit

_LARGEST_YAW_RATE = 1.5708
_LARGEST_HELD_YAW = 4.0
"""Largest yaw of a stationary vehicle, including its turns to look around (rad)."""
_WINDOW = 50
"""Number of leading points of a new trajectory among which an interpolated reference may start."""
_FOLLOWED, _FOLLOWED_EPOCH, _INDEX = places("planning.waypoint", "trajectory_seq", "future_collision_seq", "index")
_YAW_RATE, _COMMAND_DURATION = places("control.command", "yaw_rate", "duration")
(_REMAINING,) = places("control.tracking", "remaining")


@kernel_jit
def waypoint(
    values: np.ndarray, header: np.ndarray, before: np.ndarray, newest: np.ndarray, points: np.ndarray,
    vehicle: np.ndarray, limits: np.ndarray,
) -> int:  # fmt: skip
    """Way-point: the next point of a published trajectory, or a hold where the vehicle comes to rest (m).

    Args:
        values: Position, yaw, velocity, acceleration, duration. Shape (11,).
        header: Header of the way-point. Shape (1,).
        before: Header of the last published way-point. Shape (1,).
        newest: Header of the last published trajectory. Shape (1,).
        points: Points of the trajectory that it names. Shape (n, 11), or (0, 11) if that number is unknown.
        vehicle: Position (m) and velocity (m/s). Shape (6,).
        limits: See `rules`.
    """
    new, old, limit = header[0], before[0], limits[0]
    number, index, epoch = int(new["trajectory_seq"]), int(new["index"]), int(new["future_collision_seq"])
    earlier = int(old["future_collision_seq"])
    if not limit["every_map"] and not (earlier <= epoch <= max(earlier, int(newest[0]["future_collision_seq"]))):
        return _FOLLOWED_EPOCH
    if index < 0 or len(points) == 0:
        if index == -1:
            return hold(values, vehicle, limits) if number == 0 else _FOLLOWED
        return _FOLLOWED if len(points) == 0 and number != 0 else _INDEX
    same = number == int(old["trajectory_seq"]) and int(old["index"]) >= 0
    least = int(old["index"]) if same else 0
    most = least + 1 if same else _WINDOW - 1
    if limit["held"]:
        least = most = least + 1 if same else 0
    if not least <= index <= min(most, len(points) - 1):
        return _INDEX
    if limit["held"]:
        return copied(values, points[index])
    return between(values, points[index], points[min(index + 1, len(points) - 1)], limits)


@kernel_jit
def hold(values: np.ndarray, vehicle: np.ndarray, limits: np.ndarray) -> int:
    """Column in which a hold is not at rest (m/s, m/s^2) at the stopping point (m), or -1. Shapes (11,), (6,)."""
    limit = limits[0]
    for axis in range(3):
        if not abs(values[axis] - vehicle[axis] - limit["lag"] * vehicle[3 + axis]) <= limit["hold"]:
            return axis
    if not abs(values[YAW]) <= _LARGEST_HELD_YAW:
        return YAW
    for column in range(VELOCITY, DURATION):
        if values[column] != 0.0:
            return column
    return FINE if values[DURATION] == limit["point_period"] else DURATION


@kernel_jit
def copied(values: np.ndarray, other: np.ndarray) -> int:
    """First column that differs, or -1. Shapes (11,)."""
    for column in range(len(other)):
        if values[column] != other[column]:
            return column
    return FINE


@kernel_jit
def between(values: np.ndarray, start: np.ndarray, end: np.ndarray, limits: np.ndarray) -> int:
    """Column in which an interpolated way-point does not lie between two points, or -1.

    The reference clock may be slowed.  Yaw and duration are those of the first point; changes of the clock rate add
    acceleration (m/s^2). Shapes (11,).
    """
    for axis in range(3):
        low, high = min(start[axis], end[axis]), max(start[axis], end[axis])
        if not (low - EXACT <= values[axis] <= high + EXACT):
            return axis
        column = VELOCITY + axis
        low, high = min(start[column], end[column]), max(start[column], end[column])
        if not (min(low, 0.0) - EXACT <= values[column] <= max(high, 0.0) + EXACT):
            return column
        column = ACCELERATION + axis
        if not abs(values[column]) <= abs(start[column]) + limits[0]["clock"]:
            return column
    if values[YAW] != start[YAW]:
        return YAW
    return FINE if values[DURATION] == start[DURATION] else DURATION


@kernel_jit
def command(header: np.ndarray, before: np.ndarray, switched: bool, limits: np.ndarray) -> int:
    """Command: velocity (m/s) and yaw rate (rad/s) within their limits, for one control period (s).

    While a held way-point stays in force, the velocity changes little.

    Args:
        header: Header of the command; extracting a plain vector would cost as much as the rule. Shape (1,).
        before: Header of the last published command. Shape (1,).
        switched: Whether a way-point has been published since.
        limits: See `rules`.
    """
    new, old, limit = header[0], before[0], limits[0]
    x, y, z = new["vx"], new["vy"], new["vz"]
    if not x * x + y * y + z * z <= limit["command"] ** 2:
        return _largest(x, y, z)
    if not abs(new["yaw_rate"]) <= _LARGEST_YAW_RATE:
        return _YAW_RATE
    if new["duration"] != limit["control_period"]:
        return _COMMAND_DURATION
    x, y, z = x - old["vx"], y - old["vy"], z - old["vz"]
    if limit["held"] and not switched and not max(abs(x), abs(y), abs(z)) <= limit["command_step"]:
        return _largest(x, y, z)
    return FINE


@kernel_jit
def _largest(x: float, y: float, z: float) -> int:
    """Axis of the first NaN among three numbers, else of the largest magnitude."""
    values = (x, y, z)
    largest = 0
    for axis in range(3):
        if math.isnan(values[axis]):
            return axis
        if abs(values[axis]) > abs(values[largest]):
            largest = axis
    return largest


@kernel_jit
def tracking(header: np.ndarray, before: np.ndarray, duration: float, limits: np.ndarray) -> int:
    """Remaining time of the way-point in force (s): falls by at most a period, or starts from the duration.

    Args:
        header: Header of the report. Shape (1,).
        before: Header of the last published report. Shape (1,).
        duration: Duration of a way-point published since the last report (s); 0 = none.
        limits: See `rules`.
    """
    limit = limits[0]
    remaining, most = header[0]["remaining"], before[0]["remaining"]
    least = most - limit["fastest"]
    if remaining == most:
        return FINE  # recomputed for the command of the same step, or no way-point yet
    if duration != 0.0:  # the overrun of the last point, at most one period, is subtracted
        most = duration
        least = most - limit["control_period"] - limit["fastest"]
    return FINE if least - EXACT <= remaining <= most - limit["slowest"] + EXACT else _REMAINING
