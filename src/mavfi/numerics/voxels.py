"""Voxel grids: checked world <-> voxel conversion, and the exact traversal of a grid by a segment.

Coordinates may be corrupted: a value that is not finite or beyond `COORDINATE_LIMIT` never becomes an index, and every
traversal has a step cap.
"""

import math
from typing import NamedTuple

import numpy as np

from mavfi.numerics.jit import kernel_jit

COORDINATE_LIMIT = 4000.0
"""Largest coordinate that is converted to an index (m); it only protects index arithmetic."""
STEP_CAP = 200_000
"""Longest traversal (voxels)."""
FREE = 2.0
"""Return value of `first_blocked` for a free segment; blocked ones give a share of their length in [0, 1]."""
_NEVER = 1e300
_STILL = 1e-300


class Grid(NamedTuple):
    """Geometry of a voxel grid; arrays over it are flat, index (ix * ny + iy) * nz + iz.

    Attributes:
        x0: Lower corner along x, world frame (m).
        y0: Lower corner along y, world frame (m).
        z0: Lower corner along z, world frame (m).
        inverse: Voxels per metre.
        nx: Number of voxels along x.
        ny: Number of voxels along y.
        nz: Number of voxels along z.
    """

    x0: float
    y0: float
    z0: float
    inverse: float
    nx: int
    ny: int
    nz: int

    @property
    def size(self) -> int:
        """Number of voxels."""
        return self.nx * self.ny * self.nz

    @property
    def resolution(self) -> float:
        """Edge of a voxel (m)."""
        return 1.0 / self.inverse


@kernel_jit
def usable(x: float, y: float, z: float) -> bool:
    """Whether a point is finite and close enough to be converted to an index."""
    return abs(x) < COORDINATE_LIMIT and abs(y) < COORDINATE_LIMIT and abs(z) < COORDINATE_LIMIT


@kernel_jit
def voxel_of(grid: Grid, x: float, y: float, z: float) -> int:
    """Flat index of the voxel that contains a point; -1 outside the grid or for an unusable point.

    Args:
        grid: Geometry.
        x: Coordinate along x, world frame (m).
        y: Coordinate along y, world frame (m).
        z: Coordinate along z, world frame (m).
    """
    if not usable(x, y, z):
        return -1
    ix = int(math.floor((x - grid.x0) * grid.inverse))
    iy = int(math.floor((y - grid.y0) * grid.inverse))
    iz = int(math.floor((z - grid.z0) * grid.inverse))
    if ix < 0 or iy < 0 or iz < 0 or ix >= grid.nx or iy >= grid.ny or iz >= grid.nz:
        return -1
    return (ix * grid.ny + iy) * grid.nz + iz


@kernel_jit
def _axis(start: float, delta: float, cell: int) -> tuple[int, float, float]:
    """Step direction, share of the segment per voxel, and share up to the first face, along one axis."""
    if delta > _STILL:
        per_voxel = 1.0 / delta
        return 1, per_voxel, (cell + 1 - start) * per_voxel
    if delta < -_STILL:  # the reciprocal of a denormal number would be infinite
        per_voxel = -1.0 / delta
        return -1, per_voxel, (start - cell) * per_voxel
    return 0, _NEVER, _NEVER


@kernel_jit
def first_blocked(counter: np.ndarray, grid: Grid, a: np.ndarray, b: np.ndarray, outside_blocked: bool) -> float:
    """First blocked voxel on the segment a -> b (Amanatides & Woo 1987).

    Args:
        counter: > 0 = blocked. Shape (grid.size,).
        grid: Geometry.
        a: Start, world frame (m). Shape (3,).
        b: End. Shape (3,).
        outside_blocked: Whether the outside of the grid, and unusable points, count as blocked.

    Returns:
        Share of the segment before the blocked voxel, 0..1, or `FREE`.
    """
    if not (usable(a[0], a[1], a[2]) and usable(b[0], b[1], b[2])):
        return 0.0 if outside_blocked else FREE
    x = (a[0] - grid.x0) * grid.inverse
    y = (a[1] - grid.y0) * grid.inverse
    z = (a[2] - grid.z0) * grid.inverse
    ix = int(math.floor(x))
    iy = int(math.floor(y))
    iz = int(math.floor(z))
    end_x = (b[0] - grid.x0) * grid.inverse
    end_y = (b[1] - grid.y0) * grid.inverse
    end_z = (b[2] - grid.z0) * grid.inverse
    sx, ex, tx = _axis(x, end_x - x, ix)
    sy, ey, ty = _axis(y, end_y - y, iy)
    sz, ez, tz = _axis(z, end_z - z, iz)
    steps = abs(int(math.floor(end_x)) - ix) + abs(int(math.floor(end_y)) - iy) + abs(int(math.floor(end_z)) - iz)
    share = 0.0
    for _ in range(min(steps, STEP_CAP) + 1):
        if ix < 0 or iy < 0 or iz < 0 or ix >= grid.nx or iy >= grid.ny or iz >= grid.nz:
            if outside_blocked:
                return share
        elif counter[(ix * grid.ny + iy) * grid.nz + iz] > 0:
            return share
        if tx < ty and tx < tz:
            share = tx
            tx += ex
            ix += sx
        elif ty < tz:
            share = ty
            ty += ey
            iy += sy
        else:
            share = tz
            tz += ez
            iz += sz
    return FREE


@kernel_jit
def segment_free(counter: np.ndarray, grid: Grid, a: np.ndarray, b: np.ndarray) -> bool:
    """Whether no voxel on a -> b is blocked; the outside of the grid is blocked. Arguments as for `first_blocked`."""
    return first_blocked(counter, grid, a, b, True) > 1.0


def offsets_within(radius: float, resolution: float, between_boxes: bool) -> np.ndarray:
    """Voxel offsets blocked by a radius around an occupied voxel.

    Args:
        radius: Radius (m).
        resolution: Edge of a voxel (m).
        between_boxes: Measure between voxel boxes (free cells then keep that distance) instead of voxel centres.

    Returns:
        Shape (n, 3), int64.
    """
    reach = math.ceil(radius / resolution) + 1
    axis = np.arange(-reach, reach + 1)
    offsets = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3)
    if between_boxes:
        gap = resolution * np.sqrt((np.maximum(np.abs(offsets) - 1, 0) ** 2).sum(1))
        return np.ascontiguousarray(offsets[gap < radius])
    distance = resolution * np.sqrt((offsets**2).sum(1))
    return np.ascontiguousarray(offsets[distance <= radius])
