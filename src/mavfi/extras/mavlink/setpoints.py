"""Places and set-points in messages, in NED of the vehicle."""

import math
from collections.abc import Sequence
from typing import Any

from mavfi.extras.mavlink.flying import MavVehicle, Setpoint
from mavfi.extras.mavlink.vocabulary import (
    GLOBAL_FRAMES,
    RELATIVE_FRAMES,
    TERRAIN_FRAMES,
    CoordinateFrame,
    UnsupportedError,
    degrees_of,
)
from mavfi.flight.piloted import Vertical, at_attitude, at_rates, from_body
from mavfi.numerics.frames import Triple, euler, geodetic, local

_BODY_FRAMES = (CoordinateFrame.BODY_NED, CoordinateFrame.BODY_OFFSET_NED, CoordinateFrame.BODY_FRD)
"""Velocities and offsets along the heading."""
_OFFSET_FRAMES = (CoordinateFrame.LOCAL_OFFSET_NED, *_BODY_FRAMES)
"""Positions from where the vehicle is."""

# POSITION_TARGET_TYPEMASK: fields that a set-point's sender leaves out.
_IGNORE_POSITION = (1, 2, 4)
_IGNORE_VELOCITY = (8, 16, 32)
_IGNORE_ACCELERATION = (64, 128, 256)
_IGNORE_YAW = 1024
_IGNORE_YAW_RATE = 2048

# ATTITUDE_TARGET_TYPEMASK
_IGNORE_RATES = (1, 2, 4)
_THRUST_BODY = 32
_IGNORE_THROTTLE = 64
_IGNORE_ATTITUDE = 128


class Geography:
    """Where NED and home are on the earth.

    Attributes:
        origin: Of NED: latitude and longitude (degrees), and altitude above sea level (m).
        home: NED (m).
    """

    def __init__(self, origin: Triple) -> None:
        self.origin = origin
        self.home: Triple = (0.0, 0.0, 0.0)

    @property
    def home_altitude(self) -> float:
        """Above sea level (m)."""
        return self.origin[2] - self.home[2]

    def geodetic(self, ned: Triple) -> Triple:
        """Latitude and longitude (degrees), and altitude above sea level (m)."""
        return geodetic(ned, self.origin)

    def place(self, latitude: float, longitude: float, altitude: float, frame: int) -> Triple:
        """NED (m) of a place in degrees and m; NaN where a coordinate is left out.

        Raises:
            UnsupportedError: The frame is not a global one.
        """
        if frame not in GLOBAL_FRAMES:
            raise UnsupportedError(f"frame {frame} of a place")
        if frame in RELATIVE_FRAMES:
            altitude += self.home_altitude
        elif frame in TERRAIN_FRAMES:
            altitude += self.origin[2]
        return local(latitude, longitude, altitude, self.origin)


def completed(vehicle: MavVehicle, place: Sequence[float | None]) -> Triple:
    """A place (NED, m) whose missing coordinates (None or NaN) are those of the vehicle."""
    coordinates = []
    for coordinate, here in zip(place, vehicle.position, strict=True):
        if coordinate is not None and math.isfinite(coordinate):
            coordinates.append(coordinate)
        else:
            coordinates.append(here)
    return coordinates[0], coordinates[1], coordinates[2]


def local_target(message: Any, vehicle: MavVehicle) -> Setpoint:
    """The set-point of a SET_POSITION_TARGET_LOCAL_NED.

    Raises:
        UnsupportedError: Its frame or its fields are not supported.
    """
    frame = message.coordinate_frame
    if frame not in (CoordinateFrame.LOCAL_NED, *_OFFSET_FRAMES):
        raise UnsupportedError(f"{message.get_type()} in frame {frame}")
    position = (message.x, message.y, message.z)
    if frame in _OFFSET_FRAMES:
        north, east, down = position
        if frame in _BODY_FRAMES:
            north, east = from_body(vehicle, north, east)
        here = vehicle.position
        position = (here[0] + north, here[1] + east, here[2] + down)
    return _target(message, position, body=frame in _BODY_FRAMES)


def global_target(message: Any, geography: Geography) -> Setpoint:
    """The set-point of a SET_POSITION_TARGET_GLOBAL_INT.

    Raises:
        UnsupportedError: Its frame or its fields are not supported.
    """
    frame = message.coordinate_frame
    if frame not in GLOBAL_FRAMES:
        raise UnsupportedError(f"{message.get_type()} in frame {frame}")
    position = geography.place(degrees_of(message.lat_int), degrees_of(message.lon_int), message.alt, frame)
    return _target(message, position, body=False)


def _target(message: Any, position: Triple, *, body: bool) -> Setpoint:
    """The fields that a set-point's sender has not left out."""
    mask = message.type_mask
    used_position = _used(mask, _IGNORE_POSITION, position)
    used_velocity = _used(mask, _IGNORE_VELOCITY, (message.vx, message.vy, message.vz))
    (yaw,) = _used(mask, (_IGNORE_YAW,), (message.yaw,))
    (yaw_rate,) = _used(mask, (_IGNORE_YAW_RATE,), (message.yaw_rate,))

    fields = (*used_position, *used_velocity, yaw, yaw_rate)
    if all(value is None for value in fields):
        raise UnsupportedError(f"{message.get_type()} with type mask {mask}, which leaves no position, velocity or yaw")
    return Setpoint(
        (used_position[0], used_position[1], used_position[2]),
        (used_velocity[0], used_velocity[1], used_velocity[2]),
        yaw,
        yaw_rate,
        body,
    )


def has_acceleration(message: Any) -> bool:
    """Whether a set-point has an acceleration or force, which is not flown; zeros ask for none."""
    acceleration = _used(message.type_mask, _IGNORE_ACCELERATION, (message.afx, message.afy, message.afz))
    return any(value for value in acceleration)


def _used(mask: int, bits: tuple[int, ...], values: tuple[float, ...]) -> list[float | None]:
    """Values that are given; None where the mask ignores one or it is not finite."""
    used: list[float | None] = []
    for bit, value in zip(bits, values, strict=True):
        if mask & bit or not math.isfinite(value):
            used.append(None)
        else:
            used.append(float(value))
    return used


def attitude_target(message: Any, vehicle: MavVehicle, vertical: Vertical) -> Setpoint:
    """The set-point of a SET_ATTITUDE_TARGET.

    Args:
        message: The message.
        vehicle: The vehicle.
        vertical: What its thrust asks for.

    Raises:
        UnsupportedError: Its fields are not supported.
    """
    mask = message.type_mask
    if mask & _IGNORE_THROTTLE:
        raise UnsupportedError(f"{message.get_type()} without a thrust")
    if mask & _THRUST_BODY:
        raise UnsupportedError(f"{message.get_type()} with a thrust along the body's axes")
    rates = _used(mask, _IGNORE_RATES, (message.body_roll_rate, message.body_pitch_rate, message.body_yaw_rate))
    if mask & _IGNORE_ATTITUDE:
        roll_rate, pitch_rate, yaw_rate = (rate or 0.0 for rate in rates)
        return Setpoint(rotors=at_rates(vehicle, roll_rate, pitch_rate, yaw_rate, vertical))
    if not all(math.isfinite(value) for value in message.q):
        raise UnsupportedError(f"{message.get_type()} with an attitude that is not finite")
    roll, pitch, yaw = euler(message.q)
    return Setpoint(rotors=at_attitude(vehicle, roll, pitch, yaw, None, vertical))
