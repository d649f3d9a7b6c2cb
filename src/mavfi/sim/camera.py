"""Depth camera: ray casting against boxes in a grid of columns, and against voxels by grid traversal.

It uses only additions, multiplications, divisions and square roots, in a fixed order, so the result is bit-identical
on every processor.  The traversal of the columns is that of Amanatides and Woo (1987).
"""

import math
from typing import NamedTuple

import numpy as np

from mavfi.config import CameraConfig
from mavfi.numerics.elementary import tan
from mavfi.numerics.jit import kernel_jit
from mavfi.numerics.random import normals
from mavfi.numerics.rotations import rotation_matrix
from mavfi.sim.environments.world import Voxels, World

_COLUMN = 3.0


class Columns(NamedTuple):
    """Boxes, sorted by the ground columns that they touch.

    Attributes:
        first: Column (i, j) has the boxes first[i * ny + j] to first[i * ny + j + 1]. Shape (nx * ny + 1,), int32.
        boxes: Lower and upper corners, once for each column that a box touches. Shape (m, 6).
        origin_x: Lower corner of column (0, 0) (m).
        origin_y: Lower corner of column (0, 0) (m).
        nx: Columns along x.
        ny: Columns along y.
    """

    first: np.ndarray
    boxes: np.ndarray
    origin_x: float
    origin_y: float
    nx: int
    ny: int


def build_columns(lower: np.ndarray, upper: np.ndarray) -> Columns:
    """Sort boxes into columns.

    Args:
        lower: Lower corners (m). Shape (n, 3).
        upper: Upper corners (m). Shape (n, 3).
    """
    if len(lower) == 0:
        return Columns(np.zeros(2, np.int32), np.zeros((0, 6)), 0.0, 0.0, 1, 1)
    origin = np.floor(lower[:, :2].min(axis=0))
    count = np.floor((upper[:, :2].max(axis=0) - origin) / _COLUMN).astype(int) + 1
    first_column = np.floor((lower[:, :2] - origin) / _COLUMN).astype(np.int64)
    last_column = np.floor((upper[:, :2] - origin) / _COLUMN).astype(np.int64)
    first = np.zeros(count[0] * count[1] + 1, np.int32)
    boxes = _fill_columns(lower, upper, first_column, last_column, int(count[1]), first)
    return Columns(first, boxes, float(origin[0]), float(origin[1]), int(count[0]), int(count[1]))


@kernel_jit
def _fill_columns(
    lower: np.ndarray, upper: np.ndarray, low: np.ndarray, high: np.ndarray, ny: int, first: np.ndarray
) -> np.ndarray:
    for n in range(len(lower)):
        for i in range(low[n, 0], high[n, 0] + 1):
            for j in range(low[n, 1], high[n, 1] + 1):
                first[i * ny + j + 1] += 1
    for column in range(1, len(first)):
        first[column] += first[column - 1]
    boxes = np.empty((first[-1], 6))
    filled = first[:-1].copy()
    for n in range(len(lower)):
        for i in range(low[n, 0], high[n, 0] + 1):
            for j in range(low[n, 1], high[n, 1] + 1):
                row = filled[i * ny + j]
                filled[i * ny + j] += 1
                boxes[row, :3] = lower[n]
                boxes[row, 3:] = upper[n]
    return boxes


@kernel_jit
def _slab(low: float, high: float, inverse: float, near: float, far: float) -> tuple[float, float]:
    """Clip the interval [near, far] of a ray to a slab, given by its distances from the ray's origin."""
    first = low * inverse
    second = high * inverse
    if first > second:
        first, second = second, first
    return max(near, first), min(far, second)


@kernel_jit
def _box_distance(
    boxes: np.ndarray, row: int, x: float, y: float, z: float, ix: float, iy: float, iz: float, limit: float
) -> float:
    """Distance along a ray to a box, or the limit if it is not nearer."""
    near, far = _slab(boxes[row, 0] - x, boxes[row, 3] - x, ix, 0.0, limit)
    near, far = _slab(boxes[row, 1] - y, boxes[row, 4] - y, iy, near, far)
    near, far = _slab(boxes[row, 2] - z, boxes[row, 5] - z, iz, near, far)
    return near if near <= far else limit


@kernel_jit
def _to_next_border(position: float, index: int, edge: float, inverse: float) -> float:
    """Distance along a ray to the next border of its current cell; positions relative to the grid's origin."""
    border = index + 1 if inverse > 0.0 else index
    return (border * edge - position) * inverse


@kernel_jit
def _away_from_zero(component: float) -> float:
    """Replace a zero slope by a negligible one, so that 0 * inf never occurs."""
    return component if abs(component) > 1e-12 else 1e-12


@kernel_jit
def box_distance_along(columns: Columns, origin: np.ndarray, dx: float, dy: float, dz: float, limit: float) -> float:
    """Distance along a ray to the nearest box or the ground.

    Args:
        columns: Boxes.
        origin: Origin of the ray, world frame, finite (m). Shape (3,).
        dx: Direction, unit vector.
        dy: Direction, unit vector.
        dz: Direction, unit vector.
        limit: Range (m).

    Returns:
        Distance (m), or the limit if nothing is nearer.
    """
    dx, dy, dz = _away_from_zero(dx), _away_from_zero(dy), _away_from_zero(dz)
    ix, iy, iz = 1.0 / dx, 1.0 / dy, 1.0 / dz
    x, y, z = origin[0], origin[1], origin[2]
    best = limit
    if dz < 0.0 and z >= 0.0:
        best = min(best, -z * iz)
    enter, leave = _slab(columns.origin_x - x, columns.origin_x + columns.nx * _COLUMN - x, ix, 0.0, best)
    enter, leave = _slab(columns.origin_y - y, columns.origin_y + columns.ny * _COLUMN - y, iy, enter, leave)
    if not (enter <= leave):
        return best
    px, py = x - columns.origin_x, y - columns.origin_y
    i = min(columns.nx - 1, max(0, int((px + enter * dx) / _COLUMN)))
    j = min(columns.ny - 1, max(0, int((py + enter * dy) / _COLUMN)))
    next_x = _to_next_border(px, i, _COLUMN, ix)
    next_y = _to_next_border(py, j, _COLUMN, iy)
    while enter < best and 0 <= i < columns.nx and 0 <= j < columns.ny:
        column = i * columns.ny + j
        for row in range(columns.first[column], columns.first[column + 1]):
            best = min(best, _box_distance(columns.boxes, row, x, y, z, ix, iy, iz, best))
        if next_x < next_y:
            enter = next_x
            next_x += _COLUMN * abs(ix)
            i += 1 if ix > 0.0 else -1
        else:
            enter = next_y
            next_y += _COLUMN * abs(iy)
            j += 1 if iy > 0.0 else -1
    return best


@kernel_jit
def voxel_distance_along(
    occupied: np.ndarray,
    resolution: float,
    position: tuple[float, float, float],
    direction: tuple[float, float, float],
    limit: float,
) -> float:
    """Distance along a ray to the nearest solid voxel; everything outside the grid is solid.

    Args:
        occupied: Solid voxels. Shape (nx, ny, nz), bool.
        resolution: Edge of a voxel (m).
        position: Origin of the ray relative to the lower corner of voxel (0, 0, 0), finite (m).
        direction: Unit vector.
        limit: Range (m).

    Returns:
        Distance (m), or the limit if nothing is nearer.
    """
    nx, ny, nz = occupied.shape
    dx, dy, dz = _away_from_zero(direction[0]), _away_from_zero(direction[1]), _away_from_zero(direction[2])
    ix, iy, iz = 1.0 / dx, 1.0 / dy, 1.0 / dz
    px, py, pz = position
    if not (0.0 <= px < nx * resolution and 0.0 <= py < ny * resolution and 0.0 <= pz < nz * resolution):
        return 0.0
    i, j, k = int(px / resolution), int(py / resolution), int(pz / resolution)
    next_x = _to_next_border(px, i, resolution, ix)
    next_y = _to_next_border(py, j, resolution, iy)
    next_z = _to_next_border(pz, k, resolution, iz)
    distance = 0.0
    while distance < limit:
        if not (0 <= i < nx and 0 <= j < ny and 0 <= k < nz) or occupied[i, j, k]:
            return distance
        if next_x < next_y and next_x < next_z:
            distance = next_x
            next_x += resolution * abs(ix)
            i += 1 if ix > 0.0 else -1
        elif next_y < next_z:
            distance = next_y
            next_y += resolution * abs(iy)
            j += 1 if iy > 0.0 else -1
        else:
            distance = next_z
            next_z += resolution * abs(iz)
            k += 1 if iz > 0.0 else -1
    return limit


@kernel_jit
def cast_rays(
    columns: Columns, voxels: Voxels, pose: np.ndarray, directions: np.ndarray, limit: float, ranges: np.ndarray
) -> None:
    """Ranges of all rays of an image.

    Args:
        columns: Boxes.
        voxels: Solid voxels.
        pose: Position (m) and quaternion w x y z. Shape (7,).
        directions: Unit vectors, body frame. Shape (n, 3).
        limit: Range (m).
        ranges: Output (m); infinity if nothing is within range, and everywhere for a pose that is not finite.
            Shape (n,).
    """
    finite = True
    for value in pose:
        finite = finite and math.isfinite(value)
    if not finite:
        ranges[:] = math.inf
        return
    matrix = np.empty((3, 3))
    rotation_matrix(pose[3:7], matrix)
    in_grid = (pose[0] - voxels.origin[0], pose[1] - voxels.origin[1], pose[2] - voxels.origin[2])
    for n in range(len(directions)):
        a, b, c = directions[n, 0], directions[n, 1], directions[n, 2]
        dx = matrix[0, 0] * a + matrix[0, 1] * b + matrix[0, 2] * c
        dy = matrix[1, 0] * a + matrix[1, 1] * b + matrix[1, 2] * c
        dz = matrix[2, 0] * a + matrix[2, 1] * b + matrix[2, 2] * c
        if voxels.occupied.size > 0:
            distance = voxel_distance_along(voxels.occupied, voxels.resolution, in_grid, (dx, dy, dz), limit)
        else:
            distance = box_distance_along(columns, pose, dx, dy, dz, limit)
        ranges[n] = distance if distance < limit else math.inf


def pixel_directions(config: CameraConfig) -> np.ndarray:
    """Unit vectors through the centres of the pixels, row by row from the upper left; body frame, x forward.

    Returns:
        Shape (height * width, 3).
    """
    focal = 0.5 * config.width / tan(0.5 * config.field_of_view)
    across = (np.arange(config.width) + 0.5 - 0.5 * config.width) / focal
    down = (np.arange(config.height) + 0.5 - 0.5 * config.height) / focal
    right, below = np.meshgrid(across, down)
    directions = np.stack([np.ones_like(right), -right, -below], axis=-1).reshape(-1, 3)
    length = np.sqrt(directions[:, 0] ** 2 + directions[:, 1] ** 2 + directions[:, 2] ** 2)
    return np.ascontiguousarray(directions / length[:, None])


class Camera:
    """The body-fixed depth camera of one flight, looking along the body's x axis.

    Its optional noise is addressed by the time of the image, independently of the number of earlier images.

    Attributes:
        columns: The boxes of the world.
        noise_key: Key of the noise.
    """

    def __init__(self, config: CameraConfig, world: World, noise_key: int) -> None:
        """Prepare the world for ray casting.

        Args:
            config: Image size, range and noise.
            world: The visible world.
            noise_key: Key of the noise.
        """
        self.directions = pixel_directions(config)
        self.directions.flags.writeable = False
        self._config = config
        self.columns = build_columns(world.lower, world.upper)
        self._voxels = world.voxels
        self.noise_key = noise_key

    def capture(self, pose: np.ndarray, time_us: int) -> np.ndarray:
        """Take an image.

        Args:
            pose: Position (m) and quaternion w x y z of the body. Shape (7,).
            time_us: Time of the image (us).

        Returns:
            Distances along the rays (m), infinity if nothing is within range. Shape (height * width,), float32.
        """
        ranges = np.empty(len(self.directions), np.float32)
        cast_rays(self.columns, self._voxels, pose, self.directions, self._config.range, ranges)
        if self._config.noise > 0.0:
            noise = normals(self.noise_key, time_us, len(ranges))
            ranges *= np.maximum(1.0 + self._config.noise * noise, 0.0)
        return ranges
