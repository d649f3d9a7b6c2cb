"""AirSim's flight tasks as generators that act every 20 ms.

Semantics of AirSim's MultirotorApiBase: take-off climbs 2 m at 0.5 m/s, landing sinks at up to 2 m/s, at the end at
0.2 m/s, until the vehicle is still for 10 periods, a place is reached within 0.5 m, a path is followed by pursuit with
a look-ahead.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mavfi.errors import BadInputError
from mavfi.extras.airsim.frames import Triple
from mavfi.extras.airsim.vehicle import ApiVehicle, Task
from mavfi.numerics.elementary import atan2, cos, sin
from mavfi.sim.grounded import Rotors

DISTANCE_ACCURACY = 0.5
"""Distance within which a place is reached (m)."""
TAKEOFF_HEIGHT, TAKEOFF_SPEED = 2.0, 0.5
LANDING_SPEED, HIGH_LANDING_SPEED, LOW = 0.2, 2.0, 2.0
"""Sink rates (m/s), the slower one below the height `LOW` (m)."""
APPROX_ZERO_SPEED = 0.05
STILL_PERIODS = 10
_FOREVER_S = 1e6
HOLD_S = 0.06
"""Validity of a command that is renewed every period (s)."""
YAW_GAIN, YAW_RATE = 2.5, 1.5
"""Yaw rate (rad/s) per error (rad), and its limit (rad/s)."""
_HEIGHT_GAIN, _CLIMB = 1.0, 3.0
_LEAST_SPEED = 0.4
"""At the end of a path (m/s)."""


@dataclass(frozen=True, slots=True)
class Yaw:
    """AirSim's YawMode and DrivetrainType.

    Attributes:
        is_rate: Whether `value` is a rate.
        value: Rate or angle, clockwise (rad/s or rad).
        forward: Whether the nose points along the velocity (ForwardOnly), plus `value`; only without `is_rate`.
    """

    is_rate: bool = True
    value: float = 0.0
    forward: bool = False

    def rate(self, vehicle: ApiVehicle, velocity: Sequence[float]) -> float:
        """Yaw rate (rad/s) now, at a velocity (NED, m/s)."""
        if self.is_rate:
            return self.value
        wanted = self.value
        if self.forward:
            if math.hypot(velocity[0], velocity[1]) < 0.1:
                return 0.0
            wanted += float(atan2(velocity[1], velocity[0]))
        return clip(YAW_GAIN * math.remainder(wanted - vehicle.yaw, 2.0 * math.pi), YAW_RATE)


def clip(value: float, limit: float) -> float:
    """The value, limited to -limit .. limit."""
    return min(limit, max(-limit, value))


def _end_of(vehicle: ApiVehicle, seconds: float) -> int:
    """The instant (us) at which a task of this duration ends; a duration that is not finite never ends."""
    bounded = 0.0 if math.isnan(seconds) else min(seconds, _FOREVER_S)
    return vehicle.now_us + round(1e6 * max(0.0, bounded))


def fly_velocity(vehicle: ApiVehicle, velocity: Triple, seconds: float, yaw: Yaw) -> Task:
    """Fly at a velocity for a time; with a yaw rate, it is commanded once, for the whole time."""
    end = _end_of(vehicle, seconds)
    if yaw.is_rate:
        vehicle.send(velocity, yaw.value, seconds)
    while vehicle.now_us < end:
        if not yaw.is_rate:
            vehicle.send(velocity, yaw.rate(vehicle, velocity), HOLD_S)
        yield
    return True


def fly_velocity_at(vehicle: ApiVehicle, velocity: tuple[float, float], z: float, seconds: float, yaw: Yaw) -> Task:
    """Fly at a horizontal velocity and a height, for a time."""
    end = _end_of(vehicle, seconds)
    while vehicle.now_us < end:
        down = clip(_HEIGHT_GAIN * (z - vehicle.position[2]), _CLIMB)
        vehicle.send((*velocity, down), yaw.rate(vehicle, velocity), HOLD_S)
        yield
    return True


def from_body(vehicle: ApiVehicle, forward: float, right: float) -> tuple[float, float]:
    """A horizontal velocity north and east (m/s), from one along the present heading."""
    c, s = float(cos(vehicle.yaw)), float(sin(vehicle.yaw))
    return forward * c - right * s, forward * s + right * c


class _Path:
    """A polyline by arc length."""

    def __init__(self, points: Sequence[Sequence[float]]) -> None:
        distinct = [np.array(points[0], float)]
        for point in points[1:]:
            if math.dist(point, distinct[-1]) > 1e-6:
                distinct.append(np.array(point, float))
        self.points = np.array(distinct)
        self.arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(self.points, axis=0), axis=1))])
        self.length = float(self.arc[-1])

    def at(self, arc: float) -> np.ndarray:
        """The point at an arc length. Shape (3,)."""
        return np.array([np.interp(arc, self.arc, self.points[:, axis]) for axis in range(3)])


def fly_path(
    vehicle: ApiVehicle, points: Sequence[Triple], speed: float, timeout: float, yaw: Yaw, lookahead: float = -1.0
) -> Task:
    """Follow a path from the current position: pursue a point ahead of the nearest one on the path.

    Args:
        vehicle: The vehicle.
        points: NED (m).
        speed: Along the path (m/s).
        timeout: Longest duration (s).
        yaw: Heading.
        lookahead: Distance of the pursued point (m); 0 and less = chosen from the speed.

    Returns:
        Whether the end was reached.
    """
    if not (speed > 0.0 and math.isfinite(speed)) or not np.isfinite(points).all():
        raise BadInputError(f"path at {speed} m/s: allowed: finite points, and a speed above 0")
    path = _Path([vehicle.position, *points])
    ahead = lookahead if lookahead > 0.0 else max(0.6 * speed, 1.5 * DISTANCE_ACCURACY)
    end, arc = _end_of(vehicle, timeout), 0.0
    while vehicle.now_us < end:
        here = np.array(vehicle.position)
        window = np.linspace(arc, min(arc + 2.0 * ahead, path.length), 21)
        nearest = [float(np.square(path.at(float(candidate)) - here).sum()) for candidate in window]
        arc = float(window[int(np.argmin(nearest))])
        left = math.dist(path.points[-1], here)
        if path.length - arc < DISTANCE_ACCURACY and left < DISTANCE_ACCURACY:
            return True
        way = path.at(min(arc + ahead, path.length)) - here
        pace = min(speed, max(_LEAST_SPEED, path.length - arc))
        scale = pace / max(math.hypot(*way), 1e-9)
        velocity = (float(way[0]) * scale, float(way[1]) * scale, float(way[2]) * scale)
        vehicle.send(velocity, yaw.rate(vehicle, velocity), HOLD_S)
        yield
    return False


def take_off(vehicle: ApiVehicle, timeout: float) -> Task:
    """Climb by 2 m.

    Raises:
        BadInputError: The vehicle is not at rest.
    """
    if math.hypot(*vehicle.velocity) > APPROX_ZERO_SPEED:
        raise BadInputError("takeoff: the vehicle moves; allowed: at rest")
    north, east, down = vehicle.position
    return (yield from fly_path(vehicle, [(north, east, down - TAKEOFF_HEIGHT)], TAKEOFF_SPEED, timeout, Yaw()))


def land(vehicle: ApiVehicle, timeout: float) -> Task:
    """Sink until the vehicle stands still on the ground."""
    end, still = _end_of(vehicle, timeout), 0
    while vehicle.now_us < end:
        sink = LANDING_SPEED if vehicle.sim.height < LOW else min(HIGH_LANDING_SPEED, 0.5 * vehicle.sim.height)
        vehicle.send((0.0, 0.0, sink), 0.0, HOLD_S)
        yield
        still = still + 1 if abs(vehicle.velocity[2]) <= APPROX_ZERO_SPEED else 0
        if still > STILL_PERIODS:
            vehicle.sim.rest()
            vehicle.note_landing()
            return True
    return False


def hover(vehicle: ApiVehicle) -> Task:
    """Stop."""
    vehicle.send((0.0, 0.0, 0.0), 0.0, 0.0)
    yield
    return True


def turn_to(vehicle: ApiVehicle, yaw: float, timeout: float, margin: float) -> Task:
    """Turn on the spot to a yaw (rad), within a margin (rad)."""
    end, here = _end_of(vehicle, timeout), vehicle.position
    while vehicle.now_us < end:
        off = math.remainder(yaw - vehicle.yaw, 2.0 * math.pi)
        if abs(off) < max(margin, math.radians(1.0)) and abs(vehicle.rates[2]) < APPROX_ZERO_SPEED:
            return True
        back = [0.5 * (wanted - now) for wanted, now in zip(here, vehicle.position, strict=True)]
        vehicle.send((back[0], back[1], back[2]), clip(YAW_GAIN * off, YAW_RATE), HOLD_S)
        yield
    return False


def fly_rotors(vehicle: ApiVehicle, rotors: Rotors, seconds: float) -> Task:
    """Rotor commands for a time, see `mavfi.extras.airsim.attitude`."""
    end = _end_of(vehicle, seconds)
    vehicle.sim.rotors = rotors
    while vehicle.now_us < end:
        yield
    return True
