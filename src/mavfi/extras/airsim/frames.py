"""Frames and objects of AirSim's API.

AirSim's world is NED with its origin where the vehicle started, its body FRD; ours are ENU-like (x forward, y left,
z up) and FLU.  Half a turn about x converts one to the other: (x, -y, -z), quaternion (w, x, -y, -z), exactly.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from mavfi.errors import BadInputError
from mavfi.extras.airsim.grounded import times
from mavfi.extras.shared.frames import Numbers, Triple, geodetic, local
from mavfi.numerics.elementary import cos, sin

Quaternion = tuple[float, float, float, float]
"""w x y z."""
HOME = (47.641468, -122.140165, 122.0)
"""AirSim's OriginGeopoint: latitude, longitude (deg), altitude (m)."""
_GEO_POINT = ("latitude", "longitude", "altitude")
LEVEL = (1.0, 0.0, 0.0, 0.0)
NO_MOUNT = (0.0, 0.0, 0.0, *LEVEL)
"""Pose of a sensor at the vehicle's centre, in its frame."""

Data = dict[str, Any]
"""An object of the API, as plain data."""


def flipped(values: Numbers) -> Triple:
    """A vector in the other frame, NED and the world's or FRD and the body's; its own inverse."""
    x, y, z = values
    return float(x), -float(y), -float(z)


def turned(quaternion: Numbers) -> Quaternion:
    """An orientation in the other frames; its own inverse."""
    w, x, y, z = quaternion
    return float(w), float(x), -float(y), -float(z)


def to_vector3r(values: Numbers) -> dict[str, float]:
    """Three numbers as plain data of AirSim's type Vector3r."""
    x, y, z = values
    return {"x_val": float(x), "y_val": float(y), "z_val": float(z)}


def _numbers_of(data: Any, kind: str, names: Sequence[str]) -> list[float]:  # noqa: ANN401 - a client's
    """Numbers of an object of the API by name, or a `BadInputError`; `kind`: the type that it must have."""
    try:
        return [float(data[name]) for name in names]
    except (KeyError, TypeError, ValueError):
        raise BadInputError(f"{data!r}: allowed: a {kind} ({', '.join(names)})") from None


def from_vector3r(data: Any) -> Triple:  # noqa: ANN401 - a client's
    """Numbers of a Vector3r.

    Raises:
        BadInputError: The data is something else.
    """
    x, y, z = _numbers_of(data, "Vector3r", ("x_val", "y_val", "z_val"))
    return x, y, z


def to_quaternionr(quaternion: Numbers) -> dict[str, float]:
    """A quaternion (w, x, y, z) as plain data of AirSim's type Quaternionr."""
    w, x, y, z = quaternion
    return {"w_val": float(w), "x_val": float(x), "y_val": float(y), "z_val": float(z)}


def from_quaternionr(data: Any) -> Quaternion:  # noqa: ANN401 - a client's
    """Numbers w x y z of a Quaternionr.

    Raises:
        BadInputError: The data is something else.
    """
    w, x, y, z = _numbers_of(data, "Quaternionr", ("w_val", "x_val", "y_val", "z_val"))
    return w, x, y, z


def to_pose(position: Numbers, orientation: Numbers) -> Data:
    """Pose, from NED numbers."""
    return {"position": to_vector3r(position), "orientation": to_quaternionr(orientation)}


def from_pose(data: Any) -> tuple[Triple, Quaternion]:  # noqa: ANN401 - a client's
    """Position and quaternion of a Pose.

    Raises:
        BadInputError: The data is something else.
    """
    if not isinstance(data, Mapping) or not {"position", "orientation"} <= set(data):
        raise BadInputError(f"{data!r}: allowed: a Pose (position, orientation)")
    return from_vector3r(data["position"]), from_quaternionr(data["orientation"])


def to_geo_point(ned: Numbers) -> dict[str, float]:
    """GeoPoint of a place in NED (m), on the tangential plane at `HOME`."""
    return dict(zip(_GEO_POINT, geodetic(ned, HOME), strict=True))


def from_geo_point(data: Any) -> Triple:  # noqa: ANN401 - a client's
    """Inverse of `to_geo_point`.

    Raises:
        BadInputError: The data is something else.
    """
    latitude, longitude, altitude = _numbers_of(data, "GeoPoint", _GEO_POINT)
    return local(latitude, longitude, altitude, HOME)


def mount(position: Numbers, orientation: Numbers) -> tuple[float, ...]:
    """Pose of a sensor in our body frame, from its pose in AirSim's. Shape (7,)."""
    return (*flipped(position), *turned(orientation))


def looking(yaw_deg: float, pitch_deg: float, roll_deg: float = 0.0) -> Quaternion:
    """Orientation (FRD, w x y z) of a camera turned to the right, pitched up, and rolled to the right (deg)."""
    y = 0.5 * math.radians(yaw_deg)
    p = 0.5 * math.radians(pitch_deg)
    level = (cos(y) * cos(p), -sin(y) * sin(p), cos(y) * sin(p), sin(y) * cos(p))
    if roll_deg == 0.0:
        return level
    r = 0.5 * math.radians(roll_deg)
    w, x, y, z = times(level, (cos(r), sin(r), 0.0, 0.0))
    return w, x, y, z


def merged_pose(pose: tuple[Triple, Quaternion], current: tuple[Triple, Quaternion]) -> tuple[Triple, Quaternion]:
    """A pose, with what is NaN kept: each coordinate by itself, the orientation as a whole."""
    position = list(pose[0])
    orientation = pose[1]
    for axis, value in enumerate(position):
        if math.isnan(value):
            position[axis] = current[0][axis]
    if any(map(math.isnan, orientation)):
        orientation = current[1]
    return (position[0], position[1], position[2]), orientation
