"""The trajectory of a flight in the frames of PX4 and MAVLink: north-east-down (NED) and forward-right-down (FRD).

The world frame (x forward, y left, z up) and NED differ by half a turn about x, which is exact: north is the world's x
axis.  The origin stays that of the world.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

Triple = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
"""w x y z."""
Numbers = Sequence[float] | np.ndarray
HOME: Triple = (47.397742, 8.545594, 488.0)
"""Latitude and longitude (degrees) and altitude (m) of the world's origin: those of PX4's simulations."""
EARTH_RADIUS = 6_378_137.0
"""Equatorial radius of WGS 84 (m)."""
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


def flipped(values: Numbers) -> Triple:
    """A vector in the other frame, NED and the world's or FRD and the body's; its own inverse."""
    x, y, z = values
    return float(x), -float(y), -float(z)


def turned(quaternion: Numbers) -> Quaternion:
    """An orientation in the other frames; its own inverse."""
    w, x, y, z = quaternion
    return float(w), float(x), -float(y), -float(z)


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


def geodetic(ned: Numbers, home: Triple = HOME) -> Triple:
    """Latitude and longitude (degrees) and altitude (m) of a position (m), on the tangential plane at home."""
    north, east, down = map(float, ned)
    latitude, longitude, altitude = home
    across = math.degrees(east / EARTH_RADIUS / math.cos(math.radians(latitude)))
    return latitude + math.degrees(north / EARTH_RADIUS), longitude + across, altitude - down


def local(latitude: float, longitude: float, altitude: float, home: Triple = HOME) -> Triple:
    """Inverse of `geodetic`."""
    north = math.radians(latitude - home[0]) * EARTH_RADIUS
    east = math.radians(longitude - home[1]) * EARTH_RADIUS * math.cos(math.radians(home[0]))
    return north, east, home[2] - altitude
