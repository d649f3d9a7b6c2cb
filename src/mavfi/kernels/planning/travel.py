"""How long a polyline takes to fly, near enough to compare two of them."""

import math

import numpy as np

from mavfi.kernels.planning.path import distance
from mavfi.numerics.jit import kernel_jit
from mavfi.numerics.voxels import Grid, voxel_of

_STEP = 0.25
"""Between the points at which room is looked up (m)."""
_MOST_STEPS = 10_000


@kernel_jit
def tight_share(wide: np.ndarray, grid: Grid, a: np.ndarray, b: np.ndarray) -> float:
    """Share of the segment a -> b that lies where the wide counter is blocked."""
    length = distance(a, b)
    if not length < _STEP * _MOST_STEPS:
        return 0.0
    steps = int(length / _STEP) + 1
    blocked = 0
    for k in range(steps):
        share = (k + 0.5) / steps
        voxel = voxel_of(
            grid, a[0] + (b[0] - a[0]) * share, a[1] + (b[1] - a[1]) * share, a[2] + (b[2] - a[2]) * share
        )
        if voxel >= 0 and wide[voxel] > 0:
            blocked += 1
    return blocked / steps


@kernel_jit
def _turn(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> float:
    """0 = straight on at b, 1 = back: sin^2 of half the angle between a -> b and b -> c."""
    first = distance(a, b)
    second = distance(b, c)
    if not (first > 1e-9 and second > 1e-9):
        return 0.0
    cosine = 0.0
    for axis in range(3):
        cosine += (b[axis] - a[axis]) / first * ((c[axis] - b[axis]) / second)
    return 0.5 * (1.0 - min(1.0, max(-1.0, cosine)))


@kernel_jit
def travel_time(
    wide: np.ndarray, grid: Grid, path: np.ndarray, count: int, velocity: np.ndarray, speed: float, tight_speed: float,
    acceleration: float,
) -> float:  # fmt: skip
    """Estimated time to fly a polyline.

    Full speed where there is room, `tight_speed` where there is little; a turn costs the time of slowing down and
    picking up speed again, as much as a stop for a turn back.

    Args:
        wide: > 0 = too near to an obstacle for full speed. Shape (grid.size,).
        grid: Geometry.
        path: Vertices (m). Shape (>= count, 3).
        count: Number of vertices.
        velocity: At the first vertex (m/s). Shape (3,).
        speed: m/s.
        tight_speed: m/s.
        acceleration: Along the path (m/s^2).

    Returns:
        s.
    """
    time = 0.0
    for i in range(count - 1):
        share = tight_share(wide, grid, path[i], path[i + 1])
        time += distance(path[i], path[i + 1]) * ((1.0 - share) / speed + share / tight_speed)
        if i > 0:
            time += speed / acceleration * _turn(path[i - 1], path[i], path[i + 1])
    if count > 1:
        moving = math.sqrt(velocity[0] ** 2 + velocity[1] ** 2 + velocity[2] ** 2)
        time += min(moving, speed) / acceleration * _turn(path[0] - velocity, path[0], path[1])
    return time
