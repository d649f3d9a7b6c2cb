"""Contact of the vehicle's collision sphere with the voxels of a scan."""

import math

import numpy as np

from mavfi.numerics.jit import kernel_jit


@kernel_jit
def sphere_touches_voxels(
    centre: np.ndarray, radius: float, occupied: np.ndarray, origin: np.ndarray, resolution: float
) -> bool:
    """Whether a sphere overlaps a solid voxel; everything outside the grid is solid.

    Args:
        centre: World frame (m). Shape (3,) or longer.
        radius: Radius (m).
        occupied: Solid voxels. Shape (nx, ny, nz), bool.
        origin: Lower corner of voxel (0, 0, 0) (m). Shape (3,).
        resolution: Edge of a voxel (m).

    Returns:
        True also for a centre that is not finite.
    """
    for axis in range(3):
        low = centre[axis] - origin[axis] - radius
        if not (low >= 0.0 and low + 2.0 * radius < occupied.shape[axis] * resolution):
            return True
    low_i = int((centre[0] - origin[0] - radius) / resolution)
    high_i = min(int((centre[0] - origin[0] + radius) / resolution), occupied.shape[0] - 1)
    low_j = int((centre[1] - origin[1] - radius) / resolution)
    high_j = min(int((centre[1] - origin[1] + radius) / resolution), occupied.shape[1] - 1)
    low_k = int((centre[2] - origin[2] - radius) / resolution)
    high_k = min(int((centre[2] - origin[2] + radius) / resolution), occupied.shape[2] - 1)
    for i in range(low_i, high_i + 1):
        dx = _beyond_voxel(centre[0] - origin[0], i, resolution)
        for j in range(low_j, high_j + 1):
            dy = _beyond_voxel(centre[1] - origin[1], j, resolution)
            for k in range(low_k, high_k + 1):
                if occupied[i, j, k]:
                    dz = _beyond_voxel(centre[2] - origin[2], k, resolution)
                    if math.sqrt(dx * dx + dy * dy + dz * dz) < radius:
                        return True
    return False


@kernel_jit
def _beyond_voxel(value: float, index: int, resolution: float) -> float:
    return max(index * resolution - value, value - (index + 1) * resolution, 0.0)
