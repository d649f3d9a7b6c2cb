"""Failures per flight hour: upset rate x dynamic instructions per flight hour x measured increase in failures (harm).

The paper's rates are conditional on one fault per mission.  They cannot compare schemes that execute different numbers
of instructions: idle instructions added by a scheme lower the share of harmful faults but save no mission (Schirmeier,
Borchert, Spinczyk, DSN 2015).  The absolute number of failures can.  Detectors and recovery are therefore counted,
injected and summed like other kernels, and recomputations count towards their kernels.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass

from pydantic import Field, model_validator

from mavfi.config import Config, shipped

_HOUR = 3600.0


class Range(Config):
    """A value with its uncertainty band."""

    value: float = Field(ge=0, le=1e9)
    low: float = Field(ge=0, le=1e9)
    high: float = Field(ge=0, le=1e9)

    @model_validator(mode="after")
    def _ordered(self) -> "Range":
        if not self.low <= self.value <= self.high:
            raise ValueError(f"value: {self.value:g}: allowed: {self.low:g} to {self.high:g}, its low and high")
        return self


class UpsetConfig(Config):
    """Parameters of the rate at which radiation changes instruction results."""

    name: str
    fit_per_mbit: Range = Field(description="upsets per 10^9 h and Mbit at sea level in New York City")
    unprotected_mbit: float = Field(gt=0, le=1e6, description="state without error correction, Mbit")
    visible: float = Field(gt=0, le=1, description="share of its upsets that change the result of an instruction")
    altitude: Range = Field(description="m above sea level")
    instructions_per_second: float = Field(gt=0, le=1e15, description="of the busy processor")
    sources: dict[str, str] = Field(default_factory=dict, description="source of a value, by key")

    @model_validator(mode="after")
    def _known_keys(self) -> "UpsetConfig":
        for name in self.sources:
            if name not in type(self).model_fields:
                allowed = ", ".join(key for key in type(self).model_fields if key not in ("name", "sources"))
                raise ValueError(f"sources: {name!r}: not known; allowed: {allowed}")
        if self.altitude.high > HIGHEST:
            raise ValueError(f"altitude: {self.altitude.high:g} m: allowed: up to {HIGHEST:g}")
        return self


HIGHEST = 18_000.0
"""Highest altitude at which the flux formula is valid (m)."""


def find_upsets(name: str = "low_altitude") -> UpsetConfig:
    """Load upset rates: shipped ones by name or a file by path; `BadInputError` if they do not exist or are invalid."""
    return shipped("upsets", UpsetConfig, name)


def altitude_factor(altitude: float) -> float:
    """Neutron flux at an altitude (m) relative to sea level, after JESD89A: exp((1033 - A) / 131.3).

    A is the atmospheric depth (g/cm2), 1033 exp(-0.03813 h - 0.00014 h^2 + 6.4e-7 h^3), h in 1000 ft.
    """
    h = altitude / 304.8
    depth = 1033.0 * math.exp(-0.03813 * h - 0.00014 * h * h + 6.4e-7 * h**3)
    return math.exp((1033.0 - depth) / 131.3)


@dataclass(frozen=True, slots=True)
class Estimate:
    """A value with the bounds of its interval or band."""

    value: float
    low: float
    high: float

    def times(self, factor: float) -> "Estimate":
        """The estimate scaled by a factor."""
        low, high = sorted((factor * self.low, factor * self.high))
        return Estimate(factor * self.value, low, high)


def upsets_per_instruction(upsets: UpsetConfig) -> Estimate:
    """Probability that an upset changes the result of one instruction, with the band due to flux and FIT rate.

    Visible upsets per busy hour, FIT/Mbit x 1e-9 x Mbit x flux x visible, divided by instructions per busy hour.
    """

    def at(fit: float, altitude: float) -> float:
        per_hour = 1e-9 * fit * upsets.unprotected_mbit * upsets.visible * altitude_factor(altitude)
        return per_hour / (_HOUR * upsets.instructions_per_second)

    fit, altitude = upsets.fit_per_mbit, upsets.altitude
    return Estimate(at(fit.value, altitude.value), at(fit.low, altitude.low), at(fit.high, altitude.high))


@dataclass(frozen=True, slots=True)
class Exposed:
    """A kernel or detector in the fault space of a setting.

    Attributes:
        instructions: Dynamic instructions per flight hour.
        harm: Increase in the probability of mission failure per fault.
    """

    instructions: float
    harm: Estimate

    def failures(self, upset: float) -> Estimate:
        """Failures per flight hour at an upset probability per instruction; the interval reflects the harm only."""
        return self.harm.times(self.instructions * upset)


def total_failures(exposed: Iterable[Exposed], upset: float) -> Estimate:
    """Failures per flight hour, summed over kernels.

    Distances to the bounds are added in quadrature (MOVER; Zou and Donner 2008), since the faults of different kernels
    are drawn independently.
    """
    found = [one.failures(upset) for one in exposed]
    value = sum(one.value for one in found)
    below, above = (math.hypot(*(gap(one) for one in found)) for gap in (_below, _above))
    return Estimate(value, value - below, value + above)


def _below(found: Estimate) -> float:
    return found.value - found.low


def _above(found: Estimate) -> float:
    return found.high - found.value
