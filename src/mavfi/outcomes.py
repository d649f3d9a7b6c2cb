"""Verdicts on an injected run and its golden run: `effect_of` on the computation, `control_of` on the flight."""

import math
from dataclasses import dataclass
from enum import Enum
from typing import ClassVar

from mavfi.mission import MissionStatus
from mavfi.record import End, EnergyTerms, FlightLog, FlightRecord, record_of


class Effect(Enum):
    """Effect of a fault; the value is a sentence for people."""

    MASKED = "Every vehicle state and command is bit for bit that of the golden run."
    SDC = "Silent data corruption: the flight differs from its golden run, and the computation ran to its end."
    CRASH = "The computation ended by a signal."
    HANG = "The computation used up its budget."
    EXCEPTION = "The computation raised an exception."
    DETECTED = "Protected code found a difference, and the step was computed again."
    NOT_ACTIVATED = "The planned site was not reached, or could not be changed."
    UNKNOWN = "Could not be judged: the flight or its golden run has no record."

    @property
    def label(self) -> str:
        """Lower-case name, as in tables and JSON."""
        return self.name.lower()


DUE = (Effect.CRASH, Effect.HANG, Effect.EXCEPTION)
"""Effects that the system notices: detected unrecoverable errors."""


def effect_of(golden: FlightRecord | None, injected: FlightRecord) -> Effect:
    """Effect of a fault on the computation of a whole flight.

    Args:
        golden: The golden run of the same arm; None = there is none.
        injected: The run with the fault. If it died on every attempt, it is a crash unless its host knows better.
    """
    if injected.end is End.DUE:
        if injected.kernel is None:
            return Effect.CRASH
        return Effect[injected.kernel.effect.upper()]
    if golden is None or not golden.digest or not injected.digest:
        return Effect.UNKNOWN
    if golden.digest == injected.digest:
        return Effect.MASKED
    detected = injected.kernel is not None and injected.kernel.effect == Effect.DETECTED.label
    if detected:
        return Effect.DETECTED
    return Effect.SDC


# ---- faults in a flight controller -------------------------------------------------------------------------------
class ControlEffect(Enum):
    """What a fault in a flight controller does to a mission, from harmless to worst; the value names it in tables."""

    IDENTICAL = "bit-identical"
    SLIGHT = "slight"
    DEGRADED = "degraded"
    LOST = "loss of control"
    ENDS = "process ends"
    HANGS = "hang"


@dataclass(frozen=True, slots=True)
class ControlErrors:
    """How well a flight controller followed its set-points, from the fault on.

    They compare what is flown with what is commanded in the same flight: after any difference, the pipeline plans other
    paths, so that the distance from the golden run says nothing about control.

    Attributes:
        tilt: Largest angle between the body's and the world's z axis (rad).
        attitude: Between the body's z axis and the commanded thrust (rad): the largest that lasted `LASTING_S`.
        velocity: Largest lasting difference between commanded and actual velocity (m/s).
        yaw_rate: Largest lasting difference between commanded and actual yaw rate (rad/s).
    """

    KEY: ClassVar[str] = "control"
    """Of the errors in `FlightRecord.extra`."""

    tilt: float
    attitude: float
    velocity: float
    yaw_rate: float

    @staticmethod
    def of(record: FlightRecord) -> "ControlErrors | None":
        """The errors in a record; None = not measured."""
        stored = record.extra.get(ControlErrors.KEY)
        if stored is None:
            return None
        return ControlErrors(**{name: float(value) for name, value in stored.items()})

    def beyond(self, limits: "ControlErrors") -> bool:
        """Whether any of them is not within its limit; NaN is not."""
        return not (
            self.tilt <= limits.tilt
            and self.attitude <= limits.attitude
            and self.velocity <= limits.velocity
            and self.yaw_rate <= limits.yaw_rate
        )


LASTING_S = 0.5
"""An error lasts if it never falls below a value for so long (s): longer than an attitude takes to settle."""
HEALTHY = ControlErrors(math.radians(50.0), math.radians(4.0), 1.5, 0.4)
"""Beyond these, control is degraded: 1.4 to 1.5 times the largest errors of missions without a fault, rounded.

In 16 missions of 4 environments (design seeds), flown with 7 gyro noises each, these were 34 degrees, 2.6 degrees,
1.1 m/s and 0.27 rad/s.
"""
LOST_TILT = math.radians(60.0)
"""Tilt beyond which control counts as lost (rad)."""
LOST = ControlErrors(LOST_TILT, math.radians(30.0), 3.0, 2.0)
"""Beyond these, control is lost: an error lasts that is about as large as all that may be commanded (by default
33 degrees, 3 m/s, 2 rad/s)."""
LONGER = 0.2
COSTLIER = 0.25
"""Increase in flight time and in energy over the golden run, relative, beyond which a mission is degraded; largest
of the same flights: 11 % and 17 %."""
_ASTRAY = (MissionStatus.COLLISION.label, MissionStatus.FLY_AWAY.label)
_OF_EFFECT = {
    Effect.MASKED: ControlEffect.IDENTICAL,
    Effect.CRASH: ControlEffect.ENDS,
    Effect.HANG: ControlEffect.HANGS,
}
"""Class of a mission whose computation tells it."""


def control_of(golden: FlightRecord | None, injected: FlightRecord) -> ControlEffect | None:
    """Class of a mission with a fault in its flight controller; the worst that applies.

    Args:
        golden: The golden run of the same arm; None = there is none.
        injected: The run with the fault.

    Returns:
        None: It cannot be judged, e.g. if errors were not measured.
    """
    effect = effect_of(golden, injected)
    if effect in _OF_EFFECT:
        return _OF_EFFECT[effect]
    errors = ControlErrors.of(injected)
    if golden is None or effect is not Effect.SDC or errors is None:
        return None

    # How well it followed its set-points; an accident of a vehicle that follows them well is not one of control.
    is_healthy = not errors.beyond(HEALTHY)
    is_out_of_control = errors.beyond(LOST) or injected.status == MissionStatus.INVALID_STATE.label
    if is_out_of_control or (injected.status in _ASTRAY and not is_healthy):
        return ControlEffect.LOST

    # A mission is worse if it is lost, or takes clearly more time or energy, where the golden run succeeds.
    success = MissionStatus.SUCCESS.label
    is_lost = injected.status != success
    is_longer = injected.flight_time_s > (1.0 + LONGER) * golden.flight_time_s
    is_costlier = energy(injected.energy) > (1.0 + COSTLIER) * energy(golden.energy)
    is_worse = golden.status == success and (is_lost or is_longer or is_costlier)
    if is_healthy and not is_worse:
        return ControlEffect.SLIGHT
    return ControlEffect.DEGRADED


# ---- Quality of flight: flight time, energy and distance of a flight, computed from its record alone.

BATTERY_ENERGY = 11.1 * 5.5 * 3600.0
"""Energy of a battery of 11.1 V, constant over the discharge, and 5.5 Ah (J)."""

_KMH = 3.6
_CONSTANT = 443.9
_SPEED_XY = -1.526
_ACCELERATION_XY = 3.934
_PRODUCT_XY = 0.968
_SPEED_Z = 18.125
_ACCELERATION_Z = 96.613
_PRODUCT_Z = -1.085


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
