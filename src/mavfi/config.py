"""Configuration: YAML files become frozen, validated models; an unknown key is an error that names file and key."""

import math
import re
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import yaml
from pydantic import (
    AfterValidator,
    AliasChoices,
    BaseModel,
    ConfigDict,
    Field,
    TypeAdapter,
    ValidationError,
    ValidationInfo,
    field_validator,
)

from mavfi.dropped import dropped_name
from mavfi.errors import BadInputError, allowed, not_known
from mavfi.files import LARGEST_TEXT, is_dir, is_file, read_file
from mavfi.wording import finding, refuse_other_kind, shown

Vector = tuple[float, float, float]
_Part = Annotated[float, Field(ge=0, le=1e6)]
NotNegative = tuple[_Part, _Part, _Part]
Gain = Annotated[float, Field(ge=-1e3, le=1e3)]
Gains = tuple[Gain, Gain, Gain]
STRONGEST_WIND = 30.0
"""Largest gust and mean wind (m/s)."""
SCAN_ENDINGS = (".bt", ".ot")
"""File name extensions of scanned maps, which are environments."""
STORED = {"stored": True}
"""Pydantic's context of data that mavfi itself has stored."""
_FOLDER = re.compile(r"\w[\w.-]*")


def _plain(name: str, info: ValidationInfo) -> str:
    """The name, which cannot lead out of a folder; a ledger keeps the name under which it was flown."""
    if info.context != STORED and not _FOLDER.fullmatch(name):
        raise ValueError(f"{name!r}: allowed: a plain folder name, of letters, digits, _, . and -, not . or - first")
    return name


Name = Annotated[str, AfterValidator(_plain)]
"""Name of a file or folder."""


class Config(BaseModel):
    """Base of all configuration: frozen, strict about keys; true and false are no numbers."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    @field_validator("*", mode="before")
    @classmethod
    def _of_its_kind(cls, value: object, info: ValidationInfo) -> object:
        refuse_other_kind(cls.model_fields[str(info.field_name)].annotation, value)
        return value


ConfigType = TypeVar("ConfigType", bound=Config)
Checked = TypeVar("Checked")


class _Loader(getattr(yaml, "CSafeLoader", yaml.SafeLoader)):  # type: ignore[misc]
    """Reads plain data; compiled if available, since every mission of a campaign reads its configuration."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        """Keys and values; duplicate keys are an error."""
        seen = set()
        for key, _ in node.value:
            if not isinstance(key, yaml.ScalarNode):
                continue  # a list or mapping as a key is refused below
            if key.value in seen:
                raise yaml.YAMLError(f"key {key.value!r} twice, again in line {key.start_mark.line + 1}")
            seen.add(key.value)
        mapping: dict[Any, Any] = super().construct_mapping(node, deep)
        return mapping

    def get_single_data(self) -> Any:
        """The document; an error if its aliases make it too large or endless."""
        node = self.get_single_node()
        if node is None:
            return None
        if _size(node, {}) > _MOST_NODES:
            raise yaml.YAMLError(f"aliases make more than {_MOST_NODES:,} values of it")
        return self.construct_document(node)


def _integer(loader: _Loader, node: yaml.ScalarNode) -> int:
    """An integer; rejects integers much larger than any float, which Python cannot print."""
    value: int = loader.construct_yaml_int(node)
    if value.bit_length() > _MOST_BITS:
        raise yaml.YAMLError(f"integer of {value.bit_length()} bits in line {node.start_mark.line + 1}")
    return value


_Loader.add_constructor("tag:yaml.org,2002:int", _integer)


def _size(node: yaml.Node, known: dict[int, float]) -> float:
    """Number of values in a node with aliases expanded; infinite if it contains itself."""
    if isinstance(node, yaml.ScalarNode):
        return 1
    if id(node) not in known:
        known[id(node)] = math.inf
        if isinstance(node, yaml.SequenceNode):
            parts = node.value
        else:
            parts = [part for pair in node.value for part in pair]
        known[id(node)] = 1 + sum(_size(part, known) for part in parts)
    return known[id(node)]


class VehicleConfig(Config):
    """Airframe, rotors and the gains of its flight controller (reference values and sources: docs/reference/models.md).

    The inner loop is a cascade: velocity -> attitude -> rate.  Contact of the sphere `collision_radius` is a collision.
    """

    name: str
    mass: float = Field(gt=0, le=1e4, description="kg")
    inertia: Vector = Field(description="kg m^2, principal, body frame")
    arm_length: float = Field(gt=0, le=100, description="m, rotor axis to centre")
    collision_radius: float = Field(
        gt=0,
        le=5,
        validation_alias=AliasChoices("collision_radius", "hull_radius"),
        serialization_alias="hull_radius",
        description="m, of the sphere that counts as the vehicle",
    )
    max_rotor_thrust: float = Field(gt=0, le=1e6, description="N, one rotor")
    rotor_torque_ratio: float = Field(gt=0, le=100, description="m, torque / thrust")
    rotor_time_constant: float = Field(ge=0, le=10, description="s")
    drag: NotNegative = Field(description="N s^2/m^2 along body x, y, z: force = -drag v|v|")
    velocity_gain: float = Field(2.5, gt=0, le=1e3, description="1/s")
    attitude_gain: float = Field(8.0, gt=0, le=1e4, description="1/s")
    rate_gain: NotNegative = Field((18.0, 18.0, 6.0), description="1/s, body rates")
    vertical_integral_gain: float = Field(0.3, ge=0, le=1e3, description="1/s^2; there is no x/y integrator")
    max_tilt: float = Field(0.5712, gt=0, le=1.5, description="rad")
    max_acceleration: float = Field(6.0, gt=0, le=1e3, description="m/s^2, horizontal")
    max_yaw_rate: float = Field(2.0, gt=0, le=100, description="rad/s")
    setpoint_limit: float = Field(1.33, gt=1, le=100, description="largest accepted velocity set-point / v_max")
    mjcf: str | None = Field(None, description="MJCF file of the body; its mass and inertia are flown")

    @field_validator("inertia")
    @classmethod
    def _of_a_rigid_body(cls, inertia: Vector) -> Vector:
        low, middle, high = sorted(inertia)
        if not (low > 0 and high <= low + middle):
            raise ValueError(f"{inertia}: allowed: above 0, and none larger than the other two together")
        return inertia


class CameraConfig(Config):
    """Forward-looking depth camera."""

    width: int = Field(64, ge=2, le=4096, description="pixels")
    height: int = Field(48, ge=2, le=4096, description="pixels")
    field_of_view: float = Field(1.5707963267948966, gt=0, lt=3.1, description="rad, horizontal")
    range: float = Field(20.0, gt=0, le=1e3, description="m")
    period_us: int = Field(100_000, gt=0, description="shortest time between two images")
    noise: float = Field(0.0, ge=0, description="standard deviation / range")


class WindConfig(Config):
    """Wind: a constant mean, and gusts separated by calm; none by default."""

    gust: float = Field(0.0, ge=0, le=STRONGEST_WIND, description="m/s, amplitude of every gust; 0 = none")
    mean: Vector = Field((0.0, 0.0, 0.0), description="m/s, world frame")
    interval: float = Field(5.0, gt=0, description="s, mean calm between two gusts")
    length: float = Field(4.0, gt=0, description="s, mean duration of a gust; each lasts 0.5 to 1.5 of it")

    @field_validator("mean")
    @classmethod
    def _not_too_strong(cls, mean: Vector) -> Vector:
        if not math.hypot(*mean) <= STRONGEST_WIND:
            raise ValueError(f"{mean}: must not be stronger than {STRONGEST_WIND:g} m/s")
        return mean


class LocalizationConfig(Config):
    """Source of the vehicle's position in the pipeline: the true state, or an estimator with noisy sensors.

    The IMU is sampled at every physics step (250 Hz).
    """

    kind: Literal["truth", "estimator"] = "truth"
    imu_noise: float = Field(1.0, ge=0, description="noise of the IMU / AirSim's figures")
    position_period_us: int = Field(100_000, gt=0, description="between two fixes of position and heading")
    position_noise: float = Field(0.05, ge=0, description="m, standard deviation per axis")
    heading_noise: float = Field(0.025, ge=0, description="rad, standard deviation")


class MapConfig(Config):
    """OctoMap's update rule (Hornung et al. 2013) and its parameters."""

    kind: str = Field("dense", description="dense, octree, entry point of the group mavfi.maps, or package:Class")
    resolution: float = Field(0.5, gt=0, description="m")
    hit: float = Field(0.7, gt=0.5, lt=1)
    miss: float = Field(0.4, gt=0, lt=0.5)
    clamp_min: float = Field(0.12, gt=0, lt=0.5)
    clamp_max: float = Field(0.97, gt=0.5, lt=1)


class PlannerConfig(Config):
    """Sampling planner and path improvement.  Settings for each shipped planner are in configs/planners."""

    name: str = "rrt_connect"
    range: float = Field(4.0, gt=0, le=1e3, description="m, longest extension; of RRT* the largest near set, too")
    goal_bias: float = Field(0.05, ge=0, le=1, description="probability of drawing the goal; not used by RRT-Connect")
    iterations: int = Field(4000, gt=0, le=100_000, description="per run")
    restarts: int = Field(
        6, gt=0, le=100, description="runs, of which the shortest path is kept; RRT*: most budgets of its one run"
    )
    shortcuts: int = Field(80, ge=0, le=100_000, description="random shortcuts after the greedy ones")


class PlatformConfig(Config):
    """A computer: latency of each kernel in simulated time (modelled, not measured on that hardware)."""

    name: Name
    latency_us: dict[str, Annotated[int, Field(ge=0, le=60_000_000)]] = Field(description="by kernel")
    tracker_slowdown: float = Field(1.0, ge=1, le=1e3, description="control loop time / reference time it advances")
    time_limit_factor: float = Field(1.0, ge=1, le=1e3)


class AutopilotConfig(Config):
    """The rules of one autopilot profile.  Two are shipped: the paper's, and one of current good practice."""

    name: Name
    sampling: Literal["held", "interpolated"] = Field(description="trajectory points: every 0.5 s and held, or dense")
    point_period: float = Field(ge=1e-3, le=10, description="s between trajectory points")
    look_ahead: float = Field(ge=0, le=60, description="s, velocity reference")
    gain_p: Gains = Field(description="1/s")
    gain_i: Gains = (0.0, 0.0, 0.0)
    gain_d: Gains = (0.0, 0.0, 0.0)
    integral_limit: float = Field(1.0, ge=0, le=1e3, description="m s")
    velocity_feed_forward: Gain = 1.0
    acceleration_feed_forward: Gain = 0.0
    command_limit: float = Field(gt=0, le=100, description="largest command / v_max")
    slowdown_cap: float = Field(ge=1, le=1e3, description="largest slow-down of reference time on saturation; 1 = none")
    plan_radius: float = Field(gt=0, le=10, description="m, for a collision radius of 0.35 m; grows with it")
    check_radius: float = Field(gt=0, le=10, description="m, for a collision radius of 0.35 m; grows with it")
    distance: Literal["centres", "boxes"] = Field(description="between which points of voxels a radius is measured")
    replanning: Literal["event", "every_map"]
    smoothing: Literal["blends", "minimum_snap"] = Field(
        "blends", description="rounded corners with a speed profile, or polynomials of degree 7"
    )
    searches: int = Field(
        1, gt=0, le=1000, description="searches per plan, of which the quickest path is flown; every_map only"
    )
    grace: float = Field(ge=0, le=1e6, description="s")
    known_space_limit: bool = Field(description="clock governed by known free space")
    geofence: bool = Field(description="outside of the mapped volume counts as blocked in the check")
    deviation_limit: float = Field(ge=0, le=1e6, description="m from the reference that stops and replans; 0 = off")
    progress_timeout: float = Field(ge=0, le=1e6, description="s without progress that stop and replan; 0 = off")
    consumer_check: bool = Field(description="trajectories are checked for sanity before they are adopted")
    epoch_liveness: float = Field(
        ge=0, le=1e6, description="s after which a rejected sequence number is forgotten; 0 = off"
    )
    alarm: Literal["one_shot", "repeated"] = Field(
        "one_shot",
        description="of the collision check: published once, or at each scan until it is answered; event only",
    )
    max_failed_plans: int = Field(40, gt=0, le=1_000_000)


class EnvironmentConfig(Config):
    """A family of worlds, or a scanned map."""

    name: str
    generator: str = Field(description="entry point of the group mavfi.environments")
    parameters: dict[str, Any] = Field(default_factory=dict)
    vehicle: str = "airsim_quad"
    v_max: float | None = Field(None, ge=0.1, le=20, description="m/s, default of this environment")
    map_resolution: float | None = Field(None, ge=0.02, le=5, description="m, voxel edge")
    camera_range: float | None = Field(None, gt=0, le=1e3, description="m")


_OPENINGS = ("[", "{", "- ", "? ")
_MOST_OPENINGS = 10_000
"""The compiled parser is recursive, and crashes at a nesting depth of some 50,000."""
_MOST_NODES = 100_000
_MOST_BITS = 1024


def config_root() -> Path:
    """Folder of the shipped configuration files."""
    package = Path(__file__).parent
    inside = package / "configs"
    if inside.is_dir():
        return inside
    return package.parents[1] / "configs"


def read_yaml(path: Path) -> dict[str, Any]:
    """The mapping in a YAML file.

    Raises:
        BadInputError: The file is absent, not YAML, or not a mapping.
    """
    try:
        text = read_file(path, LARGEST_TEXT).decode()
        if sum(map(text.count, _OPENINGS)) > _MOST_OPENINGS:
            raise BadInputError(f"{path}: is too long; allowed: {_MOST_OPENINGS:,} lists and mappings")
        data = yaml.load(text, _Loader)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        where = ""
        if mark:
            where = f":{mark.line + 1}:{mark.column + 1}"
        raise BadInputError(f"{path}{where}: not a YAML file ({error.problem or _first_line(error)})") from None
    except RecursionError:
        raise BadInputError(f"{path}: not a YAML file (too many lists and mappings within each other)") from None
    except (yaml.YAMLError, LookupError, TypeError, ValueError) as error:  # includes tags that do not fit their value
        raise BadInputError(f"{path}: not a YAML file ({_first_line(error)})") from None
    if not isinstance(data, dict):
        held = "is empty" if data is None else f"holds {shown(data)}"
        raise BadInputError(f"{path}: {held}; allowed: keys with values")
    return data


def _first_line(error: Exception) -> str:
    return next(iter(str(error).splitlines()), type(error).__name__)


def parse(model: type[ConfigType], data: dict[str, Any], source: str, *, stored: bool = False) -> ConfigType:
    """Validate data from a source (named in messages) as a model.

    In data that mavfi itself has `stored`, older names of keys and folders are allowed.

    Raises:
        BadInputError: One line that names source, key, value and what is allowed.
    """
    context = None
    if stored:
        context = STORED
    try:
        return model.model_validate(data, context=context)
    except ValidationError as error:
        raise BadInputError(f"{source}: {finding(error, model)}") from None


def parse_part(model: type[ConfigType], data: object, key: str, context: Any) -> ConfigType:
    """Validate the part of a file under a key, in a validator of the whole; a ValueError names key and value."""
    try:
        return model.model_validate(data, context=context)
    except ValidationError as error:
        raise ValueError(finding(error, model, key)) from None


def checked(kind: type[Checked], data: object, source: str) -> Checked:
    """Validate data from a source (named in messages) as a dataclass.

    Raises:
        BadInputError: One line that names source, key, value and what is allowed.
    """
    try:
        instance: Checked = _adapter(kind).validate_python(data)  # type: ignore[arg-type] # classes are hashable
    except ValidationError as error:
        raise BadInputError(f"{source}: {finding(error)}") from None
    return instance


@cache
def _adapter(kind: Any) -> TypeAdapter[Any]:  # noqa: ANN401 - a dataclass
    return TypeAdapter(kind)


def load(model: type[ConfigType], path: Path) -> ConfigType:
    """Read a YAML file as a model.

    Raises:
        BadInputError: See `read_yaml` and `parse`.
    """
    return parse(model, read_yaml(path), str(path))


_SINGULARS = {"studies": "study", "redundancy": "vehicle"}
"""What a file is, by the folder of its kind, where that is not the folder without its s."""


def shipped(kind: str, model: type[ConfigType], name: str, endings: Iterable[str] = ()) -> ConfigType:
    """A shipped configuration by its name in the folder `kind`, e.g. "autopilots", or a user's file by path.

    Args:
        kind: The folder.
        model: Its model.
        name: Name or path.
        endings: Other extensions of files that are allowed in its place, for the message.

    Raises:
        BadInputError: Unknown name or invalid file.
    """
    if name.endswith((".yaml", ".yml")):
        return load(model, Path(name))
    path = config_root() / kind / f"{name}.yaml"
    if is_file(path):
        return load(model, path)
    if dropped_name(kind, name):
        raise BadInputError(dropped_name(kind, name))

    # neither a name nor a file: what there is
    *others, last = dict.fromkeys([".yaml", *endings])
    files = last
    if others:
        files = " or ".join([", ".join(others), last])
    singular = _SINGULARS.get(kind, kind.removesuffix("s"))
    also = f"or a path to a {files} file"
    if is_dir(Path(name)):
        raise BadInputError(f"{singular} {name!r}: is a folder; allowed: {allowed(names(kind), name)}, {also}")
    raise BadInputError(f"{singular} {not_known(name, names(kind), also)}")


def names(kind: str) -> list[str]:
    """Names of the shipped configurations of a kind."""
    return sorted(path.stem for path in (config_root() / kind).glob("*.yaml"))
