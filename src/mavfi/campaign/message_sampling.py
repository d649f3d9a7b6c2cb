"""How faults in the calls of a program are drawn."""

from typing import ClassVar, Literal

from pydantic import Field, model_validator

from mavfi.campaign.checks import NULL_RUNS, check_distinct
from mavfi.config import Config


class MessageSampling(Config):
    """Faults in the calls of a program (host airsim_program): one bit of one number of one call."""

    null_runs: ClassVar[int] = NULL_RUNS
    level: Literal["message"]
    sides: tuple[Literal["arguments", "return"], ...] = Field(
        ("arguments", "return"), min_length=1, description="of the calls; `faults` for each"
    )
    calls: tuple[str, ...] = Field((), description="names of the calls; all that the golden run makes by default")

    @model_validator(mode="after")
    def _consistent(self) -> "MessageSampling":
        check_distinct("sampling.sides", self.sides)
        return self
