"""The vehicle under a MAVLink autopilot, and the flight tasks of PX4's modes."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mavfi.flight.piloted import HOLD_S, YAW_GAIN, YAW_RATE, PilotedVehicle, Task, Yaw, clip, fly_path, from_body, land
from mavfi.numerics.elementary import atan2
from mavfi.numerics.frames import Triple

SETPOINT_TIMEOUT_US = 1_000_000
"""Age of a set-point of mode offboard from which the vehicle stops (us); PX4: COM_OF_LOSS_T."""
RETURN_HEIGHT = 5.0
"""Least height of a return to launch (m); PX4's default is 60 m, above the walls of some environments."""
FOREVER_S = 1e5
"""Time limit of tasks that have none (s)."""
_POSITION_GAIN = 0.9
_ORBIT_GAIN = 1.0
"""Velocity per distance from a position, and from an orbit (1/s)."""
_HOLD_SPEED = 2.0
_APPROACH_SPEED = 5.0
"""Largest speed that corrects a position, when holding it and on the way to it (m/s)."""


class MavVehicle(PilotedVehicle):
    """An `PilotedVehicle` that starts disarmed."""

    def _begin(self) -> None:
        super()._begin()
        self.sim.arm(False)


@dataclass(frozen=True, slots=True)
class Setpoint:
    """A set-point of mode offboard: each is None where the message leaves it out.

    Attributes:
        position: NED (m).
        velocity: NED (m/s), or forward, right, down with `body`.
        yaw: Clockwise from north (rad).
        yaw_rate: Clockwise (rad/s).
        body: Whether the velocity is along the heading.
        rotors: Rotor commands of an attitude set-point, see `sim.grounded.Grounded.rotors`.
    """

    position: tuple[float | None, float | None, float | None] = (None, None, None)
    velocity: tuple[float | None, float | None, float | None] = (None, None, None)
    yaw: float | None = None
    yaw_rate: float | None = None
    body: bool = False
    rotors: Callable[[int, np.ndarray], np.ndarray] | None = None


def hold(vehicle: PilotedVehicle) -> Task:
    """Stay here."""
    here = vehicle.position
    while True:
        if not vehicle.landed:
            offsets = [origin - now for origin, now in zip(here, vehicle.position, strict=True)]
            north, east, down = (clip(_POSITION_GAIN * offset, _HOLD_SPEED) for offset in offsets)
            vehicle.send((north, east, down), 0.0, HOLD_S)
        yield


def climb(vehicle: PilotedVehicle, height: float) -> Task:
    """Climb to a height above the origin (m), at 1.5 m/s like PX4."""
    north, east, _ = vehicle.position
    return (yield from fly_path(vehicle, [(north, east, -height)], 1.5, FOREVER_S, Yaw()))


def go_to(vehicle: PilotedVehicle, target: Triple, speed: float, yaw: float | None = None) -> Task:
    """Fly to a place in a straight line; the nose points along it unless a yaw is given."""
    facing = Yaw(is_rate=False, value=yaw or 0.0, forward=yaw is None)
    return (yield from fly_path(vehicle, [target], speed, FOREVER_S, facing))


def return_to_launch(vehicle: PilotedVehicle, speed: float) -> Task:
    """Fly home at a safe height, and land."""
    north, east, down = vehicle.position
    height = min(down, -RETURN_HEIGHT)
    yield from fly_path(vehicle, [(north, east, height), (0.0, 0.0, height)], speed, FOREVER_S, Yaw())
    return (yield from land(vehicle, FOREVER_S))


def orbit(vehicle: PilotedVehicle, centre: Triple, radius: float, speed: float, clockwise: bool) -> Task:
    """Circle around a place, nose to the centre."""
    sign = -1.0
    if clockwise:
        sign = 1.0
    while True:
        # unit vector (n, e) from the centre to the vehicle
        north, east, down = vehicle.position
        outward = (north - centre[0], east - centre[1])
        distance = max(math.hypot(*outward), 1e-6)
        n = outward[0] / distance
        e = outward[1] / distance

        # along the circle, and back to it
        inward = clip(_ORBIT_GAIN * (distance - radius), speed)
        velocity = (-n * inward - sign * e * speed, -e * inward + sign * n * speed, clip(centre[2] - down, 2.0))

        # turn with the circle, and towards its centre
        yaw_error = math.remainder(float(atan2(-e, -n)) - vehicle.yaw, 2.0 * math.pi)
        turn_rate = sign * speed / max(distance, 1.0)
        vehicle.send(velocity, clip(YAW_GAIN * yaw_error + turn_rate, YAW_RATE), HOLD_S)
        yield


def offboard(vehicle: PilotedVehicle, latest: Callable[[], tuple[Setpoint | None, int]]) -> Task:
    """Follow set-points; `latest` returns the last one and its time (us)."""
    while True:
        setpoint, time_us = latest()
        vehicle.sim.rotors = None
        if setpoint is None or vehicle.now_us - time_us > SETPOINT_TIMEOUT_US:
            vehicle.send((0.0, 0.0, 0.0), 0.0, HOLD_S)
        elif setpoint.rotors is not None:
            vehicle.sim.rotors = setpoint.rotors
        else:
            vehicle.send(_velocity_for(vehicle, setpoint), _yaw_rate_for(vehicle, setpoint), HOLD_S)
        yield


def _velocity_for(vehicle: PilotedVehicle, setpoint: Setpoint) -> Triple:
    """Velocity (NED, m/s): feed-forward, plus what a position set-point asks for."""
    x, y, z = (value or 0.0 for value in setpoint.velocity)
    if setpoint.body:
        x, y = from_body(vehicle, x, y)
    velocity = [x, y, z]
    for axis, (wanted, here) in enumerate(zip(setpoint.position, vehicle.position, strict=True)):
        if wanted is not None:
            velocity[axis] += clip(_POSITION_GAIN * (wanted - here), _APPROACH_SPEED)
    return velocity[0], velocity[1], velocity[2]


def _yaw_rate_for(vehicle: PilotedVehicle, setpoint: Setpoint) -> float:
    if setpoint.yaw is not None:
        yaw = Yaw(is_rate=False, value=setpoint.yaw or 0.0)  # -0 becomes 0
    else:
        yaw = Yaw(is_rate=True, value=setpoint.yaw_rate or 0.0)
    return yaw.rate(vehicle, (0.0, 0.0, 0.0))
