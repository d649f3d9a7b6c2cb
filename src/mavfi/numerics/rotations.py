"""Rotations by unit quaternions (w x y z) and angles, for compiled code."""

import math

import numpy as np

from mavfi.numerics.elementary import atan2, cos, sin
from mavfi.numerics.jit import kernel_jit


@kernel_jit
def rotation_matrix(quaternion: np.ndarray, matrix: np.ndarray) -> None:
    """Rotation matrix from body to world coordinates.

    Args:
        quaternion: Unit quaternion w x y z, body to world. Shape (4,).
        matrix: Output. Shape (3, 3).
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
    return atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


@kernel_jit
def turn(quaternion: np.ndarray, x: float, y: float, z: float) -> None:
    """Rotate an attitude by a rotation vector in its own frame: q <- q * Exp(v), normalized.

    Args:
        quaternion: Unit quaternion w x y z, changed. Shape (4,).
        x: Rotation vector, x (rad).
        y: Rotation vector, y (rad).
        z: Rotation vector, z (rad).
    """
    angle = math.sqrt(x * x + y * y + z * z)
    scale = sin(0.5 * angle) / angle if angle > 1e-12 else 0.5
    w, x, y, z = cos(0.5 * angle), scale * x, scale * y, scale * z
    a, b, c, d = quaternion[0], quaternion[1], quaternion[2], quaternion[3]
    quaternion[0] = a * w - b * x - c * y - d * z
    quaternion[1] = a * x + b * w + c * z - d * y
    quaternion[2] = a * y - b * z + c * w + d * x
    quaternion[3] = a * z + b * y - c * x + d * w
    norm = math.sqrt(quaternion[0] ** 2 + quaternion[1] ** 2 + quaternion[2] ** 2 + quaternion[3] ** 2)
    for i in range(4):
        quaternion[i] /= norm


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
