"""A custom voxel map: hits and misses of the rays that went through a voxel, compiled.

mavfi fly --environment sparse --seed 7 --map my_map:VoxelMap
mavfi fly --environment sparse --seed 7 --map my_map:VoxelMap --fault instruction:VoxelMap
mavfi fly --environment sparse --seed 7 --map my_map:VoxelMap --fault memory:VoxelMap.log_odds
"""

import math

import numpy as np

from mavfi.kernels.perception.key_sets import KeyFrame
from mavfi.kernels.perception.octomap import UpdateRule
from mavfi.numerics.jit import kernel_jit
from mavfi.numerics.voxels import usable

STEP = 0.5
"""Distance of the points of a ray that are looked at (voxels)."""


@kernel_jit
def voxel_at(frame: KeyFrame, x: float, y: float, z: float) -> int:
    """Index of the voxel that contains a point, world frame (m); -1 = outside of the map."""
    ix = int(math.floor((x + frame.shift_x) / frame.resolution)) - frame.kx
    iy = int(math.floor((y + frame.shift_y) / frame.resolution)) - frame.ky
    iz = int(math.floor((z + frame.shift_z) / frame.resolution)) - frame.kz
    if ix < 0 or iy < 0 or iz < 0 or ix >= frame.nx or iy >= frame.ny or iz >= frame.nz:
        return -1
    return (ix * frame.ny + iy) * frame.nz + iz


@kernel_jit
def add_scan(
    points: np.ndarray,
    origin: np.ndarray,
    max_range: float,
    frame: KeyFrame,
    rule: UpdateRule,
    log_odds: np.ndarray,
    state: np.ndarray,
    touched: np.ndarray,
) -> int:
    """Integrate a scan: voxels on a ray are freed, voxels with an end point are hit, each once.

    Args:
        points: End points of the rays, world frame (m); not finite = no measurement. Shape (n, 3), float32.
        origin: Sensor, world frame (m). Shape (3,).
        max_range: Beyond it nothing was hit (m).
        frame: Geometry of the map.
        rule: What a hit and a miss add, and the limits.
        log_odds: The map; changed. Shape (size,), float32.
        state: Work array, all zero before and after. Shape (size,), uint8.
        touched: Output: voxels that were updated. Shape (size,), int32.

    Returns:
        Number of these.
    """
    count = 0
    for i in range(len(points)):
        x, y, z = float(points[i, 0]), float(points[i, 1]), float(points[i, 2])
        if not usable(x, y, z) or not usable(origin[0], origin[1], origin[2]):
            continue
        dx, dy, dz = x - origin[0], y - origin[1], z - origin[2]
        length = math.sqrt(dx * dx + dy * dy + dz * dz)
        steps = int(min(length, max_range) / (STEP * frame.resolution))
        for step in range(steps):
            share = step * STEP * frame.resolution / length
            voxel = voxel_at(frame, origin[0] + share * dx, origin[1] + share * dy, origin[2] + share * dz)
            if voxel >= 0 and state[voxel] == 0:
                state[voxel] = 1
                touched[count] = voxel
                count += 1
        voxel = voxel_at(frame, x, y, z)
        if voxel >= 0 and length <= max_range:
            if state[voxel] == 0:
                touched[count] = voxel
                count += 1
            state[voxel] = 2
    for i in range(count):
        voxel = touched[i]
        if state[voxel] == 2:
            log_odds[voxel] = min(log_odds[voxel] + rule.hit, rule.clamp_max)
        else:
            log_odds[voxel] = max(log_odds[voxel] + rule.miss, rule.clamp_min)
        state[voxel] = 0
    return count


class VoxelMap:
    """Log-odds in an array; the last scan can be undone."""

    compiled = (add_scan,)  # faults can be in it, and in what it calls

    def __init__(self, frame: KeyFrame, rule: UpdateRule, max_range: float) -> None:
        size = frame.nx * frame.ny * frame.nz
        self.log_odds = np.zeros(size, np.float32)
        self._settings = (max_range, frame, rule)
        self._before = (np.zeros(0, np.int32), np.zeros(0, np.float32))

    def arrays(self) -> dict[str, np.ndarray]:
        """The memory that faults can be in, by name."""
        return {"log_odds": self.log_odds}

    def insert(self, points: np.ndarray, origin: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Integrate a scan; returns the updated voxels (int32) and their new log-odds (float32)."""
        size = len(self.log_odds)
        touched = np.zeros(size, np.int32)
        before = self.log_odds.copy()
        count = add_scan(points, origin, *self._settings, self.log_odds, np.zeros(size, np.uint8), touched)
        voxels = touched[:count]
        self._before = (voxels, before[voxels])
        return voxels, self.log_odds[voxels]

    def mark(self) -> None:
        """A scan follows that may have to be undone."""
        self._before = (np.zeros(0, np.int32), np.zeros(0, np.float32))

    def rollback(self) -> None:
        """Undo the scans since then."""
        voxels, log_odds = self._before
        self.log_odds[voxels] = log_odds
