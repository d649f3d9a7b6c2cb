"""Which voxels a scan frees and which it hits: OctoMap's `computeUpdate` (Hornung et al. 2013, section 3.1).

Voxels that hold an end point are hit, voxels that a ray crosses before its end are free; a voxel is in one set only,
and hit wins.  The arithmetic of the ray walk is that of OctoMap's `computeRayKeys` (float32 direction, float64
parameters), so that both sets equal the library's.  Sets are kept by stamps on a dense grid, not by hashing.
"""

import math
from typing import NamedTuple

import numpy as np

from mavfi.numerics.jit import kernel_jit
from mavfi.numerics.voxels import STEP_CAP, usable

_F32 = np.float32
_BIG = 1.7976931348623157e308
LAST_SCAN = 2**30 - 1
"""Largest number of a scan: stamps are twice as large, and int32."""


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
        if voxel >= 0:
            # no branch here: whether a voxel is new cannot be predicted, and a wrong guess costs more than the stores
            was = stamp[voxel]
            stamp[voxel] = max(was, scan_stamp)
            touched[count] = voxel
            count += was < scan_stamp
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
def collect(
    points: np.ndarray, origin: np.ndarray, max_range: float, frame: KeyFrame, stamp: np.ndarray, scan: int,
    touched: np.ndarray,
) -> tuple[int, int]:  # fmt: skip
    """Find the voxels that a scan updates.

    Args:
        points: World frame (m); beyond `max_range` only the ray up to it is freed; unusable points are skipped.
            Shape (n, 3), float32.
        origin: Sensor, world frame (m); an unusable one skips the scan. Shape (3,).
        max_range: m.
        frame: Grid.
        stamp: Last scan that touched a voxel; changed. Shape (nx * ny * nz,), int32.
        scan: Number of this scan, larger than any before; one beyond `LAST_SCAN` skips it.
        touched: Result: voxels, free ones first, each once; what follows them is undefined. Longer than the map, int32.

    Returns:
        How many are free, and how many there are in all.

    Raises:
        ValueError: `touched` is too short.
    """
    if touched.shape[0] <= stamp.shape[0]:
        raise ValueError("touched must be longer than the map")
    # a corrupted number would make stamps wrap round and the list run over
    if not (usable(origin[0], origin[1], origin[2]) and 0 < scan <= LAST_SCAN):
        return 0, 0
    free_stamp = 2 * scan
    start = np.empty(3, np.float32)
    start[0] = _F32(origin[0] + frame.shift_x)
    start[1] = _F32(origin[1] + frame.shift_y)
    start[2] = _F32(origin[2] + frame.shift_z)
    ends = np.empty((points.shape[0], 3), np.float32)
    hits = np.empty(points.shape[0], np.int32)
    n_ends = 0
    n_hits = 0
    for i in range(points.shape[0]):
        if not usable(points[i, 0], points[i, 1], points[i, 2]):
            continue
        voxel = _end_of_ray(start, points[i], max_range, frame, ends[n_ends])
        n_ends += 1
        if voxel >= 0 and stamp[voxel] != free_stamp + 1:
            stamp[voxel] = free_stamp + 1
            hits[n_hits] = voxel
            n_hits += 1
    n_free = 0
    for i in range(n_ends):
        n_free = _walk_free(frame, start, ends[i], stamp, free_stamp, touched, n_free)
    for i in range(n_hits):
        touched[n_free + i] = hits[i]
    return n_free, n_free + n_hits
