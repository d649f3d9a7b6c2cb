"""Visual performance model of a UAV with redundant processors: mass, speed, flight time, energy.

The model has the structure of Krishnan et al., "The Sky Is Not the Limit" (IEEE CAL 2020), and of F-1, from which
MAVFI's Fig. 8 is computed: maximum speed is limited by the stop within the sensing range.  Neither the recipe nor the
vehicle data of that figure are published, so the inputs in `configs/redundancy` are calibrated, with bands.
"""

import math
from dataclasses import dataclass
from typing import Literal

from pydantic import Field, model_validator

from mavfi.config import Config, names, shipped

GRAVITY = 9.80665
"""Standard gravity (m/s^2)."""
CANNOT_HOVER = math.inf
"""Ratio of flight times if the heavier vehicle has no excess thrust."""


class Band(Config):
    """Range of a parameter supported by public sources, with all other parameters fixed."""

    low: float = Field(gt=0, le=1e6)
    high: float = Field(gt=0, le=1e6)

    @model_validator(mode="after")
    def _ordered(self) -> "Band":
        if self.low > self.high:
            raise ValueError(f"low: {self.low:g}: allowed: at most high, {self.high:g}")
        return self


class DesignConfig(Config):
    """A UAV and its on-board computer, for comparing redundancy with detection."""

    name: str
    vehicle: str = Field("", description="which vehicle this is; the name by default")
    calibration: str = Field("own", description="name of this set of inputs")
    mass: float = Field(gt=0, le=1e3, description="kg: frame, rotors and battery, without the computer")
    max_thrust: float = Field(gt=0, le=1e5, description="N, of all rotors")
    board_mass: float = Field(0.085, ge=0, le=100, description="kg, of the computer without heat sink")
    processor_power: float = Field(5.0, gt=0, le=1e4, description="W, of one processor")
    heatsink: float = Field(0.0054, ge=0, le=1, description="kg/W")
    action_period: float = Field(0.37246, ge=0, le=60, description="s, from an image to the command that answers it")
    sensing_range: float = Field(7.0, gt=0, le=1e4, description="m")
    acceleration: Literal["excess_thrust", "tilt"] = Field(
        "excess_thrust", description="largest: F/m - g, or level at the largest tilt, g sqrt((F/(m g))^2 - 1)"
    )
    replicated: Literal["processor", "board"] = Field(
        "processor", description="processors with heat sinks on one board, or whole boards"
    )
    bands: dict[str, Band] = Field(default_factory=dict, description="supported range, by key")
    sources: dict[str, str] = Field(default_factory=dict, description="source of a value, by key")

    @model_validator(mode="after")
    def _known_keys(self) -> "DesignConfig":
        for key, names_ in (("bands", NUMBERS), ("sources", tuple(type(self).model_fields))):
            for name in getattr(self, key):
                if name not in names_:
                    raise ValueError(f"{key}: {name!r}: not known; allowed: {', '.join(names_)}")
        if not max_acceleration(self, self.mass + payload(self, 1)) > 0:
            weight = GRAVITY * (self.mass + payload(self, 1))
            raise ValueError(
                f"max_thrust: {self.max_thrust:g} N: cannot hover; allowed: above the weight with one processor, "
                f"{weight:.4g} N"
            )
        return self

    @property
    def craft(self) -> str:
        """Name of the vehicle."""
        return self.vehicle or self.name


NUMBERS = tuple(name for name, field in DesignConfig.model_fields.items() if field.annotation is float)
"""Numeric keys, which may have a band."""


@dataclass(frozen=True, slots=True)
class Performance:
    """Performance of a vehicle.

    Attributes:
        payload: Mass of the computer with heat sinks (kg).
        mass: Mass of the whole vehicle (kg).
        acceleration: Maximum (m/s^2); 0 = no thrust beyond hovering.
        speed: Maximum speed at which the vehicle can stop within its sensing range (m/s).
    """

    payload: float
    mass: float
    acceleration: float
    speed: float


def payload(design: DesignConfig, copies: int) -> float:
    """Mass of the computer (kg) with `copies` processors; heat sink mass is proportional to power."""
    boards = copies if design.replicated == "board" else 1
    return boards * design.board_mass + copies * design.heatsink * design.processor_power


def max_acceleration(design: DesignConfig, mass: float) -> float:
    """Maximum acceleration (m/s^2) at a vehicle mass (kg); 0 if thrust does not exceed weight."""
    per_mass = design.max_thrust / mass
    if per_mass <= GRAVITY:
        return 0.0
    return per_mass - GRAVITY if design.acceleration == "excess_thrust" else math.sqrt(per_mass**2 - GRAVITY**2)


def safe_speed(acceleration: float, action_period: float, sensing_range: float) -> float:
    """Maximum speed v (m/s) at which the vehicle can stop within its sensing range: v T + v^2 / (2 a) = d.

    Args:
        acceleration: Deceleration a during braking (m/s^2); 0 gives 0.
        action_period: Reaction time T before braking starts (s).
        sensing_range: Sensing range d (m).
    """
    if acceleration <= 0:
        return 0.0
    # 2 d / (T + sqrt(T^2 + 2 d / a)): the root in a form without cancellation
    root = math.sqrt(action_period**2 + 2 * sensing_range / acceleration)
    return 2 * sensing_range / (action_period + root)


def performance(design: DesignConfig, copies: int = 1, overhead: float = 0.0) -> Performance:
    """Performance with 1 (no redundancy), 2 (DMR) or 3 (TMR) processors and a detector's compute overhead.

    Copies run in lockstep with a voter of zero latency; the overhead is a fraction of the action period.
    """
    carried = payload(design, copies)
    mass = design.mass + carried
    acceleration = max_acceleration(design, mass)
    period = design.action_period * (1 + overhead)
    return Performance(carried, mass, acceleration, safe_speed(acceleration, period, design.sensing_range))


def time_ratio(slow: Performance, fast: Performance, speed_limit: float = math.inf) -> float:
    """Ratio of flight times over the same distance, `slow` / `fast`, with both speeds capped at a limit (m/s)."""
    speed = min(slow.speed, speed_limit)
    return min(fast.speed, speed_limit) / speed if speed > 0 else CANNOT_HOVER


def energy_ratio(slow: Performance, fast: Performance) -> float:
    """Ratio of energies over the same distance, with hover power ~ (m g)^1.5 (momentum theory)."""
    masses = slow.mass / fast.mass
    return time_ratio(slow, fast) * masses * math.sqrt(masses)


def at_ends(design: DesignConfig, key: str) -> tuple[DesignConfig | None, DesignConfig | None]:
    """The design with a parameter at each end of its band; None = cannot hover even with one processor."""
    band = design.bands[key]
    found = [design.model_copy(update={key: value}) for value in (band.low, band.high)]
    low, high = (one if performance(one).acceleration > 0 else None for one in found)
    return low, high


def find_design(name: str) -> DesignConfig:
    """Load a design: a shipped one by name or a file by path; `BadInputError` if it does not exist or is invalid."""
    return shipped("redundancy", DesignConfig, name)


def shipped_designs() -> list[DesignConfig]:
    """All shipped designs."""
    return [find_design(name) for name in names("redundancy")]
