"""A vehicle that a program pilots: its state in NED, flight tasks, and rotor commands.

Its owner advances the time.  Semantics of the tasks are those of AirSim's MultirotorApiBase: take-off climbs 2 m at
0.5 m/s, landing sinks at up to 2 m/s, at the end at 0.2 m/s, until the vehicle is still for 10 periods, a place is
reached within 0.5 m, a path is followed by pursuit with a look-ahead.
"""

import hashlib
import math
from collections.abc import Generator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mavfi.errors import BadInputError
from mavfi.extras.airsim.frames import Quaternion, flipped, turned
from mavfi.extras.airsim.grounded import Contact, Grounded, Rotors
from mavfi.extras.shared.frames import Triple
from mavfi.flight.compose import resolve
from mavfi.levels.sensor.failures import Failures
from mavfi.levels.sensor.injector import FailingController
from mavfi.mission import MissionSpec, Scenario
from mavfi.numerics.elementary import atan2, cos, sin
from mavfi.numerics.rotations import rotation_matrix, yaw_of
from mavfi.sim.cascade import MEMORY_SIZE, YAW_REFERENCE, mix_rotors, wanted_rates
from mavfi.sim.engine import GRAVITY
from mavfi.sim.environments import build_world
from mavfi.sim.environments.world import World
from mavfi.sim.scene import STEP_US
from mavfi.sim.vehicle import airframe_of

TICK_US = 20_000
"""Period of a task (us): AirSim's getCommandPeriod."""
_EPOCH_NS = 1_600_000_000_000_000_000
"""Time stamp of the start of a simulation (ns since 1970): a constant, so that flights are reproducible."""
LANDED = 0
FLYING = 1
"""AirSim's LandedState."""
_AIRBORNE = 0.3
"""Height above which an armed vehicle counts as flying (m)."""
_LANDED_HEIGHT = 0.1
"""Height below which a vehicle at rest counts as landed (m)."""

Task = Generator[None, None, Any]


@dataclass(frozen=True, slots=True)
class EndedTask:
    """A task that ended: its number, and its result or the exception that it raised."""

    number: int
    result: Any


class PilotedVehicle:
    """One vehicle in one world, under the API.

    Its state is what its sensors measure, failures included; tasks fly by it.

    Args:
        spec: The mission, of which environment, seed, vehicle, wind and speed limit count.
        home: Origin of its NED, in the scene's NED (m), whose origin is the mission's start; it starts there.
        yaw_deg: Heading at the start, clockwise from north (deg); None = towards the mission's goal.
        is_armed: Whether its motors run at the start, on the ground.
        number: Among the vehicles, from 0; sensors of each have noise of their own.
        begin_us: Instant at which it appears (us).
        on_ground: Whether it starts on the ground with the motors idle, and NED has its origin there; else it hovers at
            the mission's start, and NED is the world's frame, turned.

    Attributes:
        home: As above.
        spec: Its mission.
        scenario: The mission, resolved.
        sim: The simulator since the last reset.
        origin: Origin of NED in the world (m). Shape (3,).
        landed: Whether it stands on the ground.
        api: Whether a program controls it.
        failures: Failures of its sensors and motors; they persist across resets.
        ended_tasks: Tasks that ended; the owner removes them.

    Raises:
        BadInputError: The mission cannot be flown from the ground.
    """

    spec: MissionSpec
    scenario: Scenario
    sim: Grounded

    def __init__(
        self,
        spec: MissionSpec,
        *,
        home: Triple = (0.0, 0.0, 0.0),
        yaw_deg: float | None = None,
        is_armed: bool = True,
        number: int = 0,
        begin_us: int = 0,
        on_ground: bool = True,
    ) -> None:
        self.home = home
        self.on_ground = on_ground
        self._yaw_deg = yaw_deg
        self._is_armed = is_armed
        self._vehicle_number = number
        self._base_us = begin_us
        self._collided_before = False
        self.ended_tasks: list[EndedTask] = []
        self._task: Task | None = None
        self.failures = Failures()
        self._number = 0
        self._task_us = 0
        self._digest = hashlib.sha256()
        self.load(spec)

    def load(self, spec: MissionSpec) -> None:
        """Fly in another world from now on.

        Raises:
            BadInputError: The mission cannot be flown from the ground; the vehicle stays where it is.
        """
        scenario = resolve(spec)
        world = build_world(scenario.environment, scenario.seed, scenario.start, scenario.goal)
        shift = np.array(flipped((*self.home[:2], 0.0)))
        world = replace(world, start=world.start + shift, goal=world.goal + shift)
        if self._vehicle_number:
            scenario = scenario.model_copy(update={"seed": scenario.seed + self._vehicle_number})
        self._start_in(world, scenario)
        self.spec = spec

    def _start_in(self, world: World, scenario: Scenario) -> None:
        """Replace the simulator."""
        sim = Grounded(world, scenario, on_ground=self.on_ground)
        if hasattr(self, "sim"):
            self.cancel()
            self._collided_before = self.has_ever_collided
            self._base_us += self.sim.time_us
            self.sim.close()
        self.sim = sim
        self.scenario = scenario
        self._begin()

    def _begin(self) -> None:
        """Set the state of a new simulator."""
        self.landed = self.on_ground
        self.api = False
        if self.on_ground:
            self.origin = self.sim.world.start.copy()
            self.sim.arm(True)  # AirSim's default: the rotors turn from the start on
        else:
            self.origin = np.zeros(3)
        self.origin[2] -= self.home[2]
        if not self._is_armed:
            self.sim.arm(False)
        if self._yaw_deg is not None:
            half = 0.5 * math.radians(self._yaw_deg)
            self.sim.place(self.sim.odometry[:3].copy(), np.array(turned((cos(half), 0.0, 0.0, sin(half)))))

    def reset(self) -> None:
        """Return to the start, and end a running task with False; time and obstacles are not reset."""
        self._start_in(self.sim.world, self.scenario)

    # ---- state, in NED and FRD --------------------------------------------------------------------------------------
    @property
    def now_us(self) -> int:
        """Time since the first start (us)."""
        return self._base_us + self.sim.time_us

    @property
    def stamp(self) -> int:
        """Time stamp (ns)."""
        return _EPOCH_NS + 1000 * self.now_us

    @property
    def measured_state(self) -> np.ndarray:
        """The state that its sensors measure, as in `Simulator.odometry`. Shape (13,)."""
        return self.failures.state(self.now_us, self.sim.odometry)

    def in_ned(self, odometry: np.ndarray) -> tuple[Triple, Quaternion, Triple, Triple]:
        """Position (m), orientation, velocity (m/s) and rates (rad/s) of a state."""
        position = odometry[:3] - self.origin
        velocity = odometry[3:6]
        rates = odometry[10:13]
        return flipped(position), turned(odometry[6:10]), flipped(velocity), flipped(rates)

    @property
    def position(self) -> Triple:
        """NED (m)."""
        return flipped(self.measured_state[:3] - self.origin)

    @property
    def velocity(self) -> Triple:
        """NED (m/s)."""
        return flipped(self.measured_state[3:6])

    @property
    def orientation(self) -> Quaternion:
        """Body FRD to NED. w x y z."""
        return turned(self.measured_state[6:10])

    @property
    def rates(self) -> Triple:
        """FRD (rad/s)."""
        return flipped(self.measured_state[10:13])

    def imu(self) -> np.ndarray:
        """Specific force (m/s^2) and rates (rad/s), body frame (z up), with noise. Shape (6,)."""
        return self.failures.imu(self.now_us, self.sim.imu())

    @property
    def radius(self) -> float:
        """Radius of the sphere that touches others (m)."""
        return self.scenario.vehicle.collision_radius

    @property
    def yaw(self) -> float:
        """Clockwise from north (rad)."""
        return float(yaw_of(np.array(self.orientation)))

    @property
    def collision(self) -> Contact | None:
        """The last contact that is a collision: with an obstacle, and for a start in the air also with the ground."""
        if self.sim.touched is not None or self.on_ground:
            return self.sim.touched
        return self.sim.landed_at

    @property
    def has_collided(self) -> bool:
        """Whether there was a collision; for a start in the air, by the rule of missions."""
        if self.on_ground:
            return self.sim.touched is not None
        return self.sim.collided

    @property
    def has_ever_collided(self) -> bool:
        """Whether there was a collision, also before a reset or a change of pose."""
        return self._collided_before or self.has_collided

    def to_world(self, ned: Triple) -> np.ndarray:
        """A place in the world's frame (m). Shape (3,)."""
        position: np.ndarray = np.array(flipped(ned)) + self.origin
        return position

    def to_ned(self, point: np.ndarray) -> Triple:
        """A place of the world in NED (m)."""
        return flipped(point - self.origin)

    def digest(self) -> str:
        """SHA-256 of all states so far, every 20 ms and at the end of each step."""
        return self._digest.hexdigest()

    # ---- time -------------------------------------------------------------------------------------------------------
    def step(self, until_us: int) -> None:
        """Let time pass up to an instant, a multiple of 4 ms; a task acts every 20 ms from its start."""
        while self.now_us < until_us:
            # up to the next period of the task, at most 20 ms
            next_us = min(until_us, self.now_us + TICK_US)
            if self._task is not None:
                next_us = min(next_us, self._task_us)
            self._let_controller_fail()
            self.sim.advance(next_us - self._base_us)
            self._digest.update(self.sim.odometry.tobytes())

            # what the new state means: in the air or on the ground, and the task's turn
            if self.sim.armed and self.sim.height > _AIRBORNE:
                self.landed = False
            elif self.sim.resting:
                self.landed = True
            if self._task is not None and self.now_us >= self._task_us:
                self._act()

    def _let_controller_fail(self) -> None:
        """With failures, the controller reads and commands through them; arming and placing replace it."""
        sim = self.sim
        if self.failures.active and not isinstance(sim.controller, FailingController):
            sim.controller = FailingController(sim.controller, self.failures, sim.max_thrust, self._base_us)

    def _act(self) -> None:
        """One period of the task."""
        assert self._task is not None  # precondition
        try:
            next(self._task)
        except StopIteration as end:
            self._end(end.value)
        except Exception as error:  # noqa: BLE001 - becomes the answer
            self._end(error)
        else:
            self._task_us = self.now_us + TICK_US

    # ---- tasks ------------------------------------------------------------------------------------------------------
    @property
    def busy(self) -> bool:
        """Whether a task runs."""
        return self._task is not None

    def start(self, task: Task) -> int:
        """Start a task, whose first period is now, and end the previous one with False; returns its number."""
        self.cancel()
        self._number += 1
        self._task = task
        self._act()
        return self._number

    def cancel(self) -> None:
        """End the running task, if any, with False."""
        if self._task is not None:
            self._task.close()
            self._end(False)

    def _end(self, result: Any) -> None:
        """End the task with its result, and leave the vehicle without a command."""
        self._task = None
        self.ended_tasks.append(EndedTask(self._number, result))
        self.sim.rotors = None
        self.sim.command(np.zeros(4), 0.0)

    def finish(self, longest_us: int) -> None:
        """Let time pass until the task ends, but not beyond an instant (us)."""
        while self._task is not None and self.now_us < longest_us:
            self.step(min(longest_us, max(self._task_us, self.now_us + STEP_US)))

    def send(self, velocity: Triple, yaw_rate: float, seconds: float) -> None:
        """Command a velocity (NED, m/s) and yaw rate (rad/s, clockwise) for a time (s)."""
        self.sim.command(np.array([*flipped(velocity), -yaw_rate]), seconds)

    def place(self, position: Triple, orientation: Quaternion) -> None:
        """Put it to a pose (NED)."""
        collided = self.has_ever_collided
        self.sim.place(self.to_world(position), np.array(turned(orientation)))
        self._collided_before = collided
        self.note_landing()

    def note_landing(self) -> None:
        """Set `landed` by the height."""
        self.landed = self.sim.height < _LANDED_HEIGHT


# ---- flight tasks, generators that act every 20 ms -------------------------------------------------------------------
DISTANCE_ACCURACY = 0.5
"""Distance within which a place is reached (m)."""
TAKEOFF_HEIGHT = 2.0
"""Climb at take-off (m)."""
TAKEOFF_SPEED = 0.5
"""Speed of that climb (m/s)."""
LOW = 2.0
"""Height below which a landing sinks slowly (m)."""
LANDING_SPEED = 0.2
"""Sink rate below `LOW` (m/s)."""
HIGH_LANDING_SPEED = 2.0
"""Largest sink rate above it (m/s)."""
_SINK_GAIN = 0.5
"""Sink rate above it (m/s) per height (m)."""
APPROX_ZERO_SPEED = 0.05
"""Speed (m/s), and rate (rad/s), up to which a vehicle counts as being at rest."""
STILL_PERIODS = 10
"""Periods at rest after which a landing is complete."""
_FOREVER_S = 1e6
"""Duration of a task without an end (s)."""
_HOLD_S = 0.06
"""Validity of a command that is renewed every period (s)."""
_YAW_GAIN = 2.5
"""Yaw rate (rad/s) per error (rad)."""
_YAW_RATE = 1.5
"""Its limit (rad/s)."""
_HEIGHT_GAIN = 1.0
"""Vertical speed (m/s) per error of height (m)."""
_CLIMB = 3.0
"""Its limit (m/s)."""
_RETURN_GAIN = 0.5
"""Velocity (m/s) per deviation from the place of a turn (m)."""
_LEAST_SPEED = 0.4
"""Speed at the end of a path (m/s)."""
_LEAST_HEADING_SPEED = 0.1
"""Horizontal speed below which the nose does not follow the velocity (m/s)."""
_LOOKAHEAD_S = 0.6
"""Distance of the pursued point / speed, unless it is given (s)."""
_CANDIDATES = 21
"""Points of the path among which the nearest one is searched for, per period."""


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

    def rate(self, vehicle: PilotedVehicle, velocity: Sequence[float]) -> float:
        """Yaw rate (rad/s) now, at a velocity (NED, m/s)."""
        if self.is_rate:
            return self.value
        setpoint = self.value
        if self.forward:
            if math.hypot(velocity[0], velocity[1]) < _LEAST_HEADING_SPEED:
                return 0.0
            setpoint += float(atan2(velocity[1], velocity[0]))
        return clip(_YAW_GAIN * math.remainder(setpoint - vehicle.yaw, 2.0 * math.pi), _YAW_RATE)


def clip(value: float, limit: float) -> float:
    """The value, limited to -limit .. limit."""
    return min(limit, max(-limit, value))


def _end_of(vehicle: PilotedVehicle, seconds: float) -> int:
    """The instant (us) at which a task of this duration ends; NaN ends at once, infinity practically never."""
    if math.isnan(seconds):
        return vehicle.now_us
    return vehicle.now_us + round(1e6 * max(0.0, min(seconds, _FOREVER_S)))


def fly_velocity(vehicle: PilotedVehicle, velocity: Triple, seconds: float, yaw: Yaw) -> Task:
    """Fly at a velocity for a time; with a yaw rate, it is commanded once, for the whole time."""
    end = _end_of(vehicle, seconds)
    if yaw.is_rate:
        vehicle.send(velocity, yaw.value, seconds)
    while vehicle.now_us < end:
        if not yaw.is_rate:
            vehicle.send(velocity, yaw.rate(vehicle, velocity), _HOLD_S)
        yield
    return True


def fly_velocity_at(vehicle: PilotedVehicle, velocity: tuple[float, float], z: float, seconds: float, yaw: Yaw) -> Task:
    """Fly at a horizontal velocity and a height, for a time."""
    end = _end_of(vehicle, seconds)
    while vehicle.now_us < end:
        down = clip(_HEIGHT_GAIN * (z - vehicle.position[2]), _CLIMB)
        vehicle.send((*velocity, down), yaw.rate(vehicle, velocity), _HOLD_S)
        yield
    return True


def from_body(vehicle: PilotedVehicle, forward: float, right: float) -> tuple[float, float]:
    """A horizontal velocity north and east (m/s), from one along the present heading."""
    c = float(cos(vehicle.yaw))
    s = float(sin(vehicle.yaw))
    return forward * c - right * s, forward * s + right * c


class _Path:
    """A polyline by arc length.

    Attributes:
        points: Its vertices, without repetitions (m). Shape (n, 3).
        arc: Arc length of each (m). Shape (n,).
        length: Arc length of the last (m).
    """

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
    vehicle: PilotedVehicle, points: Sequence[Triple], speed: float, timeout: float, yaw: Yaw, lookahead: float = -1.0
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
    if not lookahead > 0.0:  # also if it is NaN
        lookahead = max(_LOOKAHEAD_S * speed, 1.5 * DISTANCE_ACCURACY)
    end = _end_of(vehicle, timeout)
    arc = 0.0  # arc length of the nearest point of the path
    while vehicle.now_us < end:
        # the nearest point of the path, not before the last one: a path may cross itself
        position = np.array(vehicle.position)
        candidates = np.linspace(arc, min(arc + 2.0 * lookahead, path.length), _CANDIDATES)
        squared_distances = [float(np.square(path.at(float(candidate)) - position).sum()) for candidate in candidates]
        arc = float(candidates[int(np.argmin(squared_distances))])
        distance_to_end = math.dist(path.points[-1], position)
        if path.length - arc < DISTANCE_ACCURACY and distance_to_end < DISTANCE_ACCURACY:
            return True

        # fly to the point ahead of it, slower near the end
        to_pursued = path.at(min(arc + lookahead, path.length)) - position
        reduced_speed = min(speed, max(_LEAST_SPEED, path.length - arc))
        scale = reduced_speed / max(math.hypot(*to_pursued), 1e-9)
        velocity = (float(to_pursued[0]) * scale, float(to_pursued[1]) * scale, float(to_pursued[2]) * scale)
        vehicle.send(velocity, yaw.rate(vehicle, velocity), _HOLD_S)
        yield
    return False


def take_off(vehicle: PilotedVehicle, timeout: float) -> Task:
    """Climb by 2 m.

    Raises:
        BadInputError: The vehicle is not at rest.
    """
    if math.hypot(*vehicle.velocity) > APPROX_ZERO_SPEED:
        raise BadInputError("takeoff: the vehicle moves; allowed: at rest")
    north, east, down = vehicle.position
    return (yield from fly_path(vehicle, [(north, east, down - TAKEOFF_HEIGHT)], TAKEOFF_SPEED, timeout, Yaw()))


def land(vehicle: PilotedVehicle, timeout: float) -> Task:
    """Sink until the vehicle stands still on the ground."""
    end = _end_of(vehicle, timeout)
    still_periods = 0
    while vehicle.now_us < end:
        if vehicle.sim.height < LOW:
            sink = LANDING_SPEED
        else:
            sink = min(HIGH_LANDING_SPEED, _SINK_GAIN * vehicle.sim.height)
        vehicle.send((0.0, 0.0, sink), 0.0, _HOLD_S)
        yield
        if abs(vehicle.velocity[2]) <= APPROX_ZERO_SPEED:
            still_periods += 1
        else:
            still_periods = 0
        if still_periods > STILL_PERIODS:
            vehicle.sim.rest()
            vehicle.note_landing()
            return True
    return False


def hover(vehicle: PilotedVehicle) -> Task:
    """Stop, and stay."""
    vehicle.send((0.0, 0.0, 0.0), 0.0, 0.0)
    yield
    return True


def turn_to(vehicle: PilotedVehicle, yaw: float, timeout: float, margin: float) -> Task:
    """Turn on the spot to a yaw (rad), within a margin (rad)."""
    end = _end_of(vehicle, timeout)
    spot = vehicle.position
    while vehicle.now_us < end:
        yaw_error = math.remainder(yaw - vehicle.yaw, 2.0 * math.pi)
        if abs(yaw_error) < max(margin, math.radians(1.0)) and abs(vehicle.rates[2]) < APPROX_ZERO_SPEED:
            return True
        # back to the spot from which the turn began
        north, east, down = (_RETURN_GAIN * (a - b) for a, b in zip(spot, vehicle.position, strict=True))
        vehicle.send((north, east, down), clip(_YAW_GAIN * yaw_error, _YAW_RATE), _HOLD_S)
        yield
    return False


def fly_rotors(vehicle: PilotedVehicle, rotors: Rotors, seconds: float) -> Task:
    """Rotor commands for a time, see `at_rates`."""
    end = _end_of(vehicle, seconds)
    vehicle.sim.rotors = rotors
    while vehicle.now_us < end:
        yield
    return True


# ---- rotor commands for attitudes, body rates and motors, from the inner loops of our cascade ------------------------
_THRUST_HEIGHT_GAIN = 1.5
"""Height hold: vertical speed (m/s) per error of height (m)."""
_THRUST_CLIMB = 2.0
"""Its limit (m/s)."""
_THRUST_CLIMB_GAIN = 2.5
"""Vertical acceleration (m/s^2) per error of vertical speed (m/s)."""
_LEAST_UP = 0.5
"""Least vertical component of the body's z axis for which the thrust makes up."""


@dataclass(frozen=True, slots=True)
class Vertical:
    """Set-point of the collective thrust: `throttle`, a share of the largest thrust, or a height `z` (NED, m)."""

    throttle: float | None = None
    z: float = 0.0


def _collective(vehicle: PilotedVehicle, vertical: Vertical, odometry: np.ndarray, up: float) -> float:
    """Collective thrust (N); `up` = vertical component of the body's z axis."""
    frame = airframe_of(vehicle.scenario.vehicle)
    if vertical.throttle is not None:
        return 4.0 * frame.max_thrust * min(1.0, max(0.0, vertical.throttle))
    height = float(vehicle.to_world((0.0, 0.0, vertical.z))[2])
    climb = clip(_THRUST_HEIGHT_GAIN * (height - float(odometry[2])), _THRUST_CLIMB)
    return frame.mass * (GRAVITY + _THRUST_CLIMB_GAIN * (climb - float(odometry[5]))) / max(up, _LEAST_UP)


def _mix(vehicle: PilotedVehicle, rates: Triple, vertical: Vertical, odometry: np.ndarray) -> np.ndarray:
    """Rotor commands (N) for body rates (FLU, rad/s) and a collective thrust. Shape (4,)."""
    frame = airframe_of(vehicle.scenario.vehicle)
    matrix = np.empty((3, 3))
    rotation_matrix(odometry[6:10], matrix)
    torque = (
        frame.inertia_x * frame.rate_gain_x * (rates[0] - float(odometry[10])),
        frame.inertia_y * frame.rate_gain_y * (rates[1] - float(odometry[11])),
        frame.inertia_z * frame.rate_gain_z * (rates[2] - float(odometry[12])),
    )
    thrusts = np.empty(4)
    mix_rotors(frame, _collective(vehicle, vertical, odometry, float(matrix[2, 2])), torque, thrusts)
    return thrusts


def at_rates(vehicle: PilotedVehicle, roll: float, pitch: float, yaw: float, vertical: Vertical) -> Rotors:
    """Rotor commands for body rates (FRD, rad/s)."""
    return lambda time_us, odometry: _mix(vehicle, (roll, -pitch, -yaw), vertical, odometry)


def at_attitude(
    vehicle: PilotedVehicle, roll: float, pitch: float, yaw: float, yaw_rate: float | None, vertical: Vertical
) -> Rotors:
    """Rotor commands for an attitude (FRD, rad): roll, pitch, and yaw or (if not None) its rate (rad/s)."""
    memory = np.zeros(MEMORY_SIZE)
    frame = airframe_of(vehicle.scenario.vehicle)
    memory[YAW_REFERENCE] = float(yaw_of(vehicle.sim.odometry[6:10]))

    def rotors(time_us: int, odometry: np.ndarray) -> np.ndarray:
        matrix = np.empty((3, 3))
        heading = float(yaw_of(odometry[6:10]))
        rotation_matrix(odometry[6:10], matrix)

        # the direction of the thrust: tilted against the present heading, then turned into the world's frame
        forward = sin(-pitch) * cos(roll)
        left = -sin(roll)
        up = cos(pitch) * cos(roll)
        c = cos(heading)
        s = sin(heading)
        force = np.array([c * forward - s * left, s * forward + c * left, up])

        # yaw: the set-point of the angle, or its rate
        rate = 0.0
        if yaw_rate is None:
            memory[YAW_REFERENCE] = -yaw
        else:
            rate = -yaw_rate
        rates = wanted_rates(frame, memory, rate, force, matrix, heading)
        return _mix(vehicle, rates, vertical, odometry)

    return rotors


def motors(vehicle: PilotedVehicle, shares: tuple[float, float, float, float]) -> Rotors:
    """Rotor commands from shares of the largest thrust, 0 to 1: front right, rear left, front left, rear right."""
    thrusts = vehicle.sim.max_thrust * np.clip(np.array(shares, float), 0.0, 1.0)
    return lambda time_us, odometry: thrusts
