"""Voxels that a scan frees, and voxels that it hits: OctoMap's `computeUpdate` (Hornung et al. 2013, section 3.1).

Voxels that contain an end point are hit, voxels that a ray crosses before its end are free; a voxel is in one set only,
and hit takes precedence.  The ray traversal uses the arithmetic of OctoMap's `computeRayKeys` (float32 direction,
float64 parameters), so that both sets equal the library's.  Sets are represented by stamps on a dense grid instead of
hashing.  Rays that stay in the grid are traversed in parallel blocks; all others one by one.
"""

import math
from typing import NamedTuple

import numpy as np

from mavfi.numerics.jit import kernel_jit
from mavfi.numerics.voxels import STEP_CAP, usable

_F32 = np.float32
_BIG = 1.7976931348623157e308
LAST_SCAN = 2**30 - 1
"""Largest scan number: stamps are twice as large, and int32."""


class KeyFrame(NamedTuple):
    """Location of the grid in OctoMap's key space.

    Attributes:
        resolution: Edge of a voxel (m).
        shift_x: Added to x before conversion to a key (m).
        shift_y: Added to y before conversion to a key (m).
        shift_z: Added to z before conversion to a key (m), so that the ground lies inside a layer of voxels.
        kx: Key of the grid's first voxel along x.
        ky: Key of the grid's first voxel along y.
        kz: Key of the grid's first voxel along z.
        nx: Number of voxels along x.
        ny: Number of voxels along y.
        nz: Number of voxels along z.
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


_NEXT_X, _NEXT_Y, _NEXT_Z, _EACH_X, _EACH_Y, _EACH_Z, _MOVE_X, _MOVE_Y, _MOVE_Z, _VOXEL, _END, _LENGTH = range(12)
RAYS = 64
"""Number of rays per block."""
LONGEST = 512
"""Steps of the longest traversal in a block."""


class Block(NamedTuple):
    """Parallel traversals, one column per ray.

    Attributes:
        rays: Along each axis the parameter of the next face, the parameter between faces (m), and the increment of the
            voxel index per step; then the current voxel, the last voxel, and the length (m). Shape (12, RAYS).
        steps: Number of voxels before the last one; -1 = the ray must be traversed alone. Shape (RAYS,), int64.
        voxels: Voxel of each ray after each step. Shape (LONGEST, RAYS).
        leaves: Parameter at which the ray leaves that voxel (m). Shape (LONGEST, RAYS).
    """

    rays: np.ndarray
    steps: np.ndarray
    voxels: np.ndarray
    leaves: np.ndarray


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
def _keys(frame: KeyFrame, point: np.ndarray) -> tuple[int, int, int]:
    inverse = 1.0 / frame.resolution
    return (
        int(math.floor(inverse * point[0])),
        int(math.floor(inverse * point[1])),
        int(math.floor(inverse * point[2])),
    )


@kernel_jit
def _faces(
    frame: KeyFrame, origin: np.ndarray, keys: tuple[int, int, int], end: np.ndarray
) -> tuple[tuple[int, float, float], tuple[int, float, float], tuple[int, float, float], float]:
    """Result of `_face` along each axis of the ray from `origin`, which has `keys`, to `end`; and its length (m)."""
    dx = _F32(end[0] - origin[0])
    dy = _F32(end[1] - origin[1])
    dz = _F32(end[2] - origin[2])
    square = _F32(_F32(_F32(dx * dx) + _F32(dy * dy)) + _F32(dz * dz))
    length = _F32(math.sqrt(np.float64(square)))
    return (
        _face(origin[0], _F32(dx / length), keys[0], frame.resolution),
        _face(origin[1], _F32(dy / length), keys[1], frame.resolution),
        _face(origin[2], _F32(dz / length), keys[2], frame.resolution),
        np.float64(length),
    )


@kernel_jit
def _walk_free(
    frame: KeyFrame,
    origin: np.ndarray,
    end: np.ndarray,
    stamp: np.ndarray,
    scan_stamp: np.int32,
    touched: np.ndarray,
    count: int,
) -> int:
    """Mark the voxels on origin -> end, excluding the last one, as free in this scan; returns the new count."""
    kx, ky, kz = _keys(frame, origin)
    end_x, end_y, end_z = _keys(frame, end)
    if kx == end_x and ky == end_y and kz == end_z:
        return count
    (sx, tx, ex), (sy, ty, ey), (sz, tz, ez), length = _faces(frame, origin, (kx, ky, kz), end)
    entered = False
    for _ in range(STEP_CAP):
        voxel = _index(frame, kx, ky, kz)
        if voxel < 0 and entered:
            break  # a straight line that has left the grid does not re-enter it
        if voxel >= 0:
            entered = True
            # no branch here: new voxels cannot be predicted, and a misprediction costs more than the stores
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
        if min(min(tx, ty), tz) > length:
            break
    return count


@kernel_jit
def _well_inside(key: int, end: int, first: int, n: int) -> bool:
    """Whether a ray stays in the grid along one axis, even if rounding leads it one voxel too far."""
    return min(key, end) - first >= 1 and max(key, end) - first <= n - 2


@kernel_jit
def _set_out(frame: KeyFrame, origin: np.ndarray, ends: np.ndarray, first: int, count: int, block: Block) -> int:
    """Prepare the traversals to `count` ends from `first` on; returns the number of steps of the longest one."""
    rays = block.rays
    kx, ky, kz = _keys(frame, origin)
    longest = 0
    for r in range(count):
        end_x, end_y, end_z = _keys(frame, ends[first + r])
        (sx, tx, ex), (sy, ty, ey), (sz, tz, ez), length = _faces(frame, origin, (kx, ky, kz), ends[first + r])
        rays[_NEXT_X, r], rays[_NEXT_Y, r], rays[_NEXT_Z, r] = tx, ty, tz
        rays[_EACH_X, r], rays[_EACH_Y, r], rays[_EACH_Z, r] = ex, ey, ez
        rays[_MOVE_X, r], rays[_MOVE_Y, r], rays[_MOVE_Z, r] = sx * frame.ny * frame.nz, sy * frame.nz, sz
        rays[_VOXEL, r] = ((kx - frame.kx) * frame.ny + (ky - frame.ky)) * frame.nz + (kz - frame.kz)
        rays[_END, r] = ((end_x - frame.kx) * frame.ny + (end_y - frame.ky)) * frame.nz + (end_z - frame.kz)
        rays[_LENGTH, r] = length
        steps = abs(end_x - kx) + abs(end_y - ky) + abs(end_z - kz)
        inside = (
            _well_inside(kx, end_x, frame.kx, frame.nx)
            and _well_inside(ky, end_y, frame.ky, frame.ny)
            and _well_inside(kz, end_z, frame.kz, frame.nz)
        )
        block.steps[r] = steps if inside and length > 0.0 and steps < LONGEST else -1
        longest = max(longest, block.steps[r])
    return longest


@kernel_jit
def _walk_block(block: Block, steps: int) -> None:
    """Traverse all rays of a block for a number of steps; store each voxel and the parameter at which it is left.

    The next axis is selected without a branch: it is unpredictable, and without branches the compiler vectorizes over
    rays.  The arithmetic is that of `_walk_free`, bit for bit.
    """
    rays, voxels, leaves = block.rays, block.voxels, block.leaves
    for step in range(steps + 1):
        for r in range(rays.shape[1]):
            tx, ty, tz = rays[_NEXT_X, r], rays[_NEXT_Y, r], rays[_NEXT_Z, r]
            ex, ey, ez = rays[_EACH_X, r], rays[_EACH_Y, r], rays[_EACH_Z, r]
            sx, sy, sz = rays[_MOVE_X, r], rays[_MOVE_Y, r], rays[_MOVE_Z, r]
            voxel = rays[_VOXEL, r]
            voxels[step, r] = voxel
            nearer = tx if tx < ty else ty
            leaves[step, r] = nearer if nearer < tz else tz
            along_x = (tx < ty) & (tx < tz)
            along_y = (not along_x) & (ty < tz)
            rays[_NEXT_X, r] = tx + (ex if along_x else 0.0)
            rays[_NEXT_Y, r] = ty + (ey if along_y else 0.0)
            rays[_NEXT_Z, r] = tz + (0.0 if along_x | along_y else ez)
            rays[_VOXEL, r] = voxel + (sx if along_x else (sy if along_y else sz))


@kernel_jit
def _free_block(
    frame: KeyFrame,
    origin: np.ndarray,
    ends: np.ndarray,
    first: int,
    block: Block,
    stamp: np.ndarray,
    scan_stamp: np.int32,
    touched: np.ndarray,
    count: int,
) -> int:
    """`_walk_free` for one block of ends from `first` on."""
    size = min(block.rays.shape[1], ends.shape[0] - first)
    _walk_block(block, _set_out(frame, origin, ends, first, size, block))
    for r in range(size):
        steps = block.steps[r]
        if steps == 0:
            continue
        # rounding may lead a ray past its end voxel, or stop it early: then it is traversed alone
        if steps < 0 or not (
            block.voxels[steps, r] == block.rays[_END, r] and block.leaves[steps - 1, r] <= block.rays[_LENGTH, r]
        ):
            count = _walk_free(frame, origin, ends[first + r], stamp, scan_stamp, touched, count)
            continue
        for step in range(steps):
            voxel = np.uint32(block.voxels[step, r])
            was = stamp[voxel]
            stamp[voxel] = max(was, scan_stamp)
            touched[np.uint32(count)] = voxel
            count += was < scan_stamp
    return count


@kernel_jit
def _end_of_ray(start: np.ndarray, point: np.ndarray, max_range: float, frame: KeyFrame, end: np.ndarray) -> int:
    """End of the ray to a point, limited to `max_range`; returns the voxel that it hits, -1 = none."""
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
    points: np.ndarray,
    origin: np.ndarray,
    max_range: float,
    frame: KeyFrame,
    stamp: np.ndarray,
    scan: int,
    touched: np.ndarray,
) -> tuple[int, int]:
    """Find the voxels that a scan updates.

    Args:
        points: World frame (m); beyond `max_range` only the ray up to it is freed; unusable points are skipped.
            Shape (n, 3), float32.
        origin: Sensor, world frame (m); an unusable one skips the scan. Shape (3,).
        max_range: Range of the sensor (m).
        frame: Grid.
        stamp: Last scan that updated a voxel; changed. Shape (nx * ny * nz,), int32.
        scan: Number of this scan, larger than all previous ones; beyond `LAST_SCAN` the scan is skipped.
        touched: Output: voxels, free ones first, each once; later entries are undefined. Longer than the map, int32.

    Returns:
        Number of free voxels, and number of all voxels.

    Raises:
        ValueError: `touched` is too short.
    """
    if touched.shape[0] <= stamp.shape[0]:
        raise ValueError("touched must be longer than the map")
    # a corrupted number would make stamps wrap round and the list overflow
    if not (usable(origin[0], origin[1], origin[2]) and 0 < scan <= LAST_SCAN):
        return 0, 0
    free_stamp = np.int32(2 * scan)  # same type as a stamp: a wider number would be converted at every voxel
    start = np.empty(3, np.float32)
    start[0] = _F32(origin[0] + frame.shift_x)
    start[1] = _F32(origin[1] + frame.shift_y)
    start[2] = _F32(origin[2] + frame.shift_z)
    ends = np.empty((points.shape[0], 3), np.float32)
    hits = np.empty(points.shape[0], np.int32)
    n_ends = 0
    n_hits = 0
    for i in range(points.shape[0]):
        if not usable(np.float64(points[i, 0]), np.float64(points[i, 1]), np.float64(points[i, 2])):
            continue
        voxel = _end_of_ray(start, points[i], max_range, frame, ends[n_ends])
        n_ends += 1
        if voxel >= 0 and stamp[voxel] != free_stamp + 1:
            stamp[voxel] = free_stamp + 1
            hits[n_hits] = voxel
            n_hits += 1
    n_free = 0
    block = Block(np.zeros((12, RAYS)), np.zeros(RAYS, np.int64), np.empty((LONGEST, RAYS)), np.empty((LONGEST, RAYS)))
    for first in range(0, n_ends, RAYS):
        n_free = _free_block(frame, start, ends[:n_ends], first, block, stamp, free_stamp, touched, n_free)
    for i in range(n_hits):
        touched[n_free + i] = hits[i]
    return n_free, n_free + n_hits
