"""The vehicle under a MAVLink autopilot, and the flight tasks of PX4's modes."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from mavfi.errors import BadInputError
from mavfi.flight.compose import resolve
from mavfi.flight.piloted import (
    HOLD_S,
    TICK_US,
    YAW_GAIN,
    YAW_RATE,
    PilotedVehicle,
    Task,
    Vertical,
    Yaw,
    at_attitude,
    clip,
    fly_path,
    from_body,
    land,
)
from mavfi.mission import MissionSpec
from mavfi.numerics.elementary import atan2
from mavfi.numerics.frames import Triple
from mavfi.sim.engine import GRAVITY
from mavfi.sim.environments.registry import SCAN_GENERATOR
from mavfi.sim.vehicle import airframe_of

SETPOINT_TIMEOUT_US = 1_000_000
"""Age of a set-point of mode offboard from which the vehicle stops (us); PX4: COM_OF_LOSS_T."""
FOREVER_S = 1e5
"""Time limit of tasks that have none (s)."""
_POSITION_GAIN = 0.9
_ORBIT_GAIN = 1.0
"""Velocity per distance from a position, and from an orbit (1/s)."""
_LEAST_STICK_SPEED = 0.05
"""Commanded speed up to which sticks count as centred (m/s)."""
_SETTLED = 0.1
"""Error of the height at which a take-off ends (m)."""
_SETTLING_US = 5_000_000
"""Longest time between the end of its climb and that (us)."""
_HOLD_SPEED = 2.0
_APPROACH_SPEED = 5.0
"""Largest speed that corrects a position, when holding it and on the way to it (m/s)."""


class MavVehicle(PilotedVehicle):
    """A `PilotedVehicle` that starts disarmed."""

    def load(self, spec: MissionSpec) -> None:
        """See `PilotedVehicle.load`; a scan is refused before it is read, which would need a goal."""
        environment = resolve(spec).environment
        if environment.generator == SCAN_GENERATOR:
            raise BadInputError(
                f"environment {environment.name}: a scan, which has no ground to stand on; allowed: other environments"
            )
        super().load(spec)

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


@dataclass(frozen=True, slots=True)
class Sticks:
    """Positions of a pilot's sticks, -1 to 1: right, forward, up, and clockwise."""

    roll: float = 0.0
    pitch: float = 0.0
    throttle: float = 0.0
    yaw: float = 0.0


def hold(vehicle: PilotedVehicle, yaw: float | None = None, place: Triple | None = None) -> Task:
    """Stay here or at a place nearby, and turn to a yaw (rad) if there is one."""
    here = place or vehicle.position
    facing = Yaw()
    if yaw is not None:
        facing = Yaw(is_rate=False, value=yaw)
    while True:
        if not vehicle.landed:
            velocity = _towards(vehicle, here)
            vehicle.send(velocity, facing.rate(vehicle, velocity), HOLD_S)
        yield


def _towards(vehicle: PilotedVehicle, place: Triple) -> Triple:
    """Velocity (NED, m/s) that holds a place."""
    offsets = [origin - now for origin, now in zip(place, vehicle.position, strict=True)]
    north, east, down = (clip(_POSITION_GAIN * offset, _HOLD_SPEED) for offset in offsets)
    return north, east, down


def climb(vehicle: PilotedVehicle, height: float, speed: float = 1.5) -> Task:
    """Climb to a height above the origin (m), at a speed (m/s) that is PX4's default of MPC_TKO_SPEED."""
    north, east, _ = vehicle.position
    top = (north, east, -height)
    yield from fly_path(vehicle, [top], speed, FOREVER_S, Yaw())
    end_us = vehicle.now_us + _SETTLING_US
    for _ in hold(vehicle, place=top):
        if abs(vehicle.position[2] + height) < _SETTLED or vehicle.now_us >= end_us:
            return
        yield


def go_to(vehicle: PilotedVehicle, target: Triple, speed: float, yaw: float | None = None) -> Task:
    """Fly to a place in a straight line; the nose points along it unless a yaw is given."""
    facing = Yaw(is_rate=False, value=yaw or 0.0, forward=yaw is None)
    return (yield from fly_path(vehicle, [target], speed, FOREVER_S, facing))


def wait(vehicle: PilotedVehicle, seconds: float, yaw: float | None = None) -> Task:
    """Stay here for a time (s)."""
    end_us = vehicle.now_us + round(1e6 * max(0.0, seconds))
    for _ in hold(vehicle, yaw):
        if vehicle.now_us >= end_us:
            return
        yield


def yaw_of_condition(vehicle: PilotedVehicle, parameters: Sequence[float]) -> float:
    """Yaw (rad) of a CONDITION_YAW: an angle (degrees), absolute, or with parameter 4 relative in a direction."""
    yaw = math.radians(parameters[0])
    if parameters[3] != 1.0:
        return yaw
    if parameters[2] < 0.0:
        return vehicle.yaw - yaw
    return vehicle.yaw + yaw


def return_to(vehicle: PilotedVehicle, home: Triple, height: float, speed: float) -> Task:
    """Fly home at a height above it (m) or the present one if that is greater, and land."""
    north, east, down = vehicle.position
    cruise = min(down, home[2] - height)
    points = [(north, east, cruise), (home[0], home[1], cruise)]
    yield from fly_path(vehicle, points, speed, FOREVER_S, Yaw())
    return (yield from land(vehicle, FOREVER_S))


def pilot(vehicle: PilotedVehicle, latest: Callable[[], Sticks], speed: float, climb_speed: float) -> Task:
    """Sticks command velocities along the heading, up to given ones (m/s); with all in the centre it stays."""
    here = vehicle.position
    while True:
        sticks = latest()
        north, east = from_body(vehicle, speed * sticks.pitch, speed * sticks.roll)
        velocity = (north, east, -climb_speed * sticks.throttle)
        if max(map(abs, velocity)) > _LEAST_STICK_SPEED:
            here = vehicle.position
        else:
            velocity = _towards(vehicle, here)
        if not vehicle.landed or velocity[2] < 0.0:
            vehicle.send(velocity, YAW_RATE * sticks.yaw, HOLD_S)
        yield


def pilot_attitude(
    vehicle: PilotedVehicle, latest: Callable[[], Sticks], tilt: float, climb_speed: float, *, holds_height: bool
) -> Task:
    """Sticks command the tilt, up to a given one (rad), and nothing holds the place.

    The throttle commands a vertical speed, up to a given one (m/s), or the thrust, which is that of hover in its
    centre.
    """
    frame = airframe_of(vehicle.scenario.vehicle)
    hover = frame.mass * GRAVITY / (4.0 * frame.max_thrust)  # share of the largest thrust
    down = vehicle.position[2]
    while True:
        sticks = latest()
        down -= climb_speed * sticks.throttle * 1e-6 * TICK_US
        if vehicle.landed and sticks.throttle <= 0.0:
            down = vehicle.position[2]
            vehicle.sim.rotors = None
        else:
            vertical = Vertical(z=down)
            if not holds_height:
                upper = (1.0 - hover) * max(0.0, sticks.throttle)
                vertical = Vertical(throttle=hover * (1.0 + min(0.0, sticks.throttle)) + upper)
            attitude = (tilt * sticks.roll, -tilt * sticks.pitch, vehicle.yaw, YAW_RATE * sticks.yaw)
            vehicle.sim.rotors = at_attitude(vehicle, *attitude, vertical)
        yield


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


def offboard(
    vehicle: PilotedVehicle,
    latest: Callable[[], tuple[Setpoint | None, int]],
    timeout_us: float = SETPOINT_TIMEOUT_US,
) -> Task:
    """Follow set-points; `latest` returns the last one and its time (us), after which it counts up to a timeout."""
    while True:
        setpoint, time_us = latest()
        vehicle.sim.rotors = None
        if setpoint is None or vehicle.now_us - time_us > timeout_us:
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
