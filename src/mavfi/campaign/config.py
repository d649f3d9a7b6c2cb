"""Model of a campaign: the YAML files in configs/campaigns."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Discriminator, Field, Tag, ValidationInfo, model_validator

from mavfi.campaign.sampling import (
    NULL_RUNS,
    Lifetime,
    MessageSampling,
    SensorSampling,
    SiteGroup,
    StateSampling,
    check_distinct,
    check_known,
    check_strata,
    label_of,
)
from mavfi.config import STORED, Config, Name, parse, shipped
from mavfi.errors import BadInputError
from mavfi.extras.airsim.config import ProgramConfig
from mavfi.extras.ros.node.config import NodeConfig
from mavfi.faults.fault import ACCESSES, LONGEST_WALK, Model
from mavfi.mission import MissionSpec
from mavfi.states import DETECTORS, INJECTABLE, MONITORED_SETS, PLANNERS

DESIGN_SEEDS = range(10_000)  # seeds used for tuning the autopilot profiles
TRAINING_SEED = 1_000_000  # first seed of the training flights of detectors; never used by campaigns
MOST_FAULTS = 100_000  # per environment and target

_RENAMED = {
    "law": "sampling.scheme", "strata": "sampling.strata", "groups": "sampling.groups", "sites": "sampling.sites",
    "kernels": "sampling.kernels (with level: instruction)", "detectors": "arms", "flights": "missions",
    **{name: f"mission.{name}" for name in ("platform", "planner", "map", "vehicle", "v_max")},
    "kind": "host", "trials": "faults", "command": "node.command",
}  # fmt: skip
"""Keys of campaign schema 1, with their replacements."""
_SETTINGS = ("golden", "fi", "dr", "null")
"""Settings, and the beginnings of their names."""
_STORED_SCHEME = "uniform"
"""Value of the key `scheme` in the identities of ledgers with faults in instructions; there was another one once."""
_UNDER_TEST = {"node": "node", "airsim_program": "program"}
"""Hosts where something other than our pipeline is under test, with the key that names it."""


class MemorySampling(Config):
    """Faults in memory of kernels or detectors: one bit, uniform over bits and instants of a golden run."""

    null_runs: ClassVar[int] = NULL_RUNS
    level: Literal["memory"]
    kernels: tuple[str, ...] = Field((), description="whose memory; all kernels by default")
    share: Literal["exposure", "kernel"] = Field(
        "exposure", description="what `faults` counts: all bits together, most of which are maps, or each kernel"
    )
    groups: tuple[SiteGroup, ...] = Field((), description="instead: `faults` for each of these, e.g. planner.acted_seq")
    strata: dict[str, float] | None = Field(None, description="shares of the faults by bit class; whole words else")

    @model_validator(mode="after")
    def _consistent(self) -> "MemorySampling":
        check_distinct("sampling.kernels", self.kernels)
        check_distinct("sampling.groups", [group.name for group in self.groups])
        if self.strata is not None:
            check_strata(self.strata)
        if any(group.lifetime or group.strata for group in self.groups):
            raise ValueError("sampling.groups: keys lifetime and strata: allowed with faults in states")
        return self


class InstructionSampling(Config):
    """Faults in instructions: the result of one dynamic instruction of a kernel."""

    null_runs: ClassVar[int] = 0
    level: Literal["instruction"]
    kernels: tuple[str, ...] = Field(min_length=1, description="kernels; planners; detectors of an arm")
    share: Literal["kernel", "stage"] = Field(
        "kernel", description="what `faults` counts: each kernel, or each stage, whose kernels share them equally"
    )
    which: str = Field("all", description="class of instructions, e.g. floating_point")
    model: Model = Field("one_bit", description="what becomes of the value")
    restart_s: float = Field(0.57, ge=0, le=60, description="time until a dead node is back (s)")

    @model_validator(mode="before")
    @classmethod
    def _without_scheme(cls, data: Any, info: ValidationInfo) -> Any:
        """Ledgers store `_STORED_SCHEME`, which users may no longer write."""
        if info.context != STORED or not isinstance(data, dict) or data.get("scheme") != _STORED_SCHEME:
            return data
        return {key: value for key, value in data.items() if key != "scheme"}

    @model_validator(mode="after")
    def _consistent(self) -> "InstructionSampling":
        check_known("sampling.kernels", sorted(self.kernels), (*INJECTABLE, *DETECTORS))
        check_distinct("sampling.kernels", self.kernels)
        return self


class RegisterSampling(Config):
    """Faults in registers of a live process (hosts node and firmware)."""

    null_runs: ClassVar[int] = NULL_RUNS
    level: Literal["register"]
    registers: tuple[Literal["general", "fp", "all"], ...] = Field(
        ("general", "fp"), min_length=1, description="kinds of registers; `faults` for each"
    )
    access: str = Field("either", description="a register that an instruction reads, or one that it has written")
    symbol: str = Field("", description="stop at the next call of this function; a part of its name that no other has")
    walk: int = Field(64, ge=1, le=LONGEST_WALK, description="instructions from the stop to the injection, at most")

    @model_validator(mode="after")
    def _consistent(self) -> "RegisterSampling":
        check_known("sampling.access", [self.access], ACCESSES)
        check_distinct("sampling.registers", self.registers)
        return self


def _level_of(data: Any) -> str:
    return str(data.get("level", "state") if isinstance(data, Mapping) else getattr(data, "level", "state"))


Sampling = Annotated[
    Annotated[StateSampling, Tag("state")]
    | Annotated[MemorySampling, Tag("memory")]
    | Annotated[InstructionSampling, Tag("instruction")]
    | Annotated[RegisterSampling, Tag("register")]
    | Annotated[MessageSampling, Tag("message")]
    | Annotated[SensorSampling, Tag("sensor")],
    Discriminator(_level_of),
]
"""How faults are drawn; `level` selects the model."""


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
        if not isinstance(data, dict):
            return data
        inline = {key: data[key] for key in data if key in MissionSpec.model_fields}
        rest = {key: value for key, value in data.items() if key not in inline}
        mission = rest.get("mission", {})
        if not isinstance(mission, dict):
            return data  # rejected by validation
        return {**rest, "mission": _mission_keys({**mission, **inline}, "arms", info)}


class Part(Config):
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
    `missions`.
    """

    name: Name
    host: str = Field(
        "local",
        description="where missions are flown: local, ros1, node, firmware, airsim_program, or another entry point",
    )
    environments: tuple[str, ...] = Field(min_length=1)
    first_seed: int = Field(10_000, ge=0)
    missions: int = Field(30, ge=1, description="per environment")
    faults: int = Field(30, ge=1, le=MOST_FAULTS, description="per environment and target")
    scales: dict[str, Scale] = Field(default_factory=dict, description="other sizes, by name")
    mission: dict[str, Any] = Field(default_factory=dict, description="keys of a mission, for all arms")
    sampling: Sampling = Field(default_factory=StateSampling)
    monitored_set: str = Field("paper-13", description="fields that count as monitored, in tables and sampling")
    null_runs: int | None = Field(
        None, ge=0, le=MOST_FAULTS, description="per environment; each arm in turn; default 3 for states"
    )
    arms: dict[str, ArmConfig] = Field(default_factory=dict, description="by name")
    parts: dict[str, Part] = Field(default_factory=dict, description="by name in environments, e.g. one per platform")
    node: NodeConfig | None = Field(None, description="the node under test, with host node")
    program: ProgramConfig | None = Field(None, description="the program under test, with host airsim_program")

    @model_validator(mode="before")
    @classmethod
    def _renamed(cls, data: Any, info: ValidationInfo) -> Any:
        if isinstance(data, dict):
            if data.get("until_halfwidth", "") is None:  # the default of earlier versions, in their ledgers
                data = {key: value for key, value in data.items() if key != "until_halfwidth"}
            if data.get("host") == "node" and isinstance(data.get("node"), dict):
                data = {"environments": [str(data["node"].get("name", "")).strip("/")], "missions": 1, **data}
            for key in data:
                if key in _RENAMED and key not in cls.model_fields:
                    raise ValueError(f"key {key!r}: is now {_RENAMED[key]!r} (docs/generated/campaign-keys.md)")
            if isinstance(data.get("mission"), dict):
                data = {**data, "mission": _mission_keys(data["mission"], "mission", info)}
        return data

    @model_validator(mode="after")
    def _consistent(self) -> "Campaign":
        missions = max([self.missions, *(scale.missions or 0 for scale in self.scales.values())])
        if self.first_seed + missions > TRAINING_SEED:
            raise ValueError(
                f"first_seed: {self.first_seed}, missions: {missions}: seeds from {TRAINING_SEED} on are for training"
            )
        check_known("monitored_set", [self.monitored_set], MONITORED_SETS)
        for place, key in _UNDER_TEST.items():
            if (self.host == place) != (getattr(self, key) is not None):
                raise ValueError(f"host: {self.host!r}: the key {key} goes with host {place}, and only with it")
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
        from mavfi.campaign.samplers import sampler_for  # samplers read this model

        try:
            sampler_for(self)
        except BadInputError as error:
            raise ValueError(str(error)) from None
        return self

    def at_scale(self, name: str) -> "Campaign":
        """The campaign at a scale; "quick" is the size given by its top-level keys.

        Raises:
            BadInputError: The scale is not defined.
        """
        if name == "quick":
            return self
        if name not in self.scales:
            allowed = ", ".join(["quick", *self.scales])
            raise BadInputError(f"campaign {self.name}: scale {name!r}: not known; allowed: {allowed}")
        return self.resized(self.scales[name])

    def resized(self, size: Scale) -> "Campaign":
        """The campaign with the missions and faults of a scale."""
        return self.model_copy(update=size.model_dump(exclude_none=True))

    @property
    def seeds(self) -> range:
        """Mission seeds, the same in each environment."""
        return range(self.first_seed, self.first_seed + self.missions)

    @property
    def total_missions(self) -> int:
        """Number of missions over all environments."""
        return len(self.environments) * self.missions

    @property
    def under_test(self) -> dict[str, Any]:
        """Arguments of the host by key: the object under test."""
        return {key: value for key in _UNDER_TEST.values() if (value := getattr(self, key)) is not None}

    @property
    def nulls(self) -> int:
        """Number of null runs per environment."""
        return self.sampling.null_runs if self.null_runs is None else self.null_runs

    @property
    def on_design_seeds(self) -> bool:
        """Whether any mission seed was used for tuning the autopilot profiles; such results are not published."""
        return self.first_seed < DESIGN_SEEDS.stop

    def environment_of(self, name: str) -> str:
        """The environment of a part, by its name; without parts, the name itself."""
        return self.parts[name].environment if name in self.parts else name

    def spec(self, environment: str, seed: int, overrides: Mapping[str, Any] | None = None) -> MissionSpec:
        """The mission for an environment and seed, with the overrides of an arm."""
        part = self.parts.get(environment, Part(environment=environment)).model_dump(exclude_none=True)
        given = {**self.mission, **(overrides or {}), **part, "seed": seed}
        return parse(MissionSpec, given, f"campaign {self.name}")

    def to_json(self) -> dict[str, Any]:
        """Plain data; unset keys of later versions are omitted, so that older campaigns keep their identity."""
        data = self.model_dump(mode="json")
        for arm in data["arms"].values():
            if not arm["options"]:
                del arm["options"]
        if not self.parts:
            del data["parts"]
        if self.program is None:
            del data["program"]
        sampling = data["sampling"]
        if sampling.get("lifetime") == Lifetime().model_dump(mode="json"):
            del sampling["lifetime"]
        if not sampling.get("messages", True):
            del sampling["messages"]
        for group in sampling.get("groups", ()):
            if group.get("lifetime") is None:
                group.pop("lifetime", None)
        return data

    def identity(self) -> dict[str, Any]:
        """Plain data in the identity of a ledger; it keeps the key `scheme` of faults in instructions."""
        data = self.to_json()
        if self.sampling.level == "instruction":
            data["sampling"]["scheme"] = _STORED_SCHEME
        return data


def _mission_keys(given: Mapping[str, Any], where: str, info: ValidationInfo) -> dict[str, Any]:
    """Validate keys and values of a mission in a campaign of the user, or in one that a ledger stores."""
    for key in ("environment", "seed"):
        if key in given:
            raise ValueError(f"{where}.{key}: belongs to the campaign (environments, first_seed)")
    try:
        parsed = parse(MissionSpec, dict(given), where, stored=info.context == STORED)
    except BadInputError as error:
        raise ValueError(str(error)) from None
    return parsed.model_dump(mode="json", include=parsed.model_fields_set)


def load_campaign(name: str | Path) -> Campaign:
    """Read a campaign from a path, or a shipped one by name, e.g. "table1".

    Raises:
        BadInputError: The file does not exist or is invalid.
    """
    return shipped("campaigns", Campaign, str(name))
