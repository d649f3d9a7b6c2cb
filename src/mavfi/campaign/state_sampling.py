"""How faults in inter-kernel states are drawn."""

from typing import Annotated, ClassVar, Literal

from pydantic import Field, model_validator

from mavfi.campaign.checks import NULL_RUNS, check_distinct, check_known, check_strata
from mavfi.config import Config
from mavfi.states import STATES


class Lifetime(Config):
    """Duration and width of state faults; by default one bit of one publication."""

    lasts_s: Annotated[float, Field(ge=0)] | Literal["inf"] = Field(
        0.0, description="stuck in every publication for this time (s, from 0 on); inf = for ever"
    )
    share: float = Field(1.0, gt=0, le=1, description="probability that a publication after the first one is changed")
    width: int = Field(1, ge=1, le=64, description="adjacent bits")
    times: int = Field(1, ge=1, description="publications, recomputed ones included, in which it is stuck at least")


class SiteGroup(Config):
    """Fields that share a row of a table; each fault is in one of them, drawn uniformly."""

    name: str
    sites: tuple[str, ...] = Field(min_length=1, description="state.field; of memories kernel.field")
    strata: dict[str, float] | None = Field(None, description="instead of the campaign's")
    lifetime: Lifetime | None = Field(
        None, description="instead of the campaign's; groups of the same sites then have the same draws"
    )


class StateSampling(Config):
    """Faults in inter-kernel states: one bit of one field of one publication."""

    null_runs: ClassVar[int] = NULL_RUNS
    level: Literal["state"] = "state"
    scheme: Literal["stage_balanced", "groups", "messages"] = Field(
        "stage_balanced",
        description="`faults` for each stage (the paper's scheme), each group, or each message, uniform over its bits",
    )
    sites: Literal["all", "monitored"] = Field("all", description="fields that stage_balanced draws from")
    groups: tuple[SiteGroup, ...] = ()
    messages: tuple[str, ...] = Field((), description="names of states, for scheme messages")
    strata: dict[str, float] = Field(
        default_factory=lambda: {"sign_exponent": 2.0, "mantissa": 1.0}, description="shares of the faults by bit class"
    )
    lifetime: Lifetime = Lifetime()

    @model_validator(mode="after")
    def _consistent(self) -> "StateSampling":
        for key, given in (("groups", self.groups), ("messages", self.messages)):
            if (self.scheme == key) != bool(given):
                raise ValueError(
                    f"sampling.scheme: {self.scheme!r}: allowed with the key {key}: {key}" if given
                    else f"sampling.{key}: is required with scheme {key!r}; allowed: a list of 1 or more"
                )  # fmt: skip
        check_known("sampling.messages", self.messages, STATES)
        check_distinct("sampling.messages", self.messages)
        check_distinct("sampling.groups", [group.name for group in self.groups])
        for strata in (self.strata, *(group.strata for group in self.groups if group.strata is not None)):
            check_strata(strata)
        return self
