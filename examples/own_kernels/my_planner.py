"""A custom planner: A* on the voxels of the clearance map, compiled.

mavfi fly --environment sparse --seed 7 --planner my_planner:AStar
mavfi fly --environment sparse --seed 7 --planner my_planner:AStar --fault instruction:AStar
"""

import math

import numpy as np

from mavfi.config import PlannerConfig
from mavfi.numerics.jit import kernel_jit
from mavfi.numerics.random import seed_generator
from mavfi.numerics.voxels import Grid, segment_free, voxel_of

MOST_ENTRIES = 500_000
"""Entries of the heap of a search, which fails beyond them."""


@kernel_jit
def sift_down(keys: np.ndarray, voxels: np.ndarray, count: int) -> None:
    """Restore the order of a heap whose first entry was replaced."""
    entry = 0
    while True:
        smallest = entry
        for child in (2 * entry + 1, 2 * entry + 2):
            if child < count and keys[child] < keys[smallest]:
                smallest = child
        if smallest == entry:
            return
        keys[entry], keys[smallest] = keys[smallest], keys[entry]
        voxels[entry], voxels[smallest] = voxels[smallest], voxels[entry]
        entry = smallest


@kernel_jit
def sift_up(keys: np.ndarray, voxels: np.ndarray, entry: int) -> None:
    """Restore the order of a heap to which an entry was added."""
    while entry > 0:
        parent = (entry - 1) // 2
        if keys[parent] <= keys[entry]:
            return
        keys[entry], keys[parent] = keys[parent], keys[entry]
        voxels[entry], voxels[parent] = voxels[parent], voxels[entry]
        entry = parent


@kernel_jit
def distance(grid: Grid, a: int, b: int) -> float:
    """Distance of two voxels (voxels)."""
    dx = a // (grid.ny * grid.nz) - b // (grid.ny * grid.nz)
    dy = a // grid.nz % grid.ny - b // grid.nz % grid.ny
    dz = a % grid.nz - b % grid.nz
    return math.sqrt(float(dx * dx + dy * dy + dz * dz))


@kernel_jit
def is_blocked(counter: np.ndarray, grid: Grid, voxel: int, dx: int, dy: int, dz: int) -> bool:
    """Whether a step to a neighbour touches a blocked voxel: the neighbour, or one beside the way to it."""
    ix = voxel // (grid.ny * grid.nz) + dx
    iy = voxel // grid.nz % grid.ny + dy
    iz = voxel % grid.nz + dz
    if ix < 0 or iy < 0 or iz < 0 or ix >= grid.nx or iy >= grid.ny or iz >= grid.nz:
        return True
    for back_x in range(abs(dx) + 1):
        for back_y in range(abs(dy) + 1):
            for back_z in range(abs(dz) + 1):
                x = ix - back_x * dx
                y = iy - back_y * dy
                z = iz - back_z * dz
                if counter[(x * grid.ny + y) * grid.nz + z] > 0 and not (
                    x == ix - dx and y == iy - dy and z == iz - dz
                ):
                    return True
    return False


@kernel_jit
def find_path(
    counter: np.ndarray,
    grid: Grid,
    start: np.ndarray,
    goal: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    came_from: np.ndarray,
) -> int:
    """Search from the goal to the start, so that `came_from` leads from the start to the goal.

    Args:
        counter: Blocked where > 0. Shape (grid.size,), int16.
        grid: Geometry of the map.
        start: World frame (m). Shape (3,).
        goal: World frame (m). Shape (3,).
        lower: Corner of the box that contains all paths (m). Shape (3,).
        upper: Opposite corner (m). Shape (3,).
        came_from: Output: the next voxel on the way to the goal. Shape (grid.size,), int32.

    Returns:
        The voxel of the start; -1 = there is no path.
    """
    first = voxel_of(grid, start[0], start[1], start[2])
    last = voxel_of(grid, goal[0], goal[1], goal[2])
    if first < 0 or last < 0:
        return -1
    cost = np.full(grid.nx * grid.ny * grid.nz, np.inf)
    keys = np.zeros(MOST_ENTRIES)
    voxels = np.zeros(MOST_ENTRIES, np.int32)
    cost[last] = 0.0
    came_from[last] = last
    keys[0] = distance(grid, last, first)
    voxels[0] = last
    count = 1
    while 0 < count < MOST_ENTRIES - 26:
        voxel = int(voxels[0])
        if voxel == first:
            return first
        count -= 1
        keys[0] = keys[count]
        voxels[0] = voxels[count]
        sift_down(keys, voxels, count)
        ix = voxel // (grid.ny * grid.nz)
        iy = voxel // grid.nz % grid.ny
        iz = voxel % grid.nz
        for dx in range(-1, 2):
            for dy in range(-1, 2):
                for dz in range(-1, 2):
                    x = grid.x0 + (ix + dx + 0.5) / grid.inverse
                    y = grid.y0 + (iy + dy + 0.5) / grid.inverse
                    z = grid.z0 + (iz + dz + 0.5) / grid.inverse
                    if x < lower[0] or y < lower[1] or z < lower[2] or x > upper[0] or y > upper[1] or z > upper[2]:
                        continue
                    if is_blocked(counter, grid, voxel, dx, dy, dz):
                        continue
                    neighbour = voxel + (dx * grid.ny + dy) * grid.nz + dz
                    total = cost[voxel] + math.sqrt(float(dx * dx + dy * dy + dz * dz))
                    if total < cost[neighbour]:
                        cost[neighbour] = total
                        came_from[neighbour] = voxel
                        keys[count] = total + distance(grid, neighbour, first)
                        voxels[count] = neighbour
                        sift_up(keys, voxels, count)
                        count += 1
    return -1


@kernel_jit
def shorten(counter: np.ndarray, grid: Grid, points: np.ndarray, count: int) -> int:
    """Keep the vertices that cannot be skipped; returns their number.

    Args:
        counter: As for `find_path`.
        grid: As for `find_path`.
        points: Vertices (m); those that stay are moved to the front. Shape (n, 3).
        count: Number of vertices.
    """
    kept = 1
    at = 0
    while at < count - 1:
        furthest = count - 1
        while furthest > at + 1 and not segment_free(counter, grid, points[at], points[furthest]):
            furthest -= 1
        at = furthest
        points[kept] = points[at]
        kept += 1
    return kept


class AStar:
    """The shortest way over the voxels, without the vertices that can be skipped."""

    compiled = (find_path, shorten)  # faults can be in these, and in what they call

    def __init__(self, config: PlannerConfig, seed: int) -> None:
        self.random = seed_generator(seed, 1)  # every planner has one; this one draws nothing

    def search(
        self, counter: np.ndarray, grid: Grid, start: np.ndarray, goal: np.ndarray, lower: np.ndarray, upper: np.ndarray
    ) -> np.ndarray:
        """Vertices from start to goal (m); none = there is no path. Shape (n, 3)."""
        came_from = np.full(grid.size, -1, np.int32)
        voxel = find_path(counter, grid, start, goal, lower, upper, came_from)
        if voxel < 0:
            return np.zeros((0, 3))
        way = [voxel]
        while came_from[voxel] != voxel and len(way) < grid.size:  # bounded: a fault may close the way to a circle
            voxel = came_from[voxel]
            way.append(voxel)
        cells = np.column_stack(np.unravel_index(way, (grid.nx, grid.ny, grid.nz)))
        centres = (grid.x0, grid.y0, grid.z0) + (cells + 0.5) * grid.resolution
        path = np.vstack([start, centres, goal])
        return path[: shorten(counter, grid, path, len(path))]
