"""Point cloud generation: the paper's kernel "P.C. Gen." (MAVFI section III-A; pinhole back-projection)."""

import numpy as np

from mavfi.numerics.jit import kernel_jit

BEYOND_RANGE = 1.25
"""A ray without a return becomes a point at this multiple of the sensor's range, so that the map frees the ray."""


@kernel_jit
def back_project(
    ranges: np.ndarray,
    directions: np.ndarray,
    rotation: np.ndarray,
    origin: np.ndarray,
    max_range: float,
    points: np.ndarray,
) -> None:
    """Depth image -> points in the world frame.

    Args:
        ranges: Distance along each ray (m), inf = no return, NaN = invalid. Shape (n,), float32.
        directions: Unit vectors, camera frame x forward, y left, z up. Shape (n, 3).
        rotation: Camera -> world. Shape (3, 3).
        origin: Camera, world frame (m). Shape (3,).
        max_range: Range of the sensor (m).
        points: Output (m); NaN where the depth is invalid. Shape (n, 3), float32.
    """
    for i in range(ranges.shape[0]):
        distance = float(ranges[i])
        if distance > max_range:
            distance = max_range * BEYOND_RANGE
        x = directions[i, 0] * distance
        y = directions[i, 1] * distance
        z = directions[i, 2] * distance
        for axis in range(3):
            points[i, axis] = np.float32(
                origin[axis] + rotation[axis, 0] * x + rotation[axis, 1] * y + rotation[axis, 2] * z
            )
