"""Rotor commands for attitudes, body rates and motors, from the inner loops of our cascade."""

from dataclasses import dataclass

import numpy as np

from mavfi.extras.airsim.vehicle import ApiVehicle
from mavfi.numerics.elementary import cos, sin
from mavfi.numerics.rotations import rotation_matrix, yaw_of
from mavfi.sim.cascade import MEMORY_SIZE, YAW_REFERENCE, mix_rotors, wanted_rates
from mavfi.sim.engine import GRAVITY
from mavfi.sim.grounded import Rotors
from mavfi.sim.vehicle import airframe_of

_HEIGHT_GAIN, _CLIMB_GAIN, _CLIMB = 1.5, 2.5, 2.0
"""Height hold: gains of height and of vertical speed (1/s), largest vertical speed (m/s)."""


@dataclass(frozen=True, slots=True)
class Vertical:
    """Set-point of the collective thrust: `throttle`, a share of the largest thrust, or a height `z` (NED, m)."""

    throttle: float | None = None
    z: float = 0.0


def _collective(vehicle: ApiVehicle, vertical: Vertical, odometry: np.ndarray, up: float) -> float:
    """Collective thrust (N); `up` = vertical component of the body's z axis."""
    frame = airframe_of(vehicle.scenario.vehicle)
    if vertical.throttle is not None:
        return 4.0 * frame.max_thrust * min(1.0, max(0.0, vertical.throttle))
    height = float(vehicle.to_world((0.0, 0.0, vertical.z))[2])
    climb = min(_CLIMB, max(-_CLIMB, _HEIGHT_GAIN * (height - float(odometry[2]))))
    return frame.mass * (GRAVITY + _CLIMB_GAIN * (climb - float(odometry[5]))) / max(up, 0.5)


def _mixed(
    vehicle: ApiVehicle, rates: tuple[float, float, float], vertical: Vertical, odometry: np.ndarray
) -> np.ndarray:
    """Rotor commands (N) for body rates (FLU, rad/s) and a collective thrust. Shape (4,)."""
    frame = airframe_of(vehicle.scenario.vehicle)
    matrix, wanted = np.empty((3, 3)), np.empty(4)
    rotation_matrix(odometry[6:10], matrix)
    torque = (
        frame.inertia_x * frame.rate_gain_x * (rates[0] - float(odometry[10])),
        frame.inertia_y * frame.rate_gain_y * (rates[1] - float(odometry[11])),
        frame.inertia_z * frame.rate_gain_z * (rates[2] - float(odometry[12])),
    )
    mix_rotors(frame, _collective(vehicle, vertical, odometry, float(matrix[2, 2])), torque, wanted)
    return wanted


def at_rates(vehicle: ApiVehicle, roll: float, pitch: float, yaw: float, vertical: Vertical) -> Rotors:
    """Rotor commands for body rates (FRD, rad/s)."""
    return lambda time_us, odometry: _mixed(vehicle, (roll, -pitch, -yaw), vertical, odometry)


def at_attitude(
    vehicle: ApiVehicle, roll: float, pitch: float, yaw: float, yaw_rate: float | None, vertical: Vertical
) -> Rotors:
    """Rotor commands for an attitude (FRD, rad): roll, pitch, and yaw or (if not None) its rate (rad/s)."""
    memory = np.zeros(MEMORY_SIZE)
    frame = airframe_of(vehicle.scenario.vehicle)
    memory[YAW_REFERENCE] = float(yaw_of(vehicle.sim.odometry[6:10]))

    def rotors(time_us: int, odometry: np.ndarray) -> np.ndarray:
        matrix, heading = np.empty((3, 3)), float(yaw_of(odometry[6:10]))
        rotation_matrix(odometry[6:10], matrix)
        c, s = cos(heading), sin(heading)
        forward, left = sin(-pitch) * cos(roll), -sin(roll)
        up = cos(pitch) * cos(roll)
        force = np.array([c * forward - s * left, s * forward + c * left, up])
        if yaw_rate is None:
            memory[YAW_REFERENCE] = -yaw
        rates = wanted_rates(frame, memory, 0.0 if yaw_rate is None else -yaw_rate, force, matrix, heading)
        return _mixed(vehicle, rates, vertical, odometry)

    return rotors


def motors(vehicle: ApiVehicle, shares: tuple[float, float, float, float]) -> Rotors:
    """Rotor commands from shares of the largest thrust, 0 to 1: front right, rear left, front left, rear right."""
    wanted = vehicle.sim.max_thrust * np.clip(np.array(shares, float), 0.0, 1.0)
    return lambda time_us, odometry: wanted
