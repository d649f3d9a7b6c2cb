"""Campaign -> `ResolvedCampaign`: what it names, looked up once; what flies, draws or judges it is given the result."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mavfi.campaign.config import Campaign
from mavfi.errors import BadInputError
from mavfi.levels.level import Sampler
from mavfi.mission import MissionSpec, Scenario

if TYPE_CHECKING:
    from mavfi.detectors.registry import Loaded
    from mavfi.flight.host import Host

_MOST_CAMPAIGNS = 16
"""Campaigns whose arms and samplers are kept in this process."""


@dataclass(frozen=True, slots=True)
class Arm:
    """A configuration under comparison: overrides of the campaign's mission, and a detector."""

    name: str = ""  # "" = the campaign's own mission
    overrides: Mapping[str, Any] = field(default_factory=dict)
    detector: str = ""  # "" = none
    profile: str = ""
    options: Mapping[str, Any] = field(default_factory=dict)  # of the detector
    is_variant: bool = False  # required by the sampling scheme; flown only with the faults drawn in it


@dataclass(frozen=True)
class ResolvedCampaign:
    """A campaign with its arms, its sampler and its host; one that is flown also has its scenarios and models.

    A ledger can be read where its host is missing, which is therefore looked up when it is needed first.  Pickled are
    the campaign, and keys and models by which another process recognizes that its files differ; that process looks up
    the names once.

    Attributes:
        config: The campaign as in its file or ledger.
        arms: The campaign's own mission, the variants required by its sampling scheme, and its arms, in this order.
        sampler: Draws its faults.
        models_dir: Folder of trained models; None = the shipped ones.
        models: The sha256 of the trained model by arm; of a campaign with parts, which may differ in what detectors are
            trained for, by environment/arm.
        scenario_keys: Keys of the scenarios.
        scenarios: Scenario with the campaign's first seed, by environment and arm; not pickled.
    """

    config: Campaign
    arms: tuple[Arm, ...] = field(compare=False, repr=False)
    sampler: Sampler = field(compare=False, repr=False)
    models_dir: Path | None = None
    models: Mapping[str, str] = field(default_factory=dict)
    scenario_keys: Mapping[tuple[str, str], str] = field(default_factory=dict, repr=False)
    scenarios: Mapping[tuple[str, str], Scenario] = field(default_factory=dict, compare=False, repr=False)

    def __reduce__(self) -> tuple[Callable[..., "ResolvedCampaign"], tuple[Any, ...]]:
        return resolve, (self.config, self.models_dir, self.models, self.scenario_keys)

    @cached_property
    def host(self) -> "Host":
        """Where it is flown; raises a BadInputError if it is unknown or cannot be imported."""
        from mavfi.flight.host import find_host  # loads the simulator, which a ledger is read without

        return find_host(self.config.host, self.config.under_test)

    def with_scenarios(self, environments: Sequence[str] = ()) -> "ResolvedCampaign":
        """With its scenarios in these environments (empty = all), from the files as they are now.

        Raises:
            BadInputError: A name is unknown, or options are incompatible.
        """
        scenarios: dict[tuple[str, str], Scenario] = {
            (environment, arm.name): self.host.resolve(self.spec(environment, arm))
            for environment in environments or self.config.environments
            for arm in self.arms
        }
        keys = {name: scenario.key() for name, scenario in scenarios.items()}
        return replace(self, scenario_keys=keys, scenarios=scenarios)

    def with_models(self) -> "ResolvedCampaign":
        """With its scenarios and models; a host that trains detectors itself has no models.

        Raises:
            BadInputError: A name is unknown, options are incompatible, a model is absent or does not match, or a
                detector watches a state that a mission never has.
        """
        from mavfi.detectors.detector import blind_spots

        campaign = self.with_scenarios()
        if self.host.trains:
            return campaign
        models: dict[str, str] = {}
        for arm in self.arms:
            if not arm.detector:
                continue
            for environment in self.config.environments:
                key = arm.name
                if self.config.parts:
                    key = f"{environment}/{arm.name}"
                scenario = campaign.scenarios[environment, arm.name]
                detector, models[key] = self.detector(arm, scenario)
                blind = blind_spots(detector, scenario.localization.kind)
                if blind:
                    raise BadInputError(f"arm {arm.name!r}: {blind}")
        return replace(campaign, models=models)

    def detector(self, arm: Arm, scenario: Scenario) -> "Loaded":
        """The detector of an arm, loaded for a mission, and the sha256 of its model; raises as `with_models`."""
        from mavfi.flight.compose import detector_for

        trained_for = self.spec(self.config.environments[0], arm).trained_for
        return detector_for(scenario, arm.detector, arm.profile, self.models_dir, trained_for, arm.options)

    def spec(self, environment: str, arm: Arm) -> MissionSpec:
        """The first mission of an arm in an environment."""
        return self.config.spec(environment, self.config.first_seed, arm.overrides)

    def model(self, environment: str, arm: str) -> str:
        """The sha256 of an arm's model in an environment, "" = it has none."""
        return self.models.get(f"{environment}/{arm}", self.models.get(arm, ""))


def resolve(
    config: Campaign,
    models_dir: Path | None = None,
    models: Mapping[str, str] | None = None,
    scenario_keys: Mapping[tuple[str, str], str] | None = None,
) -> ResolvedCampaign:
    """Resolve a campaign; the other arguments are attributes of the result.

    Raises:
        BadInputError: The sampling names unknown sites, or conflicts with the rest of the campaign.
    """
    arms, sampler = _names_of(config)
    return ResolvedCampaign(config, arms, sampler, models_dir, models or {}, scenario_keys or {})


_NAMES: dict[str, tuple[tuple[Arm, ...], Sampler]] = {}


def _names_of(config: Campaign) -> tuple[tuple[Arm, ...], Sampler]:
    """Arms and sampler of a campaign; cached, since the sampler holds the strata of all missions."""
    from mavfi.detectors.registry import mission_keys

    key = config.model_dump_json()
    if key not in _NAMES:
        while len(_NAMES) >= _MOST_CAMPAIGNS:
            del _NAMES[next(iter(_NAMES))]
        sampler = config.level.sampler(config)
        variants = [Arm(name, overrides, is_variant=True) for name, overrides in sampler.variants.items()]
        arms = [
            Arm(
                name,
                {**mission_keys(arm.detector), **arm.mission},
                arm.detector,
                arm.profile if arm.detector else "",
                arm.options,
            )
            for name, arm in config.arms.items()
        ]
        _NAMES[key] = (Arm(), *variants, *arms), sampler
    return _NAMES[key]
