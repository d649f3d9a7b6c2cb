"""The vehicle: flight controller, rotors and drag, advanced together with MuJoCo's rigid body in compiled code.

The controller is a cascade, velocity -> attitude -> body rate -> rotors, as in AirSim's SimpleFlight and in common
autopilots.  It reads the true state, as SimpleFlight does.  It has no integrator in x and y; a small one in z corrects
the remaining error due to drag.  Rotors are numbered as in AirSim: front right, rear left (counter-clockwise), front
left, rear right (clockwise).
"""

import math
from typing import NamedTuple

import numpy as np

from mavfi.config import VehicleConfig
from mavfi.numerics.elementary import acos, exp, tan
from mavfi.numerics.jit import kernel_jit
from mavfi.numerics.rotations import rotation_matrix, turn, wrap_angle, yaw_of
from mavfi.sim.contact import sphere_touches_voxels
from mavfi.sim.engine import GRAVITY, mj_step
from mavfi.sim.environments.world import Voxels
from mavfi.sim.scene import CONTACTS, STEP_US
from mavfi.sim.wind import Wind, wind_at

STEP = STEP_US * 1e-6
"""Period of the flight controller (s)."""

MEMORY_SIZE = 6
"""Length of the controller's memory: four rotor thrusts (N), yaw reference (rad), vertical integral (m)."""
YAW_REFERENCE, VERTICAL_INTEGRAL = 4, 5

_VERTICAL_ACCELERATION_LIMIT = 4.0
_INTEGRATED_ERROR_LIMIT = 0.5
_INTEGRAL_LIMIT = 2.0
_YAW_GAIN = 3.0
_YAW_LEASH = 0.15
_IDLE_SHARE, _FULL_SHARE = 0.1, 0.9


class Airframe(NamedTuple):
    """Parameters of a `VehicleConfig` for compiled code; SI units."""

    mass: float
    inertia_x: float
    inertia_y: float
    inertia_z: float
    lever: float
    hull_radius: float
    max_thrust: float
    torque_ratio: float
    rotor_step: float
    drag_x: float
    drag_y: float
    drag_z: float
    velocity_gain: float
    attitude_gain: float
    rate_gain_x: float
    rate_gain_y: float
    rate_gain_z: float
    vertical_integral_gain: float
    tan_max_tilt: float
    max_acceleration: float


def airframe_of(config: VehicleConfig) -> Airframe:
    """The airframe of a configuration; `rotor_step` is the share of a thrust change that a rotor completes per step."""
    lag = config.rotor_time_constant
    return Airframe(
        config.mass,
        *config.inertia,
        config.arm_length / math.sqrt(2.0),
        config.hull_radius,
        config.max_rotor_thrust,
        config.rotor_torque_ratio,
        1.0 - exp(-STEP / lag) if lag > 0.0 else 1.0,
        *config.drag,
        config.velocity_gain,
        config.attitude_gain,
        *config.rate_gain,
        config.vertical_integral_gain,
        tan(config.max_tilt),
        config.max_acceleration,
    )


def hover_memory(airframe: Airframe) -> np.ndarray:
    """Controller memory of a hovering vehicle. Shape (MEMORY_SIZE,)."""
    memory = np.zeros(MEMORY_SIZE)
    memory[:4] = min(0.25 * airframe.mass * GRAVITY, airframe.max_thrust)
    return memory


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
    airframe: Airframe, memory: np.ndarray, setpoint: np.ndarray, qpos: np.ndarray, qvel: np.ndarray, matrix: np.ndarray
) -> None:
    """One period of the flight controller: from set-point and true state to rotor thrusts, with rotor lag.

    Args:
        airframe: Vehicle.
        memory: Updated. Shape (MEMORY_SIZE,).
        setpoint: vx vy vz (m/s) and yaw rate (rad/s), finite and within limits. Shape (4,).
        qpos: Position (m) and quaternion. Shape (7,).
        qvel: Velocity, world (m/s), and rates, body (rad/s). Shape (6,).
        matrix: Body to world. Shape (3, 3).
    """
    force = wanted_thrust(airframe, memory, setpoint, qvel)
    rates = wanted_rates(airframe, memory, setpoint[3], force, matrix, yaw_of(qpos[3:7]))
    torque = (
        airframe.inertia_x * airframe.rate_gain_x * (rates[0] - qvel[3]),
        airframe.inertia_y * airframe.rate_gain_y * (rates[1] - qvel[4]),
        airframe.inertia_z * airframe.rate_gain_z * (rates[2] - qvel[5]),
    )
    along = matrix[0, 2] * force[0] + matrix[1, 2] * force[1] + matrix[2, 2] * force[2]
    wanted = np.empty(4)
    mix_rotors(airframe, airframe.mass * along, torque, wanted)
    for i in range(4):
        memory[i] += airframe.rotor_step * (wanted[i] - memory[i])


@kernel_jit
def apply_forces(
    airframe: Airframe, thrusts: np.ndarray, velocity: np.ndarray, matrix: np.ndarray, qfrc: np.ndarray
) -> None:
    """Rotor forces and drag as generalized forces of the free joint: force in world frame, torque in body frame.

    Drag acts on each body axis: force = -k v |v| (AirSim, MultiRotorPhysicsBody).

    Args:
        airframe: Vehicle.
        thrusts: Rotor thrusts (N). Shape (4,) or longer.
        velocity: Relative to the air, world frame (m/s). Shape (3,) or longer.
        matrix: Body to world. Shape (3, 3).
        qfrc: Output. Shape (6,).
    """
    vx = matrix[0, 0] * velocity[0] + matrix[1, 0] * velocity[1] + matrix[2, 0] * velocity[2]
    vy = matrix[0, 1] * velocity[0] + matrix[1, 1] * velocity[1] + matrix[2, 1] * velocity[2]
    vz = matrix[0, 2] * velocity[0] + matrix[1, 2] * velocity[1] + matrix[2, 2] * velocity[2]
    fx = -airframe.drag_x * vx * abs(vx)
    fy = -airframe.drag_y * vy * abs(vy)
    fz = thrusts[0] + thrusts[1] + thrusts[2] + thrusts[3] - airframe.drag_z * vz * abs(vz)
    for axis in range(3):
        qfrc[axis] = matrix[axis, 0] * fx + matrix[axis, 1] * fy + matrix[axis, 2] * fz
    qfrc[3] = airframe.lever * (-thrusts[0] + thrusts[1] + thrusts[2] - thrusts[3])
    qfrc[4] = airframe.lever * (-thrusts[0] + thrusts[1] - thrusts[2] + thrusts[3])
    qfrc[5] = airframe.torque_ratio * (-thrusts[0] - thrusts[1] + thrusts[2] + thrusts[3])


class Body(NamedTuple):
    """MuJoCo's storage of the vehicle: addresses of MjModel and MjData, and views of MjData."""

    model: int
    data: int
    qpos: np.ndarray
    qvel: np.ndarray
    qfrc: np.ndarray
    sensors: np.ndarray


@kernel_jit
def advance(
    airframe: Airframe,
    body: Body,
    voxels: Voxels,
    wind: Wind,
    time_us: int,
    memory: np.ndarray,
    setpoint: np.ndarray,
    steps: int,
    commanded_steps: int,
    odometry: np.ndarray,
) -> bool:
    """Advance controller, rotors, drag and rigid body by several periods.

    Args:
        airframe: Vehicle.
        body: Its rigid body.
        voxels: Obstacles outside MuJoCo's model.
        wind: Velocity of the air, world frame (m/s); drag acts relative to it.
        time_us: Current time.
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
    air = np.empty(3)
    attitude = np.empty(4)
    touched = False
    for step in range(steps):
        rotation_matrix(body.qpos[3:7], matrix)
        control(airframe, memory, setpoint if step < commanded_steps else hover, body.qpos, body.qvel, matrix)
        wind_at(wind, 1e-6 * (time_us + step * STEP_US), air)
        for axis in range(3):
            air[axis] = body.qvel[axis] - air[axis]
        apply_forces(airframe, memory, air, matrix, body.qfrc)
        attitude[:] = body.qpos[3:7]
        mj_step(body.model, body.data)  # type: ignore[call-overload]
        # MuJoCo integrates attitude with libm's sine and cosine, which depend on the CPU: integrate it again
        turn(attitude, STEP * body.qvel[3], STEP * body.qvel[4], STEP * body.qvel[5])
        body.qpos[3:7] = attitude
        touched = touched or body.sensors[CONTACTS] > 0.0
        if voxels.occupied.size > 0:
            touched = touched or sphere_touches_voxels(
                body.qpos, airframe.hull_radius, voxels.occupied, voxels.origin, voxels.resolution
            )
    odometry[0:3] = body.qpos[0:3]
    odometry[3:6] = body.qvel[0:3]
    odometry[6:10] = body.qpos[3:7]
    odometry[10:13] = body.qvel[3:6]
    return touched
