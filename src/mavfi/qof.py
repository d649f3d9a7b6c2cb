"""Quality of flight: flight time, energy and distance of a flight, judged from its log alone.

The power model is MAVBench's (its fork of AirSim, MultiRotor.hpp and Battery.hpp), which has the structure of Tseng et
al. 2017 (arXiv:1703.10049): a regression on speeds and accelerations, for a quadrotor of the class of the 3DR Solo.  It
does not know payload or compute power, and its constant is high for such a vehicle: it serves to compare flights.
"""

from dataclasses import dataclass

import numpy as np

from mavfi.flight_log import FlightLog

BATTERY_VOLTAGE = 11.1
"""V, constant over the discharge."""
BATTERY_CAPACITY = 5.5
"""Ah."""
BATTERY_ENERGY = BATTERY_VOLTAGE * BATTERY_CAPACITY * 3600.0
"""J."""

_KMH = 3.6
_CONSTANT = 443.9
_SPEED_XY, _ACCELERATION_XY, _PRODUCT_XY = -1.526, 3.934, 0.968
_SPEED_Z, _ACCELERATION_Z, _PRODUCT_Z = 18.125, 96.613, -1.085


@dataclass(frozen=True, slots=True)
class QoF:
    """Quality of one flight.

    Attributes:
        flight_time_s: From the first to the last row of the log.
        energy_j: Of the rotors.
        distance_m: Length of the flown path.
        battery_used: Share of a full battery; above 1 the flight would not have come so far.
    """

    flight_time_s: float
    energy_j: float
    distance_m: float
    battery_used: float


def power(velocity: np.ndarray, acceleration: np.ndarray) -> np.ndarray:
    """Electrical power of the rotors, MAVBench's regression; its coefficients are for km/h and km/h/s.

    P = 443.9 - 1.526 Vxy + 3.934 Axy + 0.968 Vxy Axy + 18.125 |Vz| + 96.613 |Az| - 1.085 |Vz| |Az|, not below 0.

    Args:
        velocity: World frame (m/s). Shape (n, 3).
        acceleration: World frame (m/s^2). Shape (n, 3).

    Returns:
        Power (W). Shape (n,).
    """
    speed_xy = _KMH * np.hypot(velocity[:, 0], velocity[:, 1])
    acceleration_xy = _KMH * np.hypot(acceleration[:, 0], acceleration[:, 1])
    speed_z = _KMH * np.abs(velocity[:, 2])
    acceleration_z = _KMH * np.abs(acceleration[:, 2])
    watts: np.ndarray = (
        _CONSTANT
        + _SPEED_XY * speed_xy
        + _ACCELERATION_XY * acceleration_xy
        + _PRODUCT_XY * speed_xy * acceleration_xy
        + _SPEED_Z * speed_z
        + _ACCELERATION_Z * acceleration_z
        + _PRODUCT_Z * speed_z * acceleration_z
    )
    return watts.clip(min=0.0)


def quality_of_flight(log: FlightLog) -> QoF:
    """Judge a flight: time, energy, distance, battery.

    Between two rows the velocity is their mean and the acceleration their difference by time.  Rows from the first one
    that is not finite on do not count.

    Args:
        log: The flight.
    """
    rows = log.columns("time", "x", "y", "z", "vx", "vy", "vz")
    finite = np.isfinite(rows).all(axis=1)
    rows = rows if finite.all() else rows[: int(np.argmin(finite))]
    if len(rows) < 2:
        return QoF(0.0, 0.0, 0.0, 0.0)
    time, position, velocity = rows[:, 0], rows[:, 1:4], rows[:, 4:7]
    interval = np.diff(time)
    acceleration = np.diff(velocity, axis=0) / interval[:, None]
    watts = power(0.5 * (velocity[1:] + velocity[:-1]), acceleration)
    energy = float((watts * interval).sum())
    distance = float(np.linalg.norm(np.diff(position, axis=0), axis=1).sum())
    return QoF(float(time[-1] - time[0]), energy, distance, energy / BATTERY_ENERGY)
