"""Approximate flight time of a polyline, for comparing two of them, and a local search that reduces it."""

import math
from typing import NamedTuple

import numpy as np

from mavfi.kernels.planning.path import distance, inside
from mavfi.numerics.elementary import acos, sin, tan
from mavfi.numerics.jit import kernel_jit
from mavfi.numerics.random import uniform
from mavfi.numerics.voxels import Grid, segment_free, voxel_of

_STEP = 0.25
"""Distance between clearance look-ups (m)."""
_MOST_STEPS = 10_000
_SHARPNESS = 1.2
"""Largest curvature of a blend x its reach / tan of half the turn; within 15 % between 30 and 90 degrees."""
_VISIBLE_SLOPE = 0.6
"""Steepest path (tan) within the view of a forward-looking camera."""
_BLIND_SPEED = 0.5
"""Assumed speed of a climb out of view (m/s)."""
_REMOVED = 0.3
"""Share of the trials that remove a vertex; the others move one."""
_LARGEST_MOVE = 1.5


class Pace(NamedTuple):
    """Limits of the vehicle for the estimate.

    Attributes:
        speed: Speed limit (m/s).
        tight_speed: Speed where the wide counter is blocked (m/s).
        tangential: Acceleration along the path (m/s^2).
        lateral: Acceleration across the path (m/s^2).
        blend: Longest distance of a corner's blend from its corner (m).
    """

    speed: float
    tight_speed: float
    tangential: float
    lateral: float
    blend: float


@kernel_jit
def tight_share(wide: np.ndarray, grid: Grid, a: np.ndarray, b: np.ndarray) -> float:
    """Share of the segment a -> b where the wide counter is blocked."""
    length = distance(a, b)
    if not length < _STEP * _MOST_STEPS:
        return 0.0
    steps = int(length / _STEP) + 1
    blocked = 0
    for k in range(steps):
        share = (k + 0.5) / steps
        voxel = voxel_of(grid, a[0] + (b[0] - a[0]) * share, a[1] + (b[1] - a[1]) * share, a[2] + (b[2] - a[2]) * share)
        if voxel >= 0 and wide[voxel] > 0:
            blocked += 1
    return blocked / steps


@kernel_jit
def turn(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> float:
    """Angle between a -> b and b -> c (rad); 0 if a leg has no length."""
    first = distance(a, b)
    second = distance(b, c)
    if not (first > 1e-9 and second > 1e-9):
        return 0.0
    cosine = 0.0
    for axis in range(3):
        cosine += (b[axis] - a[axis]) / first * ((c[axis] - b[axis]) / second)
    return acos(min(1.0, max(-1.0, cosine)))


@kernel_jit
def corner_loss(a: np.ndarray, b: np.ndarray, c: np.ndarray, reach: float, pace: Pace) -> float:
    """Time lost by decelerating for the corner at b and accelerating again (s)."""
    angle = turn(a, b, c)
    if angle < 1e-3:
        return 0.0
    bend = _SHARPNESS * tan(0.5 * min(angle, 3.0))
    slow = min(pace.speed, math.sqrt(pace.lateral * reach / bend))
    return (pace.speed - slow) ** 2 / (pace.speed * pace.tangential)


@kernel_jit
def _unseen_climb(a: np.ndarray, b: np.ndarray) -> float:
    """Height by which a -> b leaves the view of a forward camera (m)."""
    level = math.sqrt((b[0] - a[0]) ** 2 + (b[1] - a[1]) ** 2)
    beyond: float = abs(b[2] - a[2]) - _VISIBLE_SLOPE * level
    return max(0.0, beyond)


@kernel_jit
def travel_time(wide: np.ndarray, grid: Grid, path: np.ndarray, count: int, velocity: np.ndarray, pace: Pace) -> float:
    """Estimated flight time of a polyline.

    Full speed with clearance, `tight_speed` in narrow places; each corner adds time.

    Args:
        wide: > 0 = too close to an obstacle for full speed. Shape (grid.size,).
        grid: Geometry.
        path: Vertices (m). Shape (>= count, 3).
        count: Number of vertices.
        velocity: Velocity at the first vertex (m/s). Shape (3,).
        pace: Limits of the vehicle.

    Returns:
        Time (s).
    """
    time = 0.0
    for i in range(count - 1):
        length = distance(path[i], path[i + 1])
        share = tight_share(wide, grid, path[i], path[i + 1])
        time += length * ((1.0 - share) / pace.speed + share / pace.tight_speed)
        time += _unseen_climb(path[i], path[i + 1]) / _BLIND_SPEED
        if i > 0:
            reach = min(pace.blend, 0.5 * min(length, distance(path[i - 1], path[i])))
            time += corner_loss(path[i - 1], path[i], path[i + 1], reach, pace)
    if count > 1:
        moving = math.sqrt(velocity[0] ** 2 + velocity[1] ** 2 + velocity[2] ** 2)
        away = sin(0.5 * turn(path[0] - velocity, path[0], path[1]))
        time += min(moving, pace.speed) / pace.tangential * away * away
    return time


@kernel_jit
def _trial(path: np.ndarray, count: int, i: int, remove: bool, random: np.ndarray, new: np.ndarray) -> int:
    """Copy of a path with vertex i removed or randomly displaced; returns the number of vertices."""
    written = 0
    for k in range(count):
        if k == i and remove:
            continue
        for axis in range(3):
            new[written, axis] = path[k, axis]
        written += 1
    if not remove:
        size = _LARGEST_MOVE * uniform(random)
        for axis in range(3):
            new[i, axis] += size * (2.0 * uniform(random) - 1.0)
    return written


@kernel_jit
def quicken(
    counter: np.ndarray,
    wide: np.ndarray,
    grid: Grid,
    lower: np.ndarray,
    upper: np.ndarray,
    path: np.ndarray,
    count: int,
    velocity: np.ndarray,
    pace: Pace,
    tries: int,
    random: np.ndarray,
    buffer: np.ndarray,
) -> int:
    """Move and remove vertices while that saves time; in place.

    Args:
        counter: > 0 = blocked: changed segments avoid it. Shape (grid.size,).
        wide: As for `travel_time`.
        grid: Geometry.
        lower: Corner of the box for vertices (m). Shape (3,).
        upper: Opposite corner (m). Shape (3,).
        path: Vertices (m); changed, except the first and the last. Shape (>= count, 3).
        count: Number of vertices.
        velocity: Velocity at the first vertex (m/s). Shape (3,).
        pace: Limits of the vehicle.
        tries: Number of trials.
        random: Generator state. Shape (4,), uint64.
        buffer: Work space of the same shape as `path`.

    Returns:
        New number of vertices.
    """
    time = travel_time(wide, grid, path, count, velocity, pace)
    sweep = count - 2  # removal of each vertex is tried once, from the last to the first
    for trial in range(sweep + tries):
        if count < 3:
            return count
        sweeping = trial < sweep
        i = sweep - trial if sweeping else 1 + int(uniform(random) * (count - 2))
        remove = sweeping or uniform(random) < _REMOVED
        trial_count = _trial(path, count, i, remove, random, buffer)
        if not segment_free(counter, grid, buffer[i - 1], buffer[i]):
            continue
        if trial_count == count and not (
            inside(buffer[i], lower, upper) and segment_free(counter, grid, buffer[i], buffer[i + 1])
        ):
            continue
        new_time = travel_time(wide, grid, buffer, trial_count, velocity, pace)
        if new_time < time:
            time = new_time
            count = trial_count
            for k in range(count):
                for axis in range(3):
                    path[k, axis] = buffer[k, axis]
    return count
