"""The trajectory of a flight in the frames of PX4 and MAVLink: north-east-down (NED) and forward-right-down (FRD).

The world frame (x forward, y left, z up) and NED differ by half a turn about x, which is exact: north is the world's x
axis.  The origin stays that of the world.
"""

import math
from dataclasses import dataclass

import numpy as np

from mavfi.extras.shared.frames import Numbers, Triple

_TURN = np.array([1.0, -1.0, -1.0])


@dataclass(frozen=True, slots=True)
class NedFlight:
    """Columns of a flight log, n rows.

    Attributes:
        time_us: Instants of the flight (us). Shape (n,), int64.
        position: NED (m). Shape (n, 3).
        velocity: NED (m/s). Shape (n, 3).
        quaternion: From FRD to NED, w x y z. Shape (n, 4).
        rates: FRD (rad/s). Shape (n, 3).
        reference: Position of the way-point in force, NED (m). Shape (n, 3).
        command: Commanded velocity, NED (m/s). Shape (n, 3).
        yaw_rate: Commanded yaw rate, clockwise from above (rad/s). Shape (n,).
    """

    time_us: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    quaternion: np.ndarray
    rates: np.ndarray
    reference: np.ndarray
    command: np.ndarray
    yaw_rate: np.ndarray


def ned_of(rows: np.ndarray) -> NedFlight:
    """Rows of a flight log in NED and FRD. Shape (n, 21)."""
    time_us = np.rint(1e6 * np.maximum(rows[:, 0], 0)).astype(np.int64)
    quaternion = rows[:, 7:11] * np.array([1.0, 1.0, -1.0, -1.0])
    return NedFlight(
        time_us,
        rows[:, 1:4] * _TURN,
        rows[:, 4:7] * _TURN,
        quaternion,
        rows[:, 11:14] * _TURN,
        rows[:, 18:21] * _TURN,
        rows[:, 14:17] * _TURN,
        -rows[:, 17],
    )


def euler(wxyz: Numbers) -> Triple:
    """Roll, pitch and yaw (rad) of a quaternion, shape (4,): rotations about z, then y, then x."""
    w, x, y, z = map(float, wxyz)
    roll = math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = math.asin(min(1.0, max(-1.0, 2 * (w * y - z * x))))
    return roll, pitch, math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
