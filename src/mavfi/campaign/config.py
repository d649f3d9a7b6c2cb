"""Model of a campaign: the YAML files in configs/campaigns."""

from collections.abc import Callable, Iterable, Mapping
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from pydantic import (
    Field,
    SerializeAsAny,
    SerializerFunctionWrapHandler,
    ValidationInfo,
    model_serializer,
    model_validator,
)

from mavfi.campaign.requirement import Requirement
from mavfi.config import STORED, Config, Name, names, parse, parse_part, shipped
from mavfi.errors import BadInputError, not_known
from mavfi.faults.fault import find_level, level_names
from mavfi.faults.plug_ins import PlugIn, is_custom_detector, plug_ins_of_spec
from mavfi.levels.campaign import MOST_FAULTS, Size
from mavfi.levels.level import Level, Sampling, check_distinct, check_known
from mavfi.mission import MissionSpec
from mavfi.plugins import extensions
from mavfi.states import MONITORED_SETS, PLANNERS

if TYPE_CHECKING:
    from mavfi.flight.host import Host

DESIGN_SEEDS = range(10_000)  # seeds used for tuning the autopilot profiles
TRAINING_SEED = 1_000_000  # first seed of the training flights of detectors; never used by campaigns

_OF_SAMPLING = ("groups", "kernels", "scheme", "sites", "strata")
"""Keys of `sampling` that are easily written one level too high."""
_SETTINGS = ("golden", "fi", "dr", "null")
"""Settings, and the beginnings of their names."""
_STORED_WITHOUT_VALUE = ("until_halfwidth", "node", "program")
"""Keys that ledgers may have without a value."""
_LOCAL = "local"


@cache
def label_of(environment: str) -> str:
    """An environment's name in run ids and tables: of a file, its name without folder and ending.

    A file named like a shipped environment keeps its path: the paper's figures are not those of its world.
    """
    path = Path(environment)
    if path.suffix and path.stem not in names("environments"):
        return path.stem
    return environment


class ArmConfig(Config):
    """An arm of a comparison: all missions are flown and all faults injected once more, with these settings.

    In addition to the keys below, an arm accepts any key of a mission except `environment` and `seed`.
    """

    also_accepts: ClassVar = tuple(key for key in MissionSpec.model_fields if key not in ("environment", "seed"))
    detector: str = Field("", description="entry point of the group mavfi.detectors, or package:Class")
    profile: str = Field("paper", description="of the detector: paper or tuned")
    options: dict[str, Any] = Field(
        default_factory=dict, description="of the detector, e.g. rules: [1, 3]; over those of its file and profile"
    )
    mission: dict[str, Any] = Field(default_factory=dict, description="keys that differ; also allowed in the arm")

    @model_validator(mode="before")
    @classmethod
    def _gather(cls, data: Any, info: ValidationInfo) -> Any:
        """Move keys of missions, which may stand beside those of the campaign, to `mission`."""
        if not isinstance(data, dict):
            return data
        inline = {key: data[key] for key in data if key in MissionSpec.model_fields}
        rest = {key: value for key, value in data.items() if key not in inline}
        mission = rest.get("mission", {})
        if not isinstance(mission, dict):
            return data  # rejected by validation
        return {**rest, "mission": _mission_keys({**mission, **inline}, "arms", info)}


class CampaignPart(Config):
    """A named variant of an environment in a campaign, e.g. with another platform."""

    environment: str
    platform: str | None = None


class Scale(Config):
    """An alternative size of a campaign."""

    missions: int | None = Field(None, ge=1)
    faults: int | None = Field(None, ge=1, le=MOST_FAULTS)


class Campaign(Config):
    """A campaign as written by the user.

    Each environment has `missions` missions, with consecutive seeds from `first_seed`, and `faults` faults for each
    target of the sampling scheme (stage, group, kernel, kind of registers); fault i is injected in mission i modulo
    `missions`.  With `grown`, its first faults are those of the smaller campaign; the others go on from the last
    mission, or begin with the first new one.
    """

    name: Name
    host: str = Field(
        "local",
        description="where: local, ros2, ros2_stack, firmware, airsim_program, or another entry point",
    )
    environments: tuple[str, ...] = Field(min_length=1)
    first_seed: int = Field(10_000, ge=0)
    missions: int = Field(30, ge=1, description="per environment")
    faults: int = Field(30, ge=1, le=MOST_FAULTS, description="per environment and target")
    grown: tuple[Size, ...] = Field(
        (), description="earlier sizes, as `campaign run --extend` records them in the ledger"
    )
    scales: dict[str, Scale] = Field(default_factory=dict, description="other sizes, by name")
    mission: dict[str, Any] = Field(default_factory=dict, description="keys of a mission, for all arms")
    sampling: SerializeAsAny[Sampling] = Field(
        default_factory=lambda: _sampling({}, None), description="how faults are drawn; its `level` has the keys"
    )
    monitored_set: str = Field("paper-13", description="fields that count as monitored, in tables and sampling")
    null_runs: int | None = Field(
        None, ge=0, le=MOST_FAULTS, description="per environment; each arm in turn; default 3 for states"
    )
    arms: dict[str, ArmConfig] = Field(default_factory=dict, description="by name")
    parts: dict[str, CampaignPart] = Field(
        default_factory=dict, description="by name in environments, e.g. one per platform"
    )
    require: tuple[str, ...] = Field(
        (), description="bounds on rates, judged by their intervals, e.g. `sdc < 5 %`; see docs/how-to/ci.md"
    )
    under_test: SerializeAsAny[Config] | None = Field(
        None, description="what is under test instead of our pipeline; given under the key of its host"
    )

    @model_validator(mode="before")
    @classmethod
    def _complete(cls, data: Any, info: ValidationInfo) -> Any:
        """Validate the parts whose models belong to the level and the host that the campaign names."""
        if not isinstance(data, dict):
            return data
        data = {key: value for key, value in data.items() if value is not None or key not in _STORED_WITHOUT_VALUE}
        data = _with_under_test(data, info)
        for key in data:
            if key in cls.model_fields:
                continue
            if key in _OF_SAMPLING:
                raise ValueError(f"key {key!r}: allowed as sampling.{key}")
            if key in MissionSpec.model_fields:
                raise ValueError(f"key {key!r}: allowed as mission.{key}")
        if isinstance(data.get("mission"), dict):
            data["mission"] = _mission_keys(data["mission"], "mission", info)
        if "sampling" in data:
            data["sampling"] = _sampling(data["sampling"], info, data.get("host", _LOCAL))
        return data

    @model_serializer(mode="wrap")
    def _stored(self, serialize: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """What is under test is stored under the key of its host; ledgers have two of these keys with every host.

        Requirements and earlier sizes are omitted if there are none; ledgers never have requirements, see
        `without_requirements`.
        """
        data: dict[str, Any] = serialize(self)
        for key in ("require", "grown"):
            if not data[key]:
                del data[key]
        under_test = data.pop("under_test")
        data |= {"node": None, "program": None}
        host = _class_of_host(self.host)
        if host is None or host.config is None:
            return data
        return data | {host.config_key: under_test}

    @model_validator(mode="after")
    def _consistent(self) -> "Campaign":
        """Check what depends on several keys: seeds, names, and how the level and the host draw faults."""
        missions = max([self.missions, *(scale.missions or 0 for scale in self.scales.values())])
        if self.first_seed + missions > TRAINING_SEED:
            raise ValueError(
                f"first_seed: {self.first_seed}, missions: {missions}: seeds from {TRAINING_SEED} on are for training"
            )
        for key in ("missions", "faults"):
            numbers = [getattr(size, key) for size in self.sizes]
            if numbers != sorted(numbers):
                raise ValueError(f"grown: {key} {', '.join(map(str, numbers))}: allowed: none above the next one")
        check_known("monitored_set", [self.monitored_set], MONITORED_SETS)
        check_distinct("environments", map(label_of, self.environments))
        check_known("parts", self.parts, self.environments)
        for name in self.arms:
            if name in PLANNERS:
                raise ValueError(f"arms: {name!r}: is the name of a planner; allowed: any other name")
            if name in _SETTINGS or "/" in name or not name.isprintable():
                raise ValueError(
                    f"arms: {name!r}: allowed: any name but {', '.join(_SETTINGS)}, without a slash and control "
                    "characters"
                )
        host = _class_of_host(self.host)
        try:
            if host is not None:
                host.check_sampling(self.sampling)
            self.level.sampler(self)
        except BadInputError as error:
            raise ValueError(str(error)) from None
        try:
            self.requirements(self.require)
        except BadInputError as error:
            raise ValueError(f"require: {error}") from None
        return self

    def at_scale(self, name: str) -> "Campaign":
        """The campaign at a scale; "quick" is the size given by its top-level keys.

        Raises:
            BadInputError: The scale is not defined.
        """
        if name == "quick":
            return self
        if name not in self.scales:
            raise BadInputError(f"campaign {self.name}: scale {not_known(name, ['quick', *self.scales])}")
        return self.resized(self.scales[name])

    def resized(self, size: Scale) -> "Campaign":
        """The campaign with the missions and faults of a scale."""
        return self.model_copy(update={**size.model_dump(exclude_none=True), "grown": ()})

    def with_sampling(self, sampling: Sampling) -> "Campaign":
        """The campaign with faults that are drawn otherwise, and without null runs."""
        return self.model_copy(update={"sampling": sampling, "null_runs": 0})

    def requirements(self, texts: Iterable[str]) -> list[Requirement]:
        """Requirements on its result, each with its arm.

        Raises:
            BadInputError: A text is not understood, or the campaign has no such arm.
        """
        detectors = {name: arm.detector for name, arm in self.arms.items()}
        return [Requirement.parse(text).of(detectors) for text in texts]

    def without_requirements(self) -> "Campaign":
        """The campaign as ledgers hold it: requirements judge its result, and are no part of it."""
        if not self.require:
            return self
        return self.model_copy(update={"require": ()})

    @property
    def flies(self) -> bool:
        """Whether its runs are flights, see `Host.flies`."""
        flown_by = _class_of_host(self.host)
        return flown_by is None or flown_by.flies

    @property
    def level(self) -> Level:
        """The level of the sampling, as its host draws it."""
        return _level_at(self.host, self.sampling.level)

    @property
    def sizes(self) -> tuple[Size, ...]:
        """The sizes that it has had, and its own."""
        return (*self.grown, Size(missions=self.missions, faults=self.faults))

    @property
    def seeds(self) -> range:
        """Mission seeds, the same in each environment."""
        return range(self.first_seed, self.first_seed + self.missions)

    @property
    def total_missions(self) -> int:
        """Number of missions over all environments."""
        return len(self.environments) * self.missions

    @property
    def nulls(self) -> int:
        """Number of null runs per environment."""
        if self.null_runs is None:
            return self.sampling.null_runs
        return self.null_runs

    @property
    def on_design_seeds(self) -> bool:
        """Whether any mission seed was used for tuning the autopilot profiles; such results are not published."""
        return self.first_seed < DESIGN_SEEDS.stop

    def arm_with(self, target: str) -> str:
        """The arm in which a detector, also as a named configuration (`recommended`), is injected.

        Raises:
            BadInputError: It is in no arm, or in several.
        """
        from mavfi.detectors.registry import contains

        watching = ((name, arm) for name, arm in self.arms.items() if arm.detector)
        arms = [name for name, arm in watching if contains(arm.detector, arm.profile, target)]
        if len(arms) != 1:
            raise BadInputError(f"sampling.kernels: {target!r}: is in {len(arms)} arms; allowed: what is in one arm")
        return arms[0]

    @property
    def custom_detectors(self) -> dict[str, PlugIn]:
        """The detectors that are not part of mavfi, by arm."""
        detectors = {}
        for name, arm in self.arms.items():
            if is_custom_detector(arm.detector):
                spec = self.spec(self.environments[0], self.first_seed, arm.mission)
                detectors[name] = plug_ins_of_spec(spec, arm.detector)[-1]
        return detectors

    def environment_of(self, name: str) -> str:
        """The environment of a part, by its name; without parts, the name itself."""
        if name in self.parts:
            return self.parts[name].environment
        return name

    @property
    def first_mission(self) -> MissionSpec:
        """The first mission in the first environment."""
        return self.spec(self.environments[0], self.first_seed)

    def spec(self, environment: str, seed: int, overrides: Mapping[str, Any] | None = None) -> MissionSpec:
        """The mission for an environment and seed, with the overrides of an arm."""
        part = self.parts.get(environment, CampaignPart(environment=environment))
        part_keys = part.model_dump(exclude_none=True)
        keys = {**self.mission, **(overrides or {}), **part_keys, "seed": seed}  # later entries replace earlier ones
        return parse(MissionSpec, keys, f"campaign {self.name}")

    def to_json(self) -> dict[str, Any]:
        """Plain data; unset keys of later versions are omitted, so that older campaigns keep their identity."""
        data = self.model_dump(mode="json")
        for arm in data["arms"].values():
            if not arm["options"]:
                del arm["options"]
        if not self.parts:
            del data["parts"]
        if data["program"] is None:
            del data["program"]
        return {**data, "sampling": self.sampling.to_json()}

    def identity(self) -> dict[str, Any]:
        """Plain data in the identity of a ledger."""
        return {**self.to_json(), "sampling": self.sampling.identity()}


def _class_of_host(name: Any) -> "type[Host] | None":
    """The class of a host that may have keys and rules for campaigns; None = unknown, which is refused later."""
    if not isinstance(name, str) or name == _LOCAL:
        return None  # loading the simulator takes a second
    from mavfi.flight.host import host_class

    try:
        return host_class(name)
    except BadInputError:
        return None


def _with_under_test(data: dict[str, Any], info: ValidationInfo) -> dict[str, Any]:
    """The data with what is under test, given under the key of its host, validated as `under_test`."""
    host = _class_of_host(data.get("host"))
    if host is not None and host.config is not None:
        key = host.config_key
        values = data.pop(key, data.get("under_test"))
        if values is None:
            raise ValueError(f"host: {host.name!r}: the key {key} goes with host {host.name}, and only with it")
        under_test = parse_part(host.config, values, key, info.context)
        data = {**host.campaign_defaults(under_test), **data, "under_test": under_test}
    # a key of what is under test at another host; other unknown keys are refused later
    for key in data.keys() - Campaign.model_fields.keys():
        for other in extensions("mavfi.hosts").values():
            if other.config_key == key:
                raise ValueError(
                    f"host: {data.get('host', _LOCAL)!r}: the key {key} goes with host {other.name}, and only with it"
                )
    return data


def _level_at(host_name: Any, name: str) -> Level:
    """A level, as a host draws its faults; a BadInputError if there is no such level."""
    find: Callable[[str], Level] = find_level
    host = _class_of_host(host_name)
    if host is not None:
        find = host.level_of
    return find(name)


def _sampling(data: Any, info: ValidationInfo | None, host_name: Any = _LOCAL) -> Sampling:
    """The sampling, as validated by its level, or by that of the host if it draws these faults otherwise."""
    if isinstance(data, Mapping):
        level = data.get("level", "state")
    else:
        level = getattr(data, "level", "state")
    levels = level_names()
    model = None
    if level in levels:
        model = _level_at(host_name, level).sampling
    if model is None:
        raise ValueError(f"key 'sampling.level': {not_known(level, levels)}")
    context = None if info is None else info.context
    sampling: Sampling = parse_part(model, data, "sampling", context)
    return sampling


def _mission_keys(data: Mapping[str, Any], where: str, info: ValidationInfo) -> dict[str, Any]:
    """Validate keys and values of a mission in a campaign of the user, or in one that a ledger stores."""
    for key in ("environment", "seed"):
        if key in data:
            raise ValueError(f"{where}.{key}: belongs to the campaign (environments, first_seed)")
    try:
        parsed = parse(MissionSpec, dict(data), where, stored=info.context == STORED)
    except BadInputError as error:
        raise ValueError(str(error)) from None
    return parsed.model_dump(mode="json", include=parsed.model_fields_set)


def load_campaign(name: str | Path) -> Campaign:
    """Read a campaign from a path, or a shipped one by name, e.g. "table1".

    Raises:
        BadInputError: The file does not exist or is invalid.
    """
    return shipped("campaigns", Campaign, str(name))
