"""Places on Earth, as latitude and longitude, and in north-east-down (NED) on the tangential plane at an origin."""

import math
from collections.abc import Sequence

import numpy as np

Triple = tuple[float, float, float]
Numbers = Sequence[float] | np.ndarray
HOME: Triple = (47.397742, 8.545594, 488.0)
"""Latitude and longitude (degrees) and altitude (m) of the world's origin: those of PX4's simulations."""
EARTH_RADIUS = 6_378_137.0
"""Equatorial radius of WGS 84 (m)."""


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
