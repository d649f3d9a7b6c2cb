"""Collision check along the remaining trajectory (the paper's kernel "Col. Ck.", MAVFI section III-A)."""

import math

import numpy as np

from mavfi.kernels.perception.clearance import OCCUPIED, UNKNOWN
from mavfi.numerics.jit import kernel_jit
from mavfi.numerics.voxels import FREE, Grid, first_blocked, voxel_of

NO_COLLISION = 30.0
"""time_to_collision if none is predicted (s)."""
_ESCAPE_LENGTH = 1.5
_ESCAPE_CORE = 0.5


@kernel_jit
def time_to_collision(
    counter: np.ndarray,
    grid: Grid,
    position: np.ndarray,
    points: np.ndarray,
    first: int,
    remaining: float,
    outside_blocked: bool,
) -> float:
    """Reference time until the vehicle, following the rest of its trajectory, first enters a blocked voxel.

    Includes the leg from the vehicle to the point in force.

    Args:
        counter: > 0 = too close to an obstacle. Shape (grid.size,).
        grid: Geometry.
        position: Vehicle, world frame (m). Shape (3,).
        points: Trajectory points, columns as in the state table: x y z yaw v(3) a(3) duration. Shape (n, 11).
        first: Index of the point in force.
        remaining: Remaining time of that point (s).
        outside_blocked: Whether the outside of the mapped volume counts as blocked.

    Returns:
        Time at the start of the colliding segment (s); -1 if there is none.
    """
    if first < 0 or first >= points.shape[0]:
        return -1.0
    if first_blocked(counter, grid, position, points[first, :3], outside_blocked) < FREE:
        return 0.0
    time = remaining
    for i in range(first, points.shape[0] - 1):
        if first_blocked(counter, grid, points[i, :3], points[i + 1, :3], outside_blocked) < FREE:
            return time if time > 0.0 else 0.0
        time += points[i + 1, 10]
    return -1.0


@kernel_jit
def _near_unknown(cells: np.ndarray, grid: Grid, voxel: int, reach: int) -> bool:
    """Whether a voxel has an unknown one within `reach` voxels sideways and one up or down."""
    ix = voxel // (grid.ny * grid.nz)
    iy = (voxel // grid.nz) % grid.ny
    iz = voxel % grid.nz
    for x in range(max(ix - reach, 0), min(ix + reach, grid.nx - 1) + 1):
        for y in range(max(iy - reach, 0), min(iy + reach, grid.ny - 1) + 1):
            for z in range(max(iz - 1, 0), min(iz + 1, grid.nz - 1) + 1):
                if cells[(x * grid.ny + y) * grid.nz + z] == UNKNOWN:
                    return True
    return False


@kernel_jit
def _step_to(points: np.ndarray, i: int) -> float:
    """Length of the step to a point (m); 0 for the first and for a corrupted one, which is blocked in any case."""
    if i == 0:
        return 0.0
    step = math.sqrt(
        (points[i, 0] - points[i - 1, 0]) ** 2
        + (points[i, 1] - points[i - 1, 1]) ** 2
        + (points[i, 2] - points[i - 1, 2]) ** 2
    )
    return step if step < np.inf else 0.0


@kernel_jit
def known_free_distance(
    counter: np.ndarray,
    cells: np.ndarray,
    grid: Grid,
    points: np.ndarray,
    first: int,
    horizon: float,
    reach: int,
    escaping: bool,
) -> tuple[float, float]:
    """Arc lengths of the first blocked and the first unknown sample of a trajectory.

    Args:
        counter: > 0 = too close to an obstacle. Shape (grid.size,).
        cells: State of each voxel. Shape (grid.size,), uint8.
        grid: Geometry.
        points: Trajectory points, dense (closer than a voxel), columns as in the state table. Shape (n, 11).
        first: Index of the first point to check.
        horizon: Distance up to which unknown space counts (m).
        reach: Neighbourhood in which an unknown voxel counts (voxels, sideways).
        escaping: The trajectory starts too close to an obstacle: its leading blocked samples do not count.

    Returns:
        Distance from the start of the trajectory to the first blocked sample and to the first unknown one (m);
        inf = none.
    """
    blocked = np.inf
    unknown = np.inf
    length = 0.0
    start = 0.0
    leading = escaping
    last = -2
    for i in range(points.shape[0]):
        length += _step_to(points, i)
        if i == first:
            start = length
        if i < first:
            continue
        voxel = voxel_of(grid, points[i, 0], points[i, 1], points[i, 2])
        if voxel == last:
            continue
        last = voxel
        if voxel < 0:
            return length, unknown
        if counter[voxel] > 0:
            if leading and length < _ESCAPE_LENGTH and (cells[voxel] != OCCUPIED or length < _ESCAPE_CORE):
                unknown = min(unknown, start)
                continue
            return length, unknown
        leading = False
        if unknown == np.inf and length - start < horizon and _near_unknown(cells, grid, voxel, reach):
            unknown = length
    return blocked, unknown
