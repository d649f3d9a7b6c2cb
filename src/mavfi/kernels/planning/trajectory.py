"""From a path to a timed trajectory: corner blends, speed profile, "MultiDOF" points (MAVFI section III-A).

Corners become quintic Bezier blends with zero curvature at their ends; the speed along the curve is limited by
curvature and by forward and backward passes, as in time-optimal path following (Bobrow et al. 1985).
"""

import math
from typing import NamedTuple

import numpy as np

from mavfi.kernels.planning.path import distance
from mavfi.numerics.elementary import atan2
from mavfi.numerics.jit import kernel_jit
from mavfi.numerics.voxels import Grid, segment_free, voxel_of

POINT_WIDTH = 11
"""Columns of a trajectory point: x y z yaw vx vy vz ax ay az duration."""
CURVE_LIMIT = 12_000
POINT_LIMIT = 15_000
SPACING = 0.1
"""Distance between samples of the curve (m)."""
_BLEND_STEPS = 17
_SHRINK = 0.7
_SHORTEST_BLEND = 0.05
_SMALLEST_STEP = 0.0015
"""Smallest step, required by the time sampler at speed zero (m)."""


class Limits(NamedTuple):
    """Limits of the vehicle along the curve.

    Attributes:
        speed: Speed limit (m/s).
        tight_speed: Speed where the wide counter is blocked (m/s).
        lateral: Acceleration across the curve (m/s^2).
        tangential: Acceleration along the curve (m/s^2).
        braking: Deceleration along the curve after entering too fast (m/s^2).
        blend: Longest distance of a blend from its corner (m).
        look: Look-ahead distance of the yaw (m).
    """

    speed: float
    tight_speed: float
    lateral: float
    tangential: float
    braking: float
    blend: float
    look: float


@kernel_jit
def _blend_point(
    corner: np.ndarray, before: np.ndarray, after: np.ndarray, reach: float, inner: float, t: float, out: np.ndarray
) -> None:
    """Point of the quintic blend around a corner; control points at 1, (1 + inner)/2 and inner of `reach`."""
    u = 1.0 - t
    middle = 0.5 * (1.0 + inner)
    first = u**5 + middle * 5.0 * u**4 * t + inner * 10.0 * u**3 * t * t
    second = inner * 10.0 * u * u * t**3 + middle * 5.0 * u * t**4 + t**5
    for axis in range(3):
        out[axis] = corner[axis] - before[axis] * reach * first + after[axis] * reach * second


@kernel_jit
def _add_blend(
    counter: np.ndarray,
    grid: Grid,
    path: np.ndarray,
    i: int,
    reach: float,
    inner: float,
    curve: np.ndarray,
    count: int,
) -> int:
    """Append the blend at vertex i, shrunk until it is free. Returns the new count."""
    before = (path[i] - path[i - 1]) / distance(path[i], path[i - 1])
    after = (path[i + 1] - path[i]) / distance(path[i + 1], path[i])
    while reach >= _SHORTEST_BLEND:
        free = True
        for step in range(_BLEND_STEPS):
            _blend_point(path[i], before, after, reach, inner, step / (_BLEND_STEPS - 1), curve[count + step])
            if step > 0 and not segment_free(counter, grid, curve[count + step - 1], curve[count + step]):
                free = False
                break
        if free:
            return count + _BLEND_STEPS
        reach *= _SHRINK
    for axis in range(3):
        curve[count, axis] = path[i, axis]
    return count + 1


@kernel_jit
def smooth(
    counter: np.ndarray,
    grid: Grid,
    path: np.ndarray,
    count: int,
    blend: float,
    inner: float,
    corners: np.ndarray,
    curve: np.ndarray,
) -> int:
    """Polyline -> evenly spaced samples of a curve without corners.

    Args:
        counter: > 0 = blocked: blends avoid it. Shape (grid.size,).
        grid: Geometry.
        path: Vertices without consecutive duplicates (m). Shape (>= count, 3).
        count: Number of vertices, at least 2.
        blend: Longest distance of a blend from its corner (m).
        inner: Innermost control point of a blend / its distance; 0 follows the corner closely, 1/3 is roundest.
        corners: Work space. Shape (CURVE_LIMIT, 3).
        curve: Output, every `SPACING`. Shape (CURVE_LIMIT, 3).

    Returns:
        Number of samples.
    """
    corners[0] = path[0]
    n = 1
    for i in range(1, count - 1):
        before = distance(path[i], path[i - 1])
        after = distance(path[i + 1], path[i])
        if not (before > 1e-9 and after > 1e-9) or n > CURVE_LIMIT - 2 * _BLEND_STEPS:
            continue
        # the first leg has only one blend, which may take most of it
        reach = min(blend, min((0.9 if i == 1 else 0.499) * before, 0.499 * after))
        n = _add_blend(counter, grid, path, i, reach, inner, corners, n)
    corners[n] = path[count - 1]
    n += 1
    curve[0] = corners[0]
    samples = 1
    passed = 0.0
    due = SPACING
    for i in range(n - 1):
        length = distance(corners[i], corners[i + 1])
        while passed + length >= due and samples < CURVE_LIMIT - 2:
            share = (due - passed) / length
            for axis in range(3):
                curve[samples, axis] = corners[i, axis] + (corners[i + 1, axis] - corners[i, axis]) * share
            samples += 1
            due += SPACING
        passed += length
    if distance(curve[samples - 1], corners[n - 1]) > 1e-6:
        curve[samples] = corners[n - 1]
        samples += 1
    return samples


@kernel_jit
def _curvature(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> float:
    """Curvature at b of the curve through three samples (1/m)."""
    left = distance(a, b)
    right = distance(b, c)
    if not (left > 1e-9 and right > 1e-9):
        return 0.0
    square = 0.0
    for axis in range(3):
        turn = (c[axis] - b[axis]) / right - (b[axis] - a[axis]) / left
        square += turn * turn
    return math.sqrt(square) / (0.5 * (left + right))


@kernel_jit
def _sharpest_bend(curve: np.ndarray, count: int, i: int) -> float:
    """Curvature at sample i or in the sharper adjacent segment (1/m): direction turns uniformly within a segment."""
    here = _curvature(curve[i - 1], curve[i], curve[i + 1]) if 0 < i < count - 1 else 0.0
    before = _curvature(curve[i - 2], curve[i - 1], curve[i]) if 1 < i < count else 0.0
    after = _curvature(curve[i], curve[i + 1], curve[i + 2]) if i < count - 2 else 0.0
    return max(here, 0.5 * (here + max(before, after)))


@kernel_jit
def speed_profile(
    wide: np.ndarray,
    grid: Grid,
    curve: np.ndarray,
    count: int,
    entry_speed: float,
    limits: Limits,
    arc: np.ndarray,
    speed: np.ndarray,
) -> None:
    """Highest speed along a curve within the limits, ending at rest.

    Args:
        wide: > 0 = too close to an obstacle for full speed. Shape (grid.size,).
        grid: Geometry.
        curve: Samples (m). Shape (>= count, 3).
        count: Number of samples.
        entry_speed: Speed at the start (m/s).
        limits: Limits of the vehicle.
        arc: Output: arc length of each sample (m). Shape (>= count,).
        speed: Output: speed at each sample (m/s). Shape (>= count,).
    """
    arc[0] = 0.0
    for i in range(count):
        if i > 0:
            arc[i] = arc[i - 1] + distance(curve[i - 1], curve[i])
        speed[i] = limits.speed
        voxel = voxel_of(grid, curve[i, 0], curve[i, 1], curve[i, 2])
        if voxel >= 0 and wide[voxel] > 0:
            speed[i] = min(speed[i], limits.tight_speed)
        bend = _sharpest_bend(curve, count, i)
        if bend > 1e-9:
            speed[i] = min(speed[i], math.sqrt(limits.lateral / bend))
    speed[count - 1] = 0.0
    for i in range(count - 2, -1, -1):
        speed[i] = min(speed[i], math.sqrt(speed[i + 1] ** 2 + 2.0 * limits.tangential * (arc[i + 1] - arc[i])))
    speed[0] = entry_speed if entry_speed > 0.0 else 0.0
    for i in range(count - 1):
        speed[i + 1] = min(speed[i + 1], math.sqrt(speed[i] ** 2 + 2.0 * limits.tangential * (arc[i + 1] - arc[i])))
    for i in range(count - 2):
        if speed[i + 1] < speed[i]:
            slowest = math.sqrt(max(0.0, speed[i] ** 2 - 2.0 * limits.braking * (arc[i + 1] - arc[i])))
            speed[i + 1] = max(speed[i + 1], slowest)


@kernel_jit
def _tangent(curve: np.ndarray, arc: np.ndarray, count: int, i: int, axis: int) -> float:
    """One component of the direction of a curve at sample i; it turns uniformly between samples."""
    low = max(i - 1, 0)
    high = min(i + 1, count - 1)
    length = arc[high] - arc[low]
    return (curve[high, axis] - curve[low, axis]) / length if length > 0.0 else 0.0


@kernel_jit
def sample(
    curve: np.ndarray,
    count: int,
    arc: np.ndarray,
    speed: np.ndarray,
    step: float,
    look: float,
    yaw: float,
    points: np.ndarray,
) -> int:
    """Sample a curve with speeds at equal times: position, yaw, velocity, acceleration, duration at each instant.

    Args:
        curve: Samples (m). Shape (>= count, 3).
        count: Number of samples.
        arc: Arc length of the samples (m).
        speed: Speed at the samples (m/s).
        step: Time between points (s).
        look: Look-ahead distance of the yaw (m).
        yaw: Yaw while the course is vertical (rad).
        points: Output, columns x y z yaw v(3) a(3) duration. Shape (POINT_LIMIT, 11).

    Returns:
        Number of points.
    """
    n = 0
    i = 0
    ahead = 0
    along = 0.0
    end = arc[count - 1]
    while n < points.shape[0] - 1:
        while i < count - 2 and arc[i + 1] <= along:
            i += 1
        length = arc[i + 1] - arc[i]
        share = min(1.0, max(0.0, (along - arc[i]) / length)) if length > 0.0 else 0.0
        square = speed[i] ** 2 + (speed[i + 1] ** 2 - speed[i] ** 2) * share
        v = math.sqrt(max(0.0, square))
        for axis in range(3):
            points[n, axis] = curve[i, axis] + (curve[i + 1, axis] - curve[i, axis]) * share
            here = _tangent(curve, arc, count, i, axis)
            points[n, 4 + axis] = v * (here + (_tangent(curve, arc, count, i + 1, axis) - here) * share)
        ahead = max(ahead, i)
        while ahead < count - 1 and arc[ahead] - along < look:
            ahead += 1
        dx = curve[ahead, 0] - points[n, 0]
        dy = curve[ahead, 1] - points[n, 1]
        if dx * dx + dy * dy > 0.09:
            yaw = atan2(dy, dx)
        points[n, 3] = yaw
        points[n, 10] = step
        n += 1
        if along >= end - 1e-6:
            break
        rate = (speed[i + 1] ** 2 - speed[i] ** 2) / (2.0 * length) if length > 0.0 else 0.0
        along = min(end, along + max(v * step + 0.5 * rate * step * step, _SMALLEST_STEP))
    for axis in range(3):
        points[n - 1, 4 + axis] = 0.0
    for k in range(n):
        low = max(k - 1, 0)
        high = min(k + 1, n - 1)
        for axis in range(3):
            change = points[high, 4 + axis] - points[low, 4 + axis]
            points[k, 7 + axis] = change / ((high - low) * step) if high > low else 0.0
    return n


@kernel_jit
def hold_points(dense: np.ndarray, count: int, per_point: int, step: float, look: int, points: np.ndarray) -> int:
    """Dense samples -> held points: position at the end of the interval, mean velocity with a small look-ahead.

    Args:
        dense: Points at equal times, columns as in `sample`. Shape (>= count, 11).
        count: Number of dense points.
        per_point: Dense steps per held point.
        step: Time between dense points (s).
        look: Look-ahead of the velocity, in dense steps.
        points: Output, same columns. Shape (POINT_LIMIT, 11).

    Returns:
        Number of points.
    """
    n = 0
    a = 0
    while a < count - 1 and n < points.shape[0] - 2:
        b = min(a + per_point, count - 1)
        from_ = min(a + look, count - 1)
        to = min(b + look, count - 1)
        for axis in range(3):
            points[n, axis] = dense[b, axis]
            points[n, 4 + axis] = (dense[to, axis] - dense[from_, axis]) / ((b - a) * step)
            points[n, 7 + axis] = dense[a, 7 + axis]
        points[n, 3] = dense[a, 3]
        points[n, 10] = (b - a) * step
        n += 1
        a = b
    for axis in range(3):
        points[n, axis] = dense[count - 1, axis]
        points[n, 4 + axis] = 0.0
        points[n, 7 + axis] = 0.0
    points[n, 3] = dense[count - 1, 3]
    points[n, 10] = per_point * step
    return n + 1
