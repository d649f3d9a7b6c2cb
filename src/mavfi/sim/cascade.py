"""Our flight controller, a cascade: velocity -> attitude -> body rate -> rotors, in compiled code.

The structure is that of AirSim's SimpleFlight and of common autopilots.  It reads the true state, as SimpleFlight does.
It has no integrator in x and y; a small one in z corrects the remaining error due to drag.
"""

import math

import numpy as np

from mavfi.numerics.elementary import acos
from mavfi.numerics.jit import kernel_jit
from mavfi.numerics.rotations import rotation_matrix, wrap_angle, yaw_of
from mavfi.sim.controller import InitialConditions
from mavfi.sim.engine import GRAVITY
from mavfi.sim.environments.world import Voxels
from mavfi.sim.scene import STEP_US
from mavfi.sim.vehicle import Airframe, Body, airframe_of, step_body, write_odometry
from mavfi.sim.wind import Wind

STEP = STEP_US * 1e-6
"""Period of the controller (s)."""

MEMORY_SIZE = 2
"""Length of the controller's memory: yaw reference (rad), vertical integral (m)."""
YAW_REFERENCE, VERTICAL_INTEGRAL = 0, 1

_VERTICAL_ACCELERATION_LIMIT = 4.0
_INTEGRATED_ERROR_LIMIT = 0.5
_INTEGRAL_LIMIT = 2.0
_YAW_GAIN = 3.0
_YAW_LEASH = 0.15
_IDLE_SHARE, _FULL_SHARE = 0.1, 0.9


@kernel_jit
def _clip(value: float, limit: float) -> float:
    return min(limit, max(-limit, value))


@kernel_jit
def wanted_thrust(airframe: Airframe, memory: np.ndarray, setpoint: np.ndarray, velocity: np.ndarray) -> np.ndarray:
    """Velocity loop: the thrust vector that reduces the velocity error, within tilt and acceleration limits.

    Args:
        airframe: Vehicle.
        memory: Its vertical integral is updated. Shape (MEMORY_SIZE,).
        setpoint: Wanted vx vy vz (m/s) and yaw rate. Shape (4,).
        velocity: World frame (m/s). Shape (3,) or longer.

    Returns:
        Specific force (m/s^2), world frame. Shape (3,).
    """
    ax = airframe.velocity_gain * (setpoint[0] - velocity[0])
    ay = airframe.velocity_gain * (setpoint[1] - velocity[1])
    error_z = setpoint[2] - velocity[2]
    memory[VERTICAL_INTEGRAL] = _clip(
        memory[VERTICAL_INTEGRAL] + STEP * _clip(error_z, _INTEGRATED_ERROR_LIMIT), _INTEGRAL_LIMIT
    )
    az = airframe.velocity_gain * error_z + airframe.vertical_integral_gain * memory[VERTICAL_INTEGRAL]
    up = _clip(az, _VERTICAL_ACCELERATION_LIMIT) + GRAVITY
    limit = min(airframe.max_acceleration, up * airframe.tan_max_tilt)
    level = math.sqrt(ax * ax + ay * ay)
    if level > limit:
        ax *= limit / level
        ay *= limit / level
    return np.array((ax, ay, up))


@kernel_jit
def wanted_rates(
    airframe: Airframe, memory: np.ndarray, yaw_rate: float, force: np.ndarray, matrix: np.ndarray, yaw: float
) -> tuple[float, float, float]:
    """Attitude loop: body rates that align the body's z axis with the wanted force and track the heading.

    The heading reference is the integral of the wanted yaw rate, limited to a small distance from the true heading, so
    that a yaw rate of zero holds the heading.

    Args:
        airframe: Vehicle.
        memory: Its yaw reference is updated. Shape (MEMORY_SIZE,).
        yaw_rate: Wanted yaw rate (rad/s).
        force: Wanted specific force, world frame (m/s^2). Shape (3,).
        matrix: Body to world. Shape (3, 3).
        yaw: Heading (rad).

    Returns:
        Body rates (rad/s).
    """
    norm = math.sqrt(force[0] * force[0] + force[1] * force[1] + force[2] * force[2])
    x = (matrix[0, 0] * force[0] + matrix[1, 0] * force[1] + matrix[2, 0] * force[2]) / norm
    y = (matrix[0, 1] * force[0] + matrix[1, 1] * force[1] + matrix[2, 1] * force[2]) / norm
    z = (matrix[0, 2] * force[0] + matrix[1, 2] * force[1] + matrix[2, 2] * force[2]) / norm
    tilt = math.sqrt(x * x + y * y)
    stretch = acos(_clip(z, 1.0)) / tilt if tilt > 1e-9 else 1.0
    error = wrap_angle(memory[YAW_REFERENCE] + STEP * yaw_rate - yaw)
    error = _clip(error, _YAW_LEASH)
    memory[YAW_REFERENCE] = wrap_angle(yaw + error)
    gain = airframe.attitude_gain * stretch
    return -gain * y, gain * x, yaw_rate + _YAW_GAIN * error


@kernel_jit
def mix_rotors(airframe: Airframe, thrust: float, torque: tuple[float, float, float], wanted: np.ndarray) -> None:
    """Rotor thrusts for a collective thrust and a torque; each axis saturates as in an ESC, yaw last.

    Collective thrust leaves 10 % of a rotor's range at both ends, so that attitude stays controlled; roll and pitch
    share the margin to the nearer end, yaw gets the rest.

    Args:
        airframe: Vehicle.
        thrust: Collective thrust (N).
        torque: Body frame (N m).
        wanted: Output (N). Shape (4,) or longer.
    """
    top = airframe.max_thrust
    base = min(_FULL_SHARE * top, max(_IDLE_SHARE * top, 0.25 * thrust))
    room = min(base, top - base)
    roll = _clip(0.25 * torque[0] / airframe.lever, 0.5 * room)
    pitch = _clip(0.25 * torque[1] / airframe.lever, 0.5 * room)
    yaw = _clip(0.25 * torque[2] / airframe.torque_ratio, room - abs(roll) - abs(pitch))
    wanted[0] = base - roll - pitch - yaw
    wanted[1] = base + roll + pitch - yaw
    wanted[2] = base + roll - pitch + yaw
    wanted[3] = base - roll + pitch + yaw


@kernel_jit
def control(
    airframe: Airframe,
    memory: np.ndarray,
    setpoint: np.ndarray,
    qpos: np.ndarray,
    qvel: np.ndarray,
    matrix: np.ndarray,
    wanted: np.ndarray,
) -> None:
    """One period of the flight controller: from set-point and true state to commanded rotor thrusts.

    Args:
        airframe: Vehicle.
        memory: Updated. Shape (MEMORY_SIZE,).
        setpoint: vx vy vz (m/s) and yaw rate (rad/s), finite and within limits. Shape (4,).
        qpos: Position (m) and quaternion. Shape (7,).
        qvel: Velocity, world (m/s), and rates, body (rad/s). Shape (6,).
        matrix: Body to world. Shape (3, 3).
        wanted: Output: rotor thrusts (N). Shape (4,).
    """
    force = wanted_thrust(airframe, memory, setpoint, qvel)
    rates = wanted_rates(airframe, memory, setpoint[3], force, matrix, yaw_of(qpos[3:7]))
    torque = (
        airframe.inertia_x * airframe.rate_gain_x * (rates[0] - qvel[3]),
        airframe.inertia_y * airframe.rate_gain_y * (rates[1] - qvel[4]),
        airframe.inertia_z * airframe.rate_gain_z * (rates[2] - qvel[5]),
    )
    along = matrix[0, 2] * force[0] + matrix[1, 2] * force[1] + matrix[2, 2] * force[2]
    mix_rotors(airframe, airframe.mass * along, torque, wanted)


@kernel_jit
def advance(
    airframe: Airframe,
    body: Body,
    voxels: Voxels,
    wind: Wind,
    time_us: int,
    thrusts: np.ndarray,
    memory: np.ndarray,
    setpoint: np.ndarray,
    steps: int,
    commanded_steps: int,
    odometry: np.ndarray,
) -> bool:
    """Advance controller and vehicle by several periods.

    Args:
        airframe: Vehicle.
        body: Its rigid body.
        voxels: Obstacles outside MuJoCo's model.
        wind: Velocity of the air, world frame (m/s); drag acts relative to it.
        time_us: Current time.
        thrusts: Rotor thrusts (N), updated. Shape (4,).
        memory: Controller memory, updated. Shape (MEMORY_SIZE,).
        setpoint: vx vy vz (m/s) and yaw rate (rad/s). Shape (4,).
        steps: Number of periods.
        commanded_steps: Number of periods after which the set-point expires and the vehicle hovers.
        odometry: Output: position, velocity, quaternion, body rates. Shape (13,).

    Returns:
        Whether the vehicle touched an obstacle or the ground.
    """
    matrix = np.empty((3, 3))
    hover = np.zeros(4)
    wanted = np.empty(4)
    touched = False
    for step in range(steps):
        rotation_matrix(body.qpos[3:7], matrix)
        control(airframe, memory, setpoint if step < commanded_steps else hover, body.qpos, body.qvel, matrix, wanted)
        time = 1e-6 * (time_us + step * STEP_US)
        touched = step_body(airframe, body, voxels, wind, time, STEP, thrusts, wanted, matrix) or touched
    write_odometry(body, odometry)
    return touched


class Cascade:
    """The cascade as a `Controller`.  `Simulator` advances it in the same compiled loop as the vehicle.

    Attributes:
        memory: See `MEMORY_SIZE`.
    """

    period_us = STEP_US
    rewindable = True

    def __init__(self, start: InitialConditions) -> None:
        self._airframe = airframe_of(start.vehicle)
        self.memory = np.zeros(MEMORY_SIZE)
        self.memory[YAW_REFERENCE] = start.heading
        self._wanted, self._matrix = np.empty(4), np.empty((3, 3))

    def rotors(self, time_us: int, setpoint: np.ndarray, odometry: np.ndarray, force: np.ndarray) -> np.ndarray:
        """See `Controller.rotors`."""
        rotation_matrix(odometry[6:10], self._matrix)
        velocity_and_rates = np.concatenate([odometry[3:6], odometry[10:13]])
        position_and_attitude = np.concatenate([odometry[0:3], odometry[6:10]])
        control(
            self._airframe, self.memory, setpoint, position_and_attitude, velocity_and_rates, self._matrix, self._wanted
        )
        return self._wanted

    def save(self) -> bytes:
        """See `Controller.save`."""
        return self.memory.tobytes()

    def restore(self, saved: bytes) -> None:
        """See `Controller.restore`."""
        self.memory[:] = np.frombuffer(saved)

    def close(self) -> None:
        """See `Controller.close`; it holds nothing."""
