"""Quality of flight: flight time, energy and distance of a flight, computed from its record alone.

The power model is MAVBench's (its fork of AirSim, MultiRotor.hpp and Battery.hpp), with the structure of Tseng et al.
2017 (arXiv:1703.10049): a regression on speeds and accelerations, for a quadrotor of the class of the 3DR Solo.  It
ignores payload and compute power, and its constant is high for such a vehicle: it is meant for comparing flights.
"""

from dataclasses import dataclass

from mavfi.flight_log import FlightLog
from mavfi.flight_record import EnergyTerms, FlightRecord, record_of

BATTERY_ENERGY = 11.1 * 5.5 * 3600.0
"""Energy of a battery of 11.1 V, constant over the discharge, and 5.5 Ah (J)."""

_KMH = 3.6
_CONSTANT = 443.9
_SPEED_XY, _ACCELERATION_XY, _PRODUCT_XY = -1.526, 3.934, 0.968
_SPEED_Z, _ACCELERATION_Z, _PRODUCT_Z = 18.125, 96.613, -1.085


@dataclass(frozen=True, slots=True)
class QoF:
    """Quality of one flight.

    Attributes:
        flight_time_s: From the first to the last row of the log.
        energy_j: Energy of the rotors.
        distance_m: Length of the flown path.
        battery_used: Share of a full battery; above 1 it would have been depleted in flight.
    """

    flight_time_s: float
    energy_j: float
    distance_m: float
    battery_used: float


def energy(terms: EnergyTerms) -> float:
    """Energy of the rotors (J), MAVBench's regression; its coefficients are for km/h and km/h/s.

    P = 443.9 - 1.526 Vxy + 3.934 Axy + 0.968 Vxy Axy + 18.125 |Vz| + 96.613 |Az| - 1.085 |Vz| |Az|.

    Args:
        terms: Integrals over the flight, in SI units.
    """
    return (
        _CONSTANT * terms.duration_s
        + _KMH * (_SPEED_XY * terms.speed_xy + _ACCELERATION_XY * terms.acceleration_xy)
        + _KMH * _KMH * (_PRODUCT_XY * terms.product_xy + _PRODUCT_Z * terms.product_z)
        + _KMH * (_SPEED_Z * terms.speed_z + _ACCELERATION_Z * terms.acceleration_z)
    )


def quality_of(record: FlightRecord) -> QoF:
    """Quality of a recorded flight."""
    joule = energy(record.energy)
    return QoF(record.flight_time_s, joule, record.distance_m, joule / BATTERY_ENERGY)


def quality_of_flight(log: FlightLog) -> QoF:
    """Quality of a logged flight."""
    return quality_of(record_of(log))
