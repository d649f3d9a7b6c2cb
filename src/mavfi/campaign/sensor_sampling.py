"""How failures of sensors and motors are drawn."""

from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field, field_validator, model_validator

from mavfi.campaign.checks import NULL_RUNS, check_distinct, check_known
from mavfi.config import Config
from mavfi.faults.sensor.fault import FAILING, UNITS


class SensorSampling(Config):
    """Failures of sensors and motors, from an instant that is uniform over the golden flight."""

    null_runs: ClassVar[int] = NULL_RUNS
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
        return ["off" if one is False else one for one in types] if isinstance(types, list) else types

    @model_validator(mode="after")
    def _consistent(self) -> "SensorSampling":
        check_known("sampling.units", self.units, UNITS)
        check_known("sampling.types", self.types, FAILING)
        check_distinct("sampling.units", self.units)
        check_distinct("sampling.types", self.types)
        return self
