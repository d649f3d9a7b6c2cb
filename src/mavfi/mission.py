"""A mission: the user's request (`MissionSpec`), and everything that determines its golden run (`Scenario`)."""

import hashlib
import json
from enum import Enum
from typing import Any, Literal

from pydantic import (
    AliasChoices,
    ConfigDict,
    Field,
    SerializeAsAny,
    ValidationInfo,
    field_validator,
    model_validator,
)

from mavfi.config import (
    STORED,
    STRONGEST_WIND,
    AutopilotConfig,
    CameraConfig,
    Config,
    EnvironmentConfig,
    LocalizationConfig,
    MapConfig,
    PlannerConfig,
    PlatformConfig,
    Vector,
    VehicleConfig,
    WindConfig,
    names,
)
from mavfi.errors import BadInputError
from mavfi.rewriting import rewriter

ARRIVAL_RADIUS = 2.0
"""Distance from the goal that counts as arrival, unless a mission has another one (m)."""
FLY_AWAY_MARGIN = 30.0
"""Distance outside the arena that ends a flight (m)."""
LARGEST_SEED = 2**63 - 1
"""Seeds are stored as 64-bit integers."""
TIME_LIMIT_FACTOR = 4.5
"""Time limit / (course / v_max), unless a mission has another one."""

DeadNode = Literal["end", "fresh", "readback"]
"""Restart policy of a node that dies, see `flight.restarts`."""
DetectorPlace = Literal["consumer", "producer", "published"]
"""Where a detector checks a value relative to a fault on the way, see `flight.taps`."""


class MissionStatus(Enum):
    """How a flight ended; the value is a sentence for people."""

    SUCCESS = "Reached the goal."
    COLLISION = "Touched an obstacle or the ground."
    FLY_AWAY = "Left the arena."
    TIMEOUT = "Did not reach the goal in time."
    NO_PATH = "Found no path to the goal."
    INVALID_STATE = "The state of the vehicle is not finite."
    NODE_DIED = "A node of the pipeline died."

    @property
    def label(self) -> str:
        """Lower-case name, as in columns and JSON."""
        return self.name.lower()

    @property
    def words(self) -> str:
        """The name in words, as in sentences and pictures."""
        return self.label.replace("_", " ")


def _names(kind: str) -> str:
    """Shipped names of a kind, for a description."""
    return ", ".join(names(kind))


class MissionSpec(Config):
    """The user's request: every option of a mission, by name.  `flight.compose.resolve` turns it into a `Scenario`.

    The command line, campaign files, arms of campaigns, training, ROS and the Python API all read this model, so each
    option is defined once and available everywhere.  The description of a field is its help text.
    """

    model_config = ConfigDict(populate_by_name=True)

    environment: str = Field(
        "sparse",
        description=f"{_names('environments')}, or a file. A file is YAML, a scanned map (.bt, .ot of OctoMap), or a "
        "world of another simulator (.sdf, .xml, Aerialist's test case).",
    )
    seed: int = Field(0, ge=0, le=LARGEST_SEED, description="Source of all randomness of the mission.")
    start: Vector | None = Field(None, description="Start position, m. The environment's by default.")
    goal: Vector | None = Field(None, description="Goal position, m. The environment's by default.")
    autopilot: str = Field("published", description="Profile: published, hardened, or a YAML file.")
    planner: str = Field("rrt_connect", description="rrt, rrt_connect, rrt_star, a YAML file, or package:Class.")
    platform: str = Field(
        "i9-9940x",
        description=f"Computer: {_names('platforms')}, or a YAML file. Its latencies are charged to the kernels.",
    )
    map: str = Field("dense", description="Store of log-odds: dense, octree, or package:Class.")
    map_resolution: float | None = Field(
        None, ge=0.02, le=5.0, description="Voxel edge, m. The environment's by default."
    )
    unknown_space: Literal["solid", "free"] = Field(
        "solid", description="Unknown space of a scanned map: solid, free. Free suits maps that hold obstacles only."
    )
    camera_range: float | None = Field(
        None, ge=1.0, le=1e3, description="Range of the depth camera, m. The environment's by default."
    )
    vehicle: str | None = Field(
        None,
        description=f"{_names('vehicles')}, or a file. A file is YAML, or a model of another simulator (.sdf, .urdf, "
        ".xacro, PX4's airframe); the environment's vehicle by default.",
    )
    trajectory: str = Field("", description="Custom trajectory generator, package:Class. mavfi's by default.")
    waypoint: str = Field("", description="Custom setpoint generator, package:Class. mavfi's by default.")
    pid: str = Field("", description="Custom tracker, package:Class. From way-point to velocity; mavfi's by default.")
    flight_controller: str = Field(
        "cascade",
        description="cascade, betaflight, or package:Class. From velocity to rotor commands; also an entry point.",
    )
    v_max: float | None = Field(None, ge=0.1, le=20.0, description="Speed limit, m/s. The environment's by default.")
    arrival_radius: float = Field(
        ARRIVAL_RADIUS, ge=0.5, le=20.0, description="Distance to the goal that is an arrival, m."
    )
    time_limit_factor: float = Field(
        TIME_LIMIT_FACTOR,
        ge=1.0,
        le=100.0,
        description="Time limit / (course / v_max). On a slow computer multiplied by the platform's factor.",
    )
    latency_jitter: float = Field(
        0.0,
        ge=0.0,
        le=4.0,
        description="Spread of latencies. Each is multiplied by a factor drawn from 1 / (1 + jitter) to 1 + jitter.",
    )
    planner_latency: float | None = Field(
        None,
        ge=0.0,
        le=60.0,
        description="Flight time that a path takes the planner, s. Default: that of the platform.",
    )
    depth_noise: float = Field(
        0.0, ge=0.0, le=1.0, description="Noise of the depth camera / range. One standard deviation."
    )
    wind: float = Field(0.0, ge=0.0, le=STRONGEST_WIND, description="Amplitude of gusts, m/s.")
    localization: Literal["truth", "estimator"] = Field(
        "truth", description="truth, or estimator. The latter fuses IMU and position fixes."
    )
    coupling: Literal["inline", "observer"] = Field(
        "inline",
        description="inline (before a value is seen), or observer (late). An observer judges one step late.",
    )
    detector_place: DetectorPlace = Field(
        "consumer",
        description="Where values are checked: consumer, producer, published. At the consumer, after a fault on the "
        "way; at the producer, which never sees that fault (values of sensors at the consumer); or published, as in "
        "the authors' code: commands at the producer, others at the consumer.",
    )
    grain: Literal["stage", "kernel", "message"] = Field(
        "stage",
        description="Repeated after an alarm: stage, kernel, message. The whole stage, only the kernel that wrote the "
        "value, or its message: the producer's copy is sent again, also if the message is unreadable; if that is no "
        "better the kernel runs again.",
    )
    same_twice: Literal["accept", "escalate", "limit"] = Field(
        "accept",
        description="If a repetition alarms again: accept, escalate, limit. Accept it; escalate to a restart of the "
        "node (inline); or limit: accept, and recompute without a change at most 5 times in 10 s, the default of a "
        "custom detector.",
    )
    answer_s: float = Field(
        0.0, ge=0.0, le=60.0, description="Time for a path to answer an alarm, s. Then the planner restarts; 0 = never."
    )
    degraded: Literal["none", "hold"] = Field(
        "none", description="If restarts do not help: none (fly on), or hold. Hold keeps the position."
    )
    trained_for: str = Field(
        "",
        pattern=r"^([^/\s]+/[^/\s]+)?$",
        description="AUTOPILOT/PLATFORM whose trained model is used. On whatever mission; by default the mission's "
        "own, which must fit its planner and speed limit, too.",
    )
    dead_node: DeadNode = Field(
        "fresh",
        description="If a node dies: end (the mission), fresh, readback. Fresh restarts it without memory; readback "
        "restarts it, gives it an unanswered alarm again, and lets it read its last outputs back.",
    )
    protection: str = Field("", description="Plan of protected kernels: a name, or a YAML file. None by default.")
    alarm: Literal["one_shot", "repeated"] | None = Field(
        None,
        description="Alarm of the collision check: one_shot, repeated. Repeated until it is answered; the profile's "
        "by default.",
    )
    epoch_liveness: float | None = Field(
        None,
        ge=0,
        le=1e6,
        description="Time until a refused sequence number is accepted, s. 0 = never; the profile's by default.",
    )

    @model_validator(mode="before")
    @classmethod
    def _stored_spellings(cls, data: Any, info: ValidationInfo) -> Any:
        """Ledgers and flights of earlier versions have the key `stack`, and the policy `restart` for dead nodes."""
        if info.context != STORED or not isinstance(data, dict):
            return data
        renamed = dict(data)
        if "stack" in renamed:
            renamed["autopilot"] = renamed.pop("stack")
        if renamed.get("dead_node") == "restart":
            renamed["dead_node"] = "fresh"
        return renamed

    def to_json(self) -> dict[str, Any]:
        """Plain data; keys of later versions are omitted at their defaults, so that what is stored keeps its key."""
        data = self.model_dump(mode="json")
        for name in _LATER_KEYS:
            if getattr(self, name) == MissionSpec.model_fields[name].default:
                del data[name]
        return data


RECOVERY = ("coupling", "grain", "same_twice", "answer_s", "degraded", "detector_place")
"""Mission keys that define the recovery from a detector's alarms."""
OF_A_DETECTOR = (*RECOVERY, "trained_for")
"""Mission keys without effect on a flight without a detector."""
_LATER_KEYS = (
    "trajectory",
    "waypoint",
    "pid",
    "arrival_radius",
    "time_limit_factor",
    "latency_jitter",
    "planner_latency",
    "detector_place",
    "unknown_space",
)
"""Keys of a mission that its plain data omit at their defaults."""
_OPTIONS = (
    "wind",
    "localization",
    "dead_node",
    "flight_controller",
    "kernels",
    "protection",
    "arrival_radius",
    "time_limit_factor",
    "latency_jitter",
)
"""Attributes of a `Scenario` that its plain data omit at their defaults."""
_AUTOPILOT_OPTIONS = ("alarm",)
"""Attributes of its autopilot that its plain data omit at their defaults."""


class Scenario(Config):
    """Everything that determines a golden run; a flight is a pure function of it (and of a fault and a detector)."""

    environment: EnvironmentConfig
    seed: int
    autopilot: AutopilotConfig = Field(validation_alias=AliasChoices("autopilot", "stack"), serialization_alias="stack")
    vehicle: VehicleConfig
    platform: PlatformConfig
    planner: PlannerConfig = PlannerConfig()
    camera: CameraConfig = CameraConfig()
    map: MapConfig = MapConfig()
    v_max: float = 3.0
    a_max: float = 5.0
    start: Vector | None = None
    goal: Vector | None = None
    wind: WindConfig = WindConfig()
    localization: LocalizationConfig = LocalizationConfig()
    dead_node: DeadNode = "fresh"
    flight_controller: str = "cascade"
    kernels: dict[str, str] = {}
    protection: SerializeAsAny[Config] | None = None
    arrival_radius: float = ARRIVAL_RADIUS
    time_limit_factor: float = TIME_LIMIT_FACTOR
    latency_jitter: float = 0.0

    @field_validator("protection", mode="before")
    @classmethod
    def _stored_plan(cls, value: Any, info: ValidationInfo) -> Any:
        """The extra that owns the key reads the plan."""
        if not isinstance(value, dict):
            return value
        try:
            return rewriter().read(value, stored=info.context == STORED)
        except BadInputError as error:
            raise ValueError(str(error)) from None

    def to_json(self) -> dict[str, Any]:
        """Plain data; options at their defaults are omitted, so that a mission without them keeps its key.

        For the same reason `autopilot` and `collision_radius` keep their older names in it: `stack`, `hull_radius`.
        """
        data = self.model_dump(mode="json", by_alias=True)
        for name in _OPTIONS:
            if getattr(self, name) == Scenario.model_fields[name].default:
                del data[name]
        for name in _AUTOPILOT_OPTIONS:
            if getattr(self.autopilot, name) == AutopilotConfig.model_fields[name].default:
                del data["stack"][name]
        return data

    def key(self) -> str:
        """Hash that identifies the scenario."""
        return hashlib.sha256(json.dumps(self.to_json(), sort_keys=True).encode()).hexdigest()


def time_limit(course: float, v_max: float, platform: PlatformConfig, factor: float = TIME_LIMIT_FACTOR) -> float:
    """Time limit of the flight (s), for a straight course (m), a speed limit (m/s), a computer, and a factor."""
    return factor * course / v_max * platform.time_limit_factor
