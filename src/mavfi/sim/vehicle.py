"""The vehicle: rotors, drag and MuJoCo's rigid body, advanced together in compiled code.

Rotors are numbered as in AirSim: front right, rear left (counter-clockwise), front left, rear right (clockwise).
"""

import math
from typing import NamedTuple

import numpy as np

from mavfi.config import VehicleConfig
from mavfi.numerics.elementary import exp, tan
from mavfi.numerics.jit import kernel_jit
from mavfi.numerics.rotations import rotation_matrix, turn
from mavfi.sim.engine import GRAVITY, mj_step
from mavfi.sim.environments.world import Voxels
from mavfi.sim.scene import CONTACTS, STEP_US
from mavfi.sim.wind import Wind, wind_at


class Airframe(NamedTuple):
    """Parameters of a `VehicleConfig` for compiled code; SI units."""

    mass: float
    inertia_x: float
    inertia_y: float
    inertia_z: float
    lever: float
    collision_radius: float
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


def airframe_of(config: VehicleConfig, period_us: int = STEP_US) -> Airframe:
    """The airframe of a configuration.

    Args:
        config: The vehicle.
        period_us: Period of the physics (us), in which a rotor completes the share `rotor_step` of a thrust change.
    """
    lag = config.rotor_time_constant
    return Airframe(
        config.mass,
        *config.inertia,
        config.arm_length / math.sqrt(2.0),
        config.collision_radius,
        config.max_rotor_thrust,
        config.rotor_torque_ratio,
        1.0 - exp(-period_us * 1e-6 / lag) if lag > 0.0 else 1.0,
        *config.drag,
        config.velocity_gain,
        config.attitude_gain,
        *config.rate_gain,
        config.vertical_integral_gain,
        tan(config.max_tilt),
        config.max_acceleration,
    )


def hover_thrusts(airframe: Airframe) -> np.ndarray:
    """Rotor thrusts of a hovering vehicle (N). Shape (4,)."""
    return np.full(4, min(0.25 * airframe.mass * GRAVITY, airframe.max_thrust))


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
def step_body(
    airframe: Airframe,
    body: Body,
    voxels: Voxels,
    wind: Wind,
    time: float,
    period: float,
    thrusts: np.ndarray,
    wanted: np.ndarray,
    matrix: np.ndarray,
) -> bool:
    """One period of the physics: rotor lag, drag, rigid body and contacts.

    Args:
        airframe: Vehicle.
        body: Its rigid body.
        voxels: Obstacles outside MuJoCo's model.
        wind: Velocity of the air, world frame (m/s); drag acts relative to it.
        time: Since the start of the flight (s).
        period: Of the physics (s).
        thrusts: Rotor thrusts (N), updated. Shape (4,).
        wanted: Commanded thrusts (N). Shape (4,).
        matrix: Body to world, at the start of the period. Shape (3, 3).

    Returns:
        Whether the vehicle touched an obstacle or the ground.
    """
    air = np.empty(3)
    attitude = np.empty(4)
    for i in range(4):
        thrusts[i] += airframe.rotor_step * (wanted[i] - thrusts[i])
    wind_at(wind, time, air)
    for axis in range(3):
        air[axis] = body.qvel[axis] - air[axis]
    apply_forces(airframe, thrusts, air, matrix, body.qfrc)
    attitude[:] = body.qpos[3:7]
    mj_step(body.model, body.data)  # type: ignore[call-overload]
    # MuJoCo integrates attitude with libm's sine and cosine, which depend on the CPU: integrate it again
    turn(attitude, period * body.qvel[3], period * body.qvel[4], period * body.qvel[5])
    body.qpos[3:7] = attitude
    touched: bool = body.sensors[CONTACTS] > 0.0
    if voxels.occupied.size > 0:
        touched = touched or sphere_touches_voxels(
            body.qpos, airframe.collision_radius, voxels.occupied, voxels.origin, voxels.resolution
        )
    return touched


@kernel_jit
def write_odometry(body: Body, odometry: np.ndarray) -> None:
    """Position, velocity, quaternion and body rates of a body. Shape (13,)."""
    odometry[0:3] = body.qpos[0:3]
    odometry[3:6] = body.qvel[0:3]
    odometry[6:10] = body.qpos[3:7]
    odometry[10:13] = body.qvel[3:6]


@kernel_jit
def turn_rotors(
    airframe: Airframe,
    body: Body,
    voxels: Voxels,
    wind: Wind,
    time_us: int,
    period_us: int,
    thrusts: np.ndarray,
    wanted: np.ndarray,
    odometry: np.ndarray,
) -> bool:
    """Advance the vehicle by one period of the physics under given rotor commands.

    Args:
        airframe: Vehicle, for this period.
        body: Its rigid body.
        voxels: Obstacles outside MuJoCo's model.
        wind: Velocity of the air, world frame (m/s).
        time_us: Current time.
        period_us: Period of the physics.
        thrusts: Rotor thrusts (N), updated. Shape (4,).
        wanted: Commanded thrusts (N). Shape (4,).
        odometry: Output: position, velocity, quaternion, body rates. Shape (13,).

    Returns:
        Whether the vehicle touched an obstacle or the ground.
    """
    matrix = np.empty((3, 3))
    rotation_matrix(body.qpos[3:7], matrix)
    touched = step_body(airframe, body, voxels, wind, 1e-6 * time_us, 1e-6 * period_us, thrusts, wanted, matrix)
    write_odometry(body, odometry)
    return touched


# ---- contact with a scan ---------------------------------------------------------------------------------------------


@kernel_jit
def sphere_touches_voxels(
    centre: np.ndarray, radius: float, occupied: np.ndarray, origin: np.ndarray, resolution: float
) -> bool:
    """Whether a sphere overlaps a solid voxel; everything outside the grid is solid.

    Args:
        centre: World frame (m). Shape (3,) or longer.
        radius: Radius (m).
        occupied: Solid voxels. Shape (nx, ny, nz), bool.
        origin: Lower corner of voxel (0, 0, 0) (m). Shape (3,).
        resolution: Edge of a voxel (m).

    Returns:
        True also for a centre that is not finite.
    """
    for axis in range(3):
        low = centre[axis] - origin[axis] - radius
        if not (low >= 0.0 and low + 2.0 * radius < occupied.shape[axis] * resolution):
            return True
    low_i = int((centre[0] - origin[0] - radius) / resolution)
    high_i = min(int((centre[0] - origin[0] + radius) / resolution), occupied.shape[0] - 1)
    low_j = int((centre[1] - origin[1] - radius) / resolution)
    high_j = min(int((centre[1] - origin[1] + radius) / resolution), occupied.shape[1] - 1)
    low_k = int((centre[2] - origin[2] - radius) / resolution)
    high_k = min(int((centre[2] - origin[2] + radius) / resolution), occupied.shape[2] - 1)
    for i in range(low_i, high_i + 1):
        dx = _beyond_voxel(centre[0] - origin[0], i, resolution)
        for j in range(low_j, high_j + 1):
            dy = _beyond_voxel(centre[1] - origin[1], j, resolution)
            for k in range(low_k, high_k + 1):
                if occupied[i, j, k]:
                    dz = _beyond_voxel(centre[2] - origin[2], k, resolution)
                    if math.sqrt(dx * dx + dy * dy + dz * dz) < radius:
                        return True
    return False


@kernel_jit
def _beyond_voxel(value: float, index: int, resolution: float) -> float:
    return max(index * resolution - value, value - (index + 1) * resolution, 0.0)
