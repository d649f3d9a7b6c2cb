"""Failures of sensors and motors, as text: `sensor:gyro:drift@10`, `sensor:motor2:off:lasts=0.5`.

In campaigns: `faults` for each unit, its types in equal shares.  The start is uniform over the golden flight; of
several motors, the number is uniform.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import Field, field_validator, model_validator

from mavfi.errors import BadInputError, not_known
from mavfi.faults.fault import NO_SITE, Fault
from mavfi.faults.sampling import stream
from mavfi.levels.campaign import SampledCampaign
from mavfi.levels.level import SECONDS, Draw, Golden, Level, Sampler, Sampling, check_distinct, check_known
from mavfi.levels.sensor.fault import FAILING, NULL, RANDOM, UNITS, SensorFault, check_read
from mavfi.mission import MissionSpec

if TYPE_CHECKING:
    from mavfi.flight.host import ArmSetup, Flight
    from mavfi.levels.sensor.injector import SensorInjector

_DEVICE = re.compile(r"(?P<unit>[a-z_]+)(?P<instance>\d+)?")
"""A device in the text of a fault: its name, and the number of one of several."""


@dataclass(frozen=True, slots=True)
class SensorRequest:
    """A failure of a sensor or motor as requested by the user.

    Attributes:
        fault: The failure.
        draws_start: Whether its start is drawn from the golden run.
    """

    fault: SensorFault
    draws_start: bool

    def draw(self, setup: "ArmSetup", seed: int) -> "tuple[SensorFault, Flight | None]":
        """See `Request.draw`."""
        from mavfi.flight.fly import fly

        scenario = setup.scenario
        check_read(self.fault.unit, scenario.flight_controller, scenario.localization.kind)
        if not self.draws_start:
            return self.resolve(seed, 0), None
        golden = fly(scenario)
        return self.resolve(seed, round(1e6 * golden.record().flight_time_s)), golden

    def resolve(self, seed: int, flight_time_us: int, *address: int | str) -> SensorFault:
        """The failure; an instant that is not given is uniform over a flight of some length (us)."""
        if not self.draws_start:
            return replace(self.fault, seed=seed)
        random = stream(seed, "sensor", self.fault.unit, self.fault.kind, *address)
        return replace(self.fault, seed=seed, time_us=int(random.integers(flight_time_us)))


class SensorSampling(Sampling):
    """Failures of sensors and motors, from an instant that is uniform over the golden flight."""

    level: Literal["sensor"]
    units: tuple[str, ...] = Field((), description="`faults` for each; by default all that the mission reads")
    types: tuple[str, ...] = Field(FAILING, min_length=1, description="of failures, in equal shares")
    lasts_s: Annotated[float, Field(gt=0)] | Literal["inf"] = Field(
        "inf", description="duration (s); inf = to the end of the flight"
    )

    @field_validator("types", mode="before")
    @classmethod
    def _unquoted(cls, types: Any) -> Any:  # noqa: ANN401 - as in the file
        """YAML reads an unquoted `off` as false."""
        if isinstance(types, list):
            return ["off" if kind is False else kind for kind in types]
        return types

    @model_validator(mode="after")
    def _consistent(self) -> "SensorSampling":
        """Check names of units and kinds of failures."""
        check_known("sampling.units", self.units, UNITS)
        check_known("sampling.types", self.types, FAILING)
        check_distinct("sampling.units", self.units)
        check_distinct("sampling.types", self.types)
        return self


class SensorSampler(Sampler):
    """Draws the start of a failure, and of several motors one.

    Raises:
        BadInputError: The sampling names a unit that nothing in the mission reads.
    """

    draws_together = False

    def __init__(self, campaign: SampledCampaign) -> None:
        super().__init__(campaign)
        mission = campaign.first_mission
        units = self.sampling.units or tuple(unit for unit in UNITS if _is_read(unit, mission))
        if campaign.under_test is None:
            for unit in units:
                check_read(unit, mission.flight_controller, mission.localization)
        self.targets = dict.fromkeys(units, dict.fromkeys(self.sampling.types, 1.0))

    def draw(self, draws: Sequence[Draw], environment: str, golden: Golden) -> list[Fault | None]:
        """One failure per draw; None without a golden run."""
        if "" not in golden:
            return [None] * len(draws)
        return [self._fault(d.target, d.stratum, self.repetition(d.index), d.seed, environment, golden) for d in draws]

    def null(self, index: int, seed: int, environment: str, golden: Golden) -> Fault:
        """A fault that changes nothing; units alternate."""
        units = list(self.targets)
        return self._fault(units[index % len(units)], NULL, index // self.campaign.missions, seed, environment, golden)

    def _fault(self, unit: str, kind: str, repetition: int, seed: int, environment: str, golden: Golden) -> SensorFault:
        """The failure with this number in a mission of a device; without a golden run, it has no site."""
        address = environment, repetition
        instances = UNITS[unit].instances
        instance = 0
        if instances > 1:
            instance = 1 + int(stream(seed, "instance", unit, *address).integers(instances))
        planned = SensorFault(unit, kind, lasts_s=float(self.sampling.lasts_s), instance=instance)
        flight_time_us = 0
        if "" in golden:
            flight_time_us = round(1e6 * golden[""].flight.record().flight_time_s)
        if not flight_time_us:
            return replace(planned, time_us=NO_SITE, seed=seed)
        return SensorRequest(planned, draws_start=True).resolve(seed, flight_time_us, *address)


def _is_read(unit: str, mission: MissionSpec) -> bool:
    """Whether something in a mission reads a unit."""
    try:
        check_read(unit, mission.flight_controller, mission.localization)
    except BadInputError:
        return False
    return True


class SensorLevel(Level):
    """Failures of sensors and motors."""

    fault = SensorFault
    sampling = SensorSampling
    sampler = SensorSampler
    local = True
    can_wait = True
    form = "sensor:UNIT[NUMBER]:TYPE[:lasts=S][@SECONDS]"
    options = {"lasts": SECONDS}
    absent = ("read", "no reader received another value than without it")
    corrupts_data = False

    def parse(self, text: str, localization: str) -> SensorRequest:
        """See `Level.parse`."""
        unit, _, rest = text.partition(":")
        unit = unit.partition("@")[0]
        if not unit:
            self.not_understood()
        device = _DEVICE.fullmatch(unit)
        if device is None or device["unit"] not in UNITS:
            raise BadInputError(f"sensor {not_known(unit, UNITS)}")
        if not rest or "=" in rest.partition(":")[0]:
            raise BadInputError(
                f"no type of failure; allowed: sensor:{unit}:TYPE, with TYPE one of {', '.join(FAILING)}"
            )
        parts = self.parts_of(rest)
        if parts.site not in (*FAILING, NULL):
            raise BadInputError(f"sensor fault: {not_known(parts.site, FAILING)}")
        fault = SensorFault(
            device["unit"],
            parts.site,
            parts.time_us or 0,
            parts.options.get("lasts", float("inf")),
            int(device["instance"] or 0),
        )
        return SensorRequest(fault, draws_start=parts.time_us is None)

    def text_of(self, fault: SensorFault) -> str:
        """See `Level.text_of`."""
        lasts = ""
        if fault.lasts_s != float("inf"):
            lasts = f":lasts={fault.lasts_s}"
        return f"sensor:{fault.device}:{fault.kind}{lasts}@{fault.time_us / 1e6}"

    def seed_of(self, fault: SensorFault) -> int | None:
        """See `Level.seed_of`."""
        if fault.kind in RANDOM:
            return fault.seed
        return None

    def inject(self, loop: Any, fault: SensorFault, detector: Any) -> "SensorInjector":
        """See `Level.inject`."""
        from mavfi.levels.sensor.injector import SensorInjector

        injector = loop.taps.injector = SensorInjector(loop, fault)
        return injector

    def columns(self, fault: SensorFault) -> dict[str, Any]:
        """See `Level.columns`."""
        return {"state": fault.unit, "field": fault.kind}

    def about(self, campaign: SampledCampaign) -> dict[str, Any]:
        """See `Level.about`."""
        sampling = campaign.sampling
        if sampling.lasts_s == "inf":
            lasts = "to the end"
        else:
            lasts = f"for {sampling.lasts_s:g} s"
        return {"each": "unit", "how": f"types {', '.join(sampling.types)}, from a uniform instant {lasts}"}


def parse_sensor(text: str, seed: int) -> SensorFault:
    """Parse a failure that begins at a given instant.

    Raises:
        BadInputError: Another form, or no instant.
    """
    try:
        request = SensorLevel().parse(text.partition(":")[2], "")
    except BadInputError as error:
        raise BadInputError(f"fault {text!r}: {error}") from None
    if request.draws_start:
        raise BadInputError(f"fault {text!r}: without an instant; allowed: ...@SECONDS")
    return request.resolve(seed, 0)
