"""Rotations by unit quaternions (w x y z) and angles, for compiled code."""

import math

import numpy as np

from mavfi.numerics.jit import kernel_jit


@kernel_jit
def rotation_matrix(quaternion: np.ndarray, matrix: np.ndarray) -> None:
    """Matrix that turns body coordinates into world coordinates.

    Args:
        quaternion: Unit quaternion w x y z, body to world. Shape (4,).
        matrix: Result. Shape (3, 3).
    """
    w, x, y, z = quaternion[0], quaternion[1], quaternion[2], quaternion[3]
    matrix[0, 0] = 1.0 - 2.0 * (y * y + z * z)
    matrix[0, 1] = 2.0 * (x * y - w * z)
    matrix[0, 2] = 2.0 * (x * z + w * y)
    matrix[1, 0] = 2.0 * (x * y + w * z)
    matrix[1, 1] = 1.0 - 2.0 * (x * x + z * z)
    matrix[1, 2] = 2.0 * (y * z - w * x)
    matrix[2, 0] = 2.0 * (x * z - w * y)
    matrix[2, 1] = 2.0 * (y * z + w * x)
    matrix[2, 2] = 1.0 - 2.0 * (x * x + y * y)


@kernel_jit
def yaw_of(quaternion: np.ndarray) -> float:
    """Heading of the body's x axis, counter-clockwise from the world's x axis.

    Args:
        quaternion: Unit quaternion w x y z, body to world. Shape (4,).

    Returns:
        Yaw (rad) in [-pi, pi].
    """
    w, x, y, z = quaternion[0], quaternion[1], quaternion[2], quaternion[3]
    return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


@kernel_jit
def wrap_angle(angle: float) -> float:
    """The same angle in [-pi, pi); NaN and infinities give NaN.

    Args:
        angle: Any angle (rad).
    """
    wrapped = float(np.fmod(angle, 2.0 * math.pi))
    if wrapped >= math.pi:
        return wrapped - 2.0 * math.pi
    if wrapped < -math.pi:
        return wrapped + 2.0 * math.pi
    return wrapped
