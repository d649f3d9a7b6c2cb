"""How faults are drawn: models of the key `sampling` of a campaign, and checks that these share.

Those of memories, instructions and registers are in `campaign.config`.
"""

from collections import Counter
from collections.abc import Collection, Iterable, Mapping
from functools import cache
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field, field_validator, model_validator

from mavfi.config import SCAN_ENDINGS, Config, names
from mavfi.dropped import dropped_name
from mavfi.faults.levels.sensor.fault import FAILING, UNITS
from mavfi.faults.strata import STRATA
from mavfi.states import STATES

_ENVIRONMENT_FILES = (".yaml", ".yml", *SCAN_ENDINGS)
NULL_RUNS = 3  # default number of null runs per environment, except for instruction faults


def check_known(key: str, given: Iterable[str], allowed: Collection[str]) -> None:
    """Raise a ValueError for a name that is not allowed."""
    for name in given:
        if key.endswith("kernels") and dropped_name("kernels", name):
            raise ValueError(f"{key}: {dropped_name('kernels', name)}")
        if name not in allowed:
            raise ValueError(f"{key}: {name!r}: not known; allowed: {', '.join(allowed)}")


def check_distinct(key: str, given: Iterable[str]) -> None:
    """Raise a ValueError for a name that occurs twice."""
    for name, count in Counter(given).items():
        if count > 1:
            raise ValueError(f"{key}: {name!r}: named {count} times; allowed: once")


def check_strata(strata: Mapping[str, float]) -> None:
    """Raise a ValueError for unknown strata, or shares that are not above 0."""
    check_known("sampling.strata", sorted(strata), STRATA)
    if not strata or not all(0 < share < float("inf") for share in strata.values()):
        raise ValueError(f"sampling.strata: {strata}: need at least one name, and shares above 0")


@cache
def label_of(environment: str) -> str:
    """An environment's name in run ids and tables: of a file, its name without folder and ending.

    A file named like a shipped environment keeps its path: the paper's figures are not those of its world.
    """
    path = Path(environment)
    own = path.suffix.lower() in _ENVIRONMENT_FILES and path.stem not in names("environments")
    return path.stem if own else environment


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
