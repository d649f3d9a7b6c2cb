"""What a fault level reads of a campaign; `mavfi.campaign.config.Campaign` has all of it."""

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

from pydantic import Field

from mavfi.config import Config
from mavfi.faults.plug_ins import PlugIn
from mavfi.mission import MissionSpec

MOST_FAULTS = 100_000  # per environment and target


class Size(Config):
    """A size that a campaign had before it was extended."""

    missions: int = Field(ge=1)
    faults: int = Field(ge=1, le=MOST_FAULTS)


class SampledArm(Protocol):
    """An arm of a campaign."""

    @property
    def mission(self) -> Mapping[str, Any]:
        """Keys of the mission that differ from the campaign's."""


class SampledCampaign(Protocol):
    """A campaign whose faults are drawn."""

    @property
    def name(self) -> str:
        """Its name."""

    @property
    def environments(self) -> Sequence[str]:
        """Names of environments, or of parts."""

    @property
    def first_seed(self) -> int:
        """Seed of the first mission in each environment."""

    @property
    def missions(self) -> int:
        """Missions per environment."""

    @property
    def faults(self) -> int:
        """Faults per environment and target."""

    @property
    def sizes(self) -> Sequence[Size]:
        """The sizes that it has had, and its own."""

    @property
    def nulls(self) -> int:
        """Number of null runs per environment."""

    @property
    def sampling(self) -> Any:
        """How faults are drawn, in the model of the level, see `Level.sampling`."""

    @property
    def monitored_set(self) -> str:
        """Name of the fields that count as monitored."""

    @property
    def under_test(self) -> Any:
        """What is under test instead of our pipeline, in the model of the host; None = our pipeline."""

    @property
    def arms(self) -> Mapping[str, SampledArm]:
        """The arms by name."""

    @property
    def custom_detectors(self) -> Mapping[str, PlugIn]:
        """Detectors that are not part of mavfi, by arm."""

    def arm_with(self, target: str) -> str:
        """The arm with a detector of mavfi; a BadInputError unless exactly one has it."""

    def environment_of(self, name: str) -> str:
        """The environment of a part, by its name; without parts, the name itself."""

    @property
    def first_mission(self) -> MissionSpec:
        """The first mission in the first environment."""

    def spec(self, environment: str, seed: int, overrides: Mapping[str, Any] | None = None) -> MissionSpec:
        """The mission for an environment and seed, with the overrides of an arm."""

    def with_sampling(self, sampling: Any) -> "SampledCampaign":
        """The campaign with faults that are drawn otherwise, and without null runs."""
