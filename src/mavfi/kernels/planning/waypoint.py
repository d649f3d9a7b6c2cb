"""Setpoint generator: from the stored trajectory to the way-point that control currently tracks.

Two rules.  Held: each point is in force for its duration (the published code).  Governed: the reference moves along the
trajectory on a clock that slows down so that the vehicle can stop in observed space.
"""

import math

import numpy as np

from mavfi.numerics.jit import kernel_jit


@kernel_jit
def advance_index(points: np.ndarray, index: int, remaining: float, waypoint: np.ndarray) -> int:
    """The point in force, from the remaining time of the current one; advances by one step at most.

    Args:
        points: Trajectory, columns x y z yaw v(3) a(3) duration. Shape (n, 11).
        index: Point in force; -1 = none yet.
        remaining: Its remaining reference time (s); at zero the next point comes into force.
        waypoint: Output, unchanged at the end of the trajectory. Shape (11,).

    Returns:
        Index of the point in force; n = end of the trajectory.
    """
    if remaining <= 1e-9 or index < 0:
        index += 1
    if 0 <= index < points.shape[0]:
        for column in range(points.shape[1]):
            waypoint[column] = points[index, column]
    return index


@kernel_jit
def arc_lengths(points: np.ndarray, arc: np.ndarray) -> None:
    """Arc length of each point from the start of its trajectory (m). `arc` has shape (n,)."""
    if points.shape[0] > 0:
        arc[0] = 0.0
    for i in range(1, points.shape[0]):
        arc[i] = arc[i - 1] + math.sqrt(
            (points[i, 0] - points[i - 1, 0]) ** 2
            + (points[i, 1] - points[i - 1, 1]) ** 2
            + (points[i, 2] - points[i - 1, 2]) ** 2
        )


@kernel_jit
def _point_before(position: float, last: int) -> int:
    """Index of the point at or before a position on the trajectory; of the first point for a corrupted position."""
    return int(min(position, float(last))) if position >= 0.0 else 0


@kernel_jit
def advance_clock(
    clock: np.ndarray,
    points: np.ndarray,
    arc: np.ndarray,
    dt: float,
    blocked: float,
    unknown: float,
    braking: float,
    creep: float,
    fastest: float,
) -> None:
    """Advance the reference clock by one control period.

    The rate falls so that the reference can stop before the first blocked or unknown sample.  In front of unknown space
    the speed never falls below `creep`, or a voxel that the camera never observes would stop the vehicle for ever.

    Args:
        clock: Memory: position on the trajectory (points), clock rate, its rate of change (1/s); changed. Shape (3,).
        points: Trajectory, one point per control period. Shape (n, 11).
        arc: Arc length of each point (m). Shape (n,).
        dt: Control period (s).
        blocked: Arc length of the first blocked sample (m); inf = none.
        unknown: Arc length of the first unknown sample (m); inf = none.
        braking: Planned deceleration (m/s^2).
        creep: Slowest speed towards unknown space (m/s).
        fastest: Largest clock rate; below 1 on a computer whose loop cannot keep up.
    """
    last = points.shape[0] - 1
    if last < 0:
        return
    i = _point_before(clock[0], last)
    speed = math.sqrt(points[i, 4] ** 2 + points[i, 5] ** 2 + points[i, 6] ** 2)
    margin = 0.3
    limit = np.inf
    if unknown < np.inf:
        limit = max(creep, math.sqrt(2.0 * braking * max(0.0, unknown - margin - arc[i])))
    if blocked < np.inf:
        limit = min(limit, math.sqrt(2.0 * braking * max(0.0, blocked - margin - arc[i])))
    scale = max(speed, 0.3)
    wanted = limit / scale if limit < speed else (fastest if limit > 1e-3 else 0.0)
    wanted = min(fastest, wanted)
    old = clock[1]
    rate = min(old + braking * dt / scale, max(old - 2.0 * braking * dt / scale, wanted))
    if not rate > 1e-3:
        rate = 0.0  # stop exactly, or the reference drifts into the blocked space
    clock[1] = rate
    clock[2] = (rate - old) / dt
    clock[0] = min(clock[0] + rate, float(last))


@kernel_jit
def reference(clock: np.ndarray, points: np.ndarray, waypoint: np.ndarray) -> None:
    """Interpolated, time-scaled point at the clock.

    Args:
        clock: Memory. Shape (3,).
        points: Trajectory. Shape (n, 11).
        waypoint: Output, columns as a point; unchanged without a trajectory. Shape (11,).
    """
    last = points.shape[0] - 1
    if last < 0:
        return
    i = _point_before(clock[0], last)
    j = min(i + 1, last)
    share = clock[0] - i
    rate = clock[1]
    for axis in range(3):
        waypoint[axis] = points[i, axis] + (points[j, axis] - points[i, axis]) * share
        velocity = points[i, 4 + axis] + (points[j, 4 + axis] - points[i, 4 + axis]) * share
        waypoint[4 + axis] = rate * velocity
        waypoint[7 + axis] = rate * rate * points[i, 7 + axis] + clock[2] * velocity
    waypoint[3] = points[i, 3]
    waypoint[10] = points[i, 10]
