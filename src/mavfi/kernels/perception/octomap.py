"""OctoMap's update rule on a dense array (Hornung et al. 2013; the paper's kernel "OctoMap").

Per scan: voxels that hold an end point are occupied, voxels that a ray crosses before its end are free; a voxel is
updated once, and occupied wins.  Free updates come first.  Log-odds are float32 and clamped.  The arithmetic of the ray
walk is that of OctoMap's `computeRayKeys` (float32 direction, float64 parameters), so that the map equals the
library's bit for bit.
"""

import math
from typing import NamedTuple

import numpy as np

from mavfi.numerics.jit import kernel_jit
from mavfi.numerics.voxels import STEP_CAP, usable

_F32 = np.float32
_BIG = 1.7976931348623157e308


class UpdateRule(NamedTuple):
    """Log-odds increments and clamps, float32 values."""

    hit: np.float32
    miss: np.float32
    clamp_min: np.float32
    clamp_max: np.float32


class KeyFrame(NamedTuple):
    """Where the grid lies among OctoMap's keys.

    Attributes:
        resolution: Edge of a voxel (m).
        shift_x: Added to coordinates before they become keys (m), so that the ground lies inside a layer of voxels.
        shift_y: Same.
        shift_z: Same.
        kx: Key of the grid's first voxel along x.
        ky: Same along y.
        kz: Same along z.
        nx: Number of voxels along x.
        ny: Same along y.
        nz: Same along z.
    """

    resolution: float
    shift_x: float
    shift_y: float
    shift_z: float
    kx: int
    ky: int
    kz: int
    nx: int
    ny: int
    nz: int


def log_odds(probability: float) -> np.float32:
    """Log-odds of a probability, as OctoMap stores it."""
    return np.float32(math.log(probability / (1.0 - probability)))


@kernel_jit
def _index(frame: KeyFrame, kx: int, ky: int, kz: int) -> int:
    ix = kx - frame.kx
    iy = ky - frame.ky
    iz = kz - frame.kz
    if ix < 0 or iy < 0 or iz < 0 or ix >= frame.nx or iy >= frame.ny or iz >= frame.nz:
        return -1
    return (ix * frame.ny + iy) * frame.nz + iz


@kernel_jit
def _face(origin: np.float32, direction: np.float32, key: int, resolution: float) -> tuple[int, float, float]:
    """Step, parameter of the first face and parameter per voxel along one axis."""
    if direction == 0.0:
        return 0, _BIG, _BIG
    step = 1 if direction > 0.0 else -1
    border = (float(key) + 0.5) * resolution + np.float64(_F32(step * resolution * 0.5))
    first = (border - np.float64(origin)) / np.float64(direction)
    return step, first, resolution / abs(np.float64(direction))


@kernel_jit
def _walk_free(
    frame: KeyFrame, origin: np.ndarray, end: np.ndarray, stamp: np.ndarray, scan_stamp: int, touched: np.ndarray,
    count: int,
) -> int:  # fmt: skip
    """Mark the voxels on origin -> end, without the last one, as free in this scan; returns the new count."""
    inverse = 1.0 / frame.resolution
    kx = int(math.floor(inverse * origin[0]))
    ky = int(math.floor(inverse * origin[1]))
    kz = int(math.floor(inverse * origin[2]))
    end_x = int(math.floor(inverse * end[0]))
    end_y = int(math.floor(inverse * end[1]))
    end_z = int(math.floor(inverse * end[2]))
    if kx == end_x and ky == end_y and kz == end_z:
        return count
    dx = _F32(end[0] - origin[0])
    dy = _F32(end[1] - origin[1])
    dz = _F32(end[2] - origin[2])
    square = _F32(_F32(_F32(dx * dx) + _F32(dy * dy)) + _F32(dz * dz))
    length = _F32(math.sqrt(np.float64(square)))
    sx, tx, ex = _face(origin[0], _F32(dx / length), kx, frame.resolution)
    sy, ty, ey = _face(origin[1], _F32(dy / length), ky, frame.resolution)
    sz, tz, ez = _face(origin[2], _F32(dz / length), kz, frame.resolution)
    for _ in range(STEP_CAP):
        voxel = _index(frame, kx, ky, kz)
        # a corrupted number of the scan makes stamps wrap round: the list must not run over then
        if voxel >= 0 and stamp[voxel] < scan_stamp and count < touched.shape[0]:
            stamp[voxel] = scan_stamp
            touched[count] = voxel
            count += 1
        if tx < ty:
            if tx < tz:
                kx += sx
                tx += ex
            else:
                kz += sz
                tz += ez
        elif ty < tz:
            ky += sy
            ty += ey
        else:
            kz += sz
            tz += ez
        if kx == end_x and ky == end_y and kz == end_z:
            break
        if min(min(tx, ty), tz) > np.float64(length):
            break
    return count


@kernel_jit
def _end_of_ray(start: np.ndarray, point: np.ndarray, max_range: float, frame: KeyFrame, end: np.ndarray) -> int:
    """Where the ray to a point ends, at `max_range` at the latest; returns the voxel that it hits, -1 = none."""
    x = _F32(np.float64(point[0]) + frame.shift_x)
    y = _F32(np.float64(point[1]) + frame.shift_y)
    z = _F32(np.float64(point[2]) + frame.shift_z)
    dx = _F32(x - start[0])
    dy = _F32(y - start[1])
    dz = _F32(z - start[2])
    distance = math.sqrt(np.float64(_F32(_F32(_F32(dx * dx) + _F32(dy * dy)) + _F32(dz * dz))))
    voxel = -1
    if distance > max_range:
        far = _F32(distance)
        reach = _F32(max_range)
        x = _F32(start[0] + _F32(_F32(dx / far) * reach))
        y = _F32(start[1] + _F32(_F32(dy / far) * reach))
        z = _F32(start[2] + _F32(_F32(dz / far) * reach))
    else:
        inverse = 1.0 / frame.resolution
        voxel = _index(frame, int(math.floor(inverse * x)), int(math.floor(inverse * y)), int(math.floor(inverse * z)))
    end[0] = x
    end[1] = y
    end[2] = z
    return voxel


@kernel_jit
def insert_scan(
    points: np.ndarray, origin: np.ndarray, max_range: float, frame: KeyFrame, rule: UpdateRule, log_odds: np.ndarray,
    stamp: np.ndarray, scan: int, touched: np.ndarray, before: np.ndarray,
) -> int:  # fmt: skip
    """Integrate one scan.

    Args:
        points: World frame (m); beyond `max_range` only the ray up to it is freed; unusable points are skipped.
            Shape (n, 3), float32.
        origin: Sensor, world frame (m); an unusable one skips the scan. Shape (3,).
        max_range: m.
        frame: Grid.
        rule: Increments and clamps.
        log_odds: The map; changed. Shape (nx * ny * nz,), float32.
        stamp: Last scan that touched a voxel; changed. Same shape, int32.
        scan: Number of this scan, larger than any before.
        touched: Result: voxels that were updated, free ones first. At least as long as the map, int32.
        before: Result: their log-odds before, for an undo. Same shape, float32.

    Returns:
        How many voxels were updated.
    """
    if not usable(origin[0], origin[1], origin[2]):
        return 0
    free_stamp = 2 * scan
    start = np.empty(3, np.float32)
    start[0] = _F32(origin[0] + frame.shift_x)
    start[1] = _F32(origin[1] + frame.shift_y)
    start[2] = _F32(origin[2] + frame.shift_z)
    ends = np.empty((points.shape[0], 3), np.float32)
    occupied = np.empty(points.shape[0], np.int32)
    n_ends = 0
    n_occupied = 0
    for i in range(points.shape[0]):
        if not usable(points[i, 0], points[i, 1], points[i, 2]):
            continue
        voxel = _end_of_ray(start, points[i], max_range, frame, ends[n_ends])
        n_ends += 1
        if voxel >= 0 and stamp[voxel] != free_stamp + 1:
            stamp[voxel] = free_stamp + 1
            occupied[n_occupied] = voxel
            n_occupied += 1
    count = 0
    for i in range(n_ends):
        count = _walk_free(frame, start, ends[i], stamp, free_stamp, touched, count)
    for i in range(count):
        voxel = touched[i]
        before[i] = log_odds[voxel]
        log_odds[voxel] = max(_F32(log_odds[voxel] + rule.miss), rule.clamp_min)
    for i in range(min(n_occupied, touched.shape[0] - count)):
        voxel = occupied[i]
        touched[count] = voxel
        before[count] = log_odds[voxel]
        log_odds[voxel] = min(_F32(log_odds[voxel] + rule.hit), rule.clamp_max)
        count += 1
    return count


@kernel_jit
def undo_scan(log_odds: np.ndarray, touched: np.ndarray, before: np.ndarray, count: int) -> None:
    """Take the last scan back. Arguments as in `insert_scan`; `count` is what it returned."""
    for i in range(count):
        log_odds[touched[i]] = before[i]
