"""Path improvement: greedy and random shortcuts (Geraerts & Overmars 2007), length, nearest cell with clearance."""

import math

import numpy as np

from mavfi.numerics.jit import kernel_jit
from mavfi.numerics.random import uniform
from mavfi.numerics.voxels import Grid, segment_free, voxel_of

_SAME_POINT = 1e-3


@kernel_jit
def distance(a: np.ndarray, b: np.ndarray) -> float:
    """Euclidean distance of two points (m)."""
    return math.sqrt((a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2 + (a[2] - b[2]) ** 2)


@kernel_jit
def path_length(path: np.ndarray, count: int) -> float:
    """Length of a polyline (m). `path` has shape (>= count, 3)."""
    total = 0.0
    for i in range(count - 1):
        total += distance(path[i], path[i + 1])
    return total


@kernel_jit
def shortcut_greedy(counter: np.ndarray, grid: Grid, path: np.ndarray, count: int) -> int:
    """Connect each vertex directly to the farthest visible one; in place.

    Args:
        counter: > 0 = blocked. Shape (grid.size,).
        grid: Geometry.
        path: Vertices (m); changed. Shape (>= count, 3).
        count: Number of vertices.

    Returns:
        New number of vertices.
    """
    written = 1
    i = 0
    while i < count - 1:
        j = count - 1
        while j > i + 1 and not segment_free(counter, grid, path[i], path[j]):
            j -= 1
        # vertices written so far never lie behind the one being read
        for axis in range(3):
            path[written, axis] = path[j, axis]
        written += 1
        i = j
    return written


@kernel_jit
def _locate(path: np.ndarray, count: int, along: float, point: np.ndarray) -> int:
    """Point at an arc length; returns the index of its segment."""
    passed = 0.0
    for i in range(count - 1):
        length = distance(path[i], path[i + 1])
        if passed + length >= along or i == count - 2:
            share = min(1.0, max(0.0, (along - passed) / length)) if length > 0.0 else 0.0
            for axis in range(3):
                point[axis] = path[i, axis] + (path[i + 1, axis] - path[i, axis]) * share
            return i
        passed += length
    return 0


@kernel_jit
def _append(path: np.ndarray, count: int, point: np.ndarray) -> int:
    if count > 0 and distance(path[count - 1], point) <= _SAME_POINT:
        return count
    for axis in range(3):
        path[count, axis] = point[axis]
    return count + 1


@kernel_jit
def shortcut_random(
    counter: np.ndarray, grid: Grid, path: np.ndarray, count: int, tries: int, random: np.ndarray, buffer: np.ndarray
) -> int:
    """Replace stretches between two random points of the polyline by straight lines if these are free; in place.

    Args:
        counter: > 0 = blocked. Shape (grid.size,).
        grid: Geometry.
        path: Vertices (m); changed. Shape (>= count + 2, 3).
        count: Number of vertices.
        tries: Number of pairs.
        random: Generator state. Shape (4,), uint64.
        buffer: Work space of the same shape as `path`.

    Returns:
        New number of vertices.
    """
    a = np.empty(3)
    b = np.empty(3)
    for _ in range(tries):
        if count < 3:
            return count
        total = path_length(path, count)
        first = uniform(random) * total
        second = uniform(random) * total
        i = _locate(path, count, min(first, second), a)
        j = _locate(path, count, max(first, second), b)
        if i == j or not segment_free(counter, grid, a, b):
            continue
        new_count = 0
        for k in range(i + 1):
            new_count = _append(buffer, new_count, path[k])
        new_count = _append(buffer, new_count, a)
        new_count = _append(buffer, new_count, b)
        for k in range(j + 1, count):
            new_count = _append(buffer, new_count, path[k])
        if new_count > path.shape[0] - 2:
            continue
        for k in range(new_count):
            for axis in range(3):
                path[k, axis] = buffer[k, axis]
        count = new_count
    return count


@kernel_jit
def inside(point: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> bool:
    """Whether a point lies in a box."""
    for axis in range(3):
        if not lower[axis] <= point[axis] <= upper[axis]:
            return False
    return True


@kernel_jit
def nearest_clear(
    blocked: np.ndarray,
    check: np.ndarray,
    core: np.ndarray,
    grid: Grid,
    point: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    radius: float,
    result: np.ndarray,
) -> bool:
    """Centre of the nearest voxel that is free in `blocked` and reachable by a straight line from `point`.

    Args:
        blocked: > 0 = blocked, with the larger radius. Shape (grid.size,).
        check: > 0 = blocked, narrow: the line must be free in it, unless the point itself is blocked there.
        core: > 0 = occupied: voxels that the line must not cross. Shape (grid.size,).
        grid: Geometry.
        point: World frame (m). Shape (3,).
        lower: Corner of the allowed box (m). Shape (3,).
        upper: Opposite corner (m). Shape (3,).
        radius: Search radius (m).
        result: The point itself if it is free, else the centre (m). Shape (3,).

    Returns:
        Whether one was found.
    """
    voxel = voxel_of(grid, point[0], point[1], point[2])
    if voxel < 0:
        return False
    for axis in range(3):
        result[axis] = point[axis]
    if inside(point, lower, upper) and blocked[voxel] == 0:
        return True
    blocked_here = check[voxel] > 0
    ix = voxel // (grid.ny * grid.nz)
    iy = (voxel // grid.nz) % grid.ny
    iz = voxel % grid.nz
    reach = int(radius * grid.inverse)
    centre = np.empty(3)
    best = np.inf
    for x in range(max(ix - reach, 0), min(ix + reach, grid.nx - 1) + 1):
        for y in range(max(iy - reach, 0), min(iy + reach, grid.ny - 1) + 1):
            for z in range(max(iz - reach, 0), min(iz + reach, grid.nz - 1) + 1):
                centre[0] = grid.x0 + (x + 0.5) / grid.inverse
                centre[1] = grid.y0 + (y + 0.5) / grid.inverse
                centre[2] = grid.z0 + (z + 0.5) / grid.inverse
                away = distance(point, centre)
                taken = blocked[(x * grid.ny + y) * grid.nz + z] > 0
                if taken or not inside(centre, lower, upper) or away >= best or away > radius:
                    continue
                if not segment_free(core if blocked_here else check, grid, point, centre):
                    continue
                best = away
                for axis in range(3):
                    result[axis] = centre[axis]
    return best < np.inf
