"""Resolution of names into a scenario, and of a scenario into the inputs of simulator and pipeline."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from mavfi import config as configs
from mavfi.config import EnvironmentConfig, PlannerConfig, names, parse, shipped
from mavfi.errors import BadInputError
from mavfi.flight.compute import stage_latency
from mavfi.flight.loop import CONTROL_PERIOD_US
from mavfi.kernels.perception.state_estimation import Noise
from mavfi.mission import MissionSpec, Scenario
from mavfi.pipeline.functions import PLAIN, KernelFunctions
from mavfi.pipeline.kernel import PipelineConfig
from mavfi.pipeline.maps import find_map
from mavfi.pipeline.planners import find_search
from mavfi.rewriting import rewriter
from mavfi.sim import imu
from mavfi.sim.controller import find_controller
from mavfi.sim.environments import SCAN_ENDINGS, World, environment_for_file, find_generator
from mavfi.sim.mjcf import find_vehicle
from mavfi.states import INJECTED_KERNEL, PLANNERS, Stage

_DEFAULT_V_MAX = 3.0
_FILES = (".yaml", ".yml")
_NOMINAL_RADIUS = 0.35
"""Collision radius of the vehicle for which the radii of an autopilot profile are specified (m)."""
_LEAST_POSITION_NOISE, _LEAST_HEADING_NOISE = 1e-3, 1e-3
_RULES = ("alarm", "epoch_liveness")
"""Keys of an autopilot profile that a mission can override."""
_LIMITS = ("arena_lower", "arena_upper", "flight_lower", "flight_upper", "goal")


def find_environment(name: str) -> EnvironmentConfig:
    """Find an environment: a shipped name, a YAML file, or the path of a scanned map (.bt, .ot).

    Raises:
        BadInputError: The environment does not exist.
    """
    if name.lower().endswith(SCAN_ENDINGS):
        return environment_for_file(Path(name))
    return shipped("environments", EnvironmentConfig, name)


def find_planner(name: str) -> PlannerConfig:
    """Find a planner: a shipped name, a YAML file, or an entry point or "package:Class" with default parameters."""
    if name.endswith(_FILES) or name in names("planners"):
        return shipped("planners", PlannerConfig, name)
    return PlannerConfig(name=name)


def resolve(spec: MissionSpec) -> Scenario:
    """Resolve a spec to a scenario; unset options default to the environment's values, then to global defaults.

    Raises:
        BadInputError: A name is unknown, a value is out of range, or options are incompatible.
    """
    world = find_environment(spec.environment)
    if spec.vehicle is not None:
        world = world.model_copy(update={"vehicle": spec.vehicle})
    speed = spec.v_max if spec.v_max is not None else (world.v_max or _DEFAULT_V_MAX)
    if not 0.1 <= speed <= 20.0:
        raise BadInputError(f"v_max: {speed}: must lie between 0.1 and 20 m/s")
    camera = configs.CameraConfig(noise=spec.depth_noise)
    if world.camera_range is not None:
        camera = configs.CameraConfig(noise=spec.depth_noise, range=world.camera_range)
    resolution = spec.map_resolution if spec.map_resolution is not None else world.map_resolution
    protection = rewriter().load(spec.protection) if spec.protection else None
    planner = find_planner(spec.planner)
    with _read_from(spec.planner, "name"):
        find_search(planner.name)
    with _read_from(spec.environment, "generator"):
        find_generator(world.generator)
    with _read_from(spec.environment if spec.vehicle is None else "", "vehicle"):
        vehicle = find_vehicle(world.vehicle)
    return Scenario(
        environment=world, seed=spec.seed, autopilot=_autopilot(spec), vehicle=vehicle,
        platform=_platform(spec, protection),
        planner=planner, camera=camera, map=_map_config(spec.map, resolution),
        v_max=speed, start=spec.start, goal=spec.goal, wind=parse(configs.WindConfig, {"gust": spec.wind}, "wind"),
        localization=parse(configs.LocalizationConfig, {"kind": spec.localization}, "localization"),
        dead_node=spec.dead_node, flight_controller=_controller(spec.flight_controller), protection=protection,
    )  # fmt: skip


@contextmanager
def _read_from(source: str, key: str) -> Iterator[None]:
    """Name file and key in a BadInputError about a value that was read from a YAML file."""
    try:
        yield
    except BadInputError as error:
        if not source.endswith(_FILES):
            raise
        raise type(error)(f"{source}: key {key!r}: {error}") from None


def _platform(spec: MissionSpec, protection: configs.Config | None) -> configs.PlatformConfig:
    """The computer, on which a protected kernel takes as much longer as was measured."""
    platform = shipped("platforms", configs.PlatformConfig, spec.platform)
    if protection is None:
        return platform
    absent = set(PLANNERS) - {find_planner(spec.planner).name}
    present = {kernel: row for kernel, row in INJECTED_KERNEL.items() if kernel not in absent}
    times = {row: rewriter().time_of(protection, kernel) for kernel, row in present.items()}
    charged = {kernel: round(us * times.get(kernel, 1.0)) for kernel, us in platform.latency_us.items()}
    return platform.model_copy(update={"latency_us": charged})


def _controller(name: str) -> str:
    """The name, after checking that there is such a flight controller."""
    find_controller(name)
    return name


def _autopilot(spec: MissionSpec) -> configs.AutopilotConfig:
    """The autopilot profile with the mission's overrides."""
    own = {name: value for name in _RULES if (value := getattr(spec, name)) is not None}
    return shipped("autopilots", configs.AutopilotConfig, spec.autopilot).model_copy(update=own)


def _map_config(kind: str, resolution: float | None) -> configs.MapConfig:
    chosen = {"kind": kind} if resolution is None else {"kind": kind, "resolution": resolution}
    find_map(kind)
    return parse(configs.MapConfig, chosen, "map")


def pipeline_config(
    scenario: Scenario, world: World, directions: np.ndarray, rewindable: bool = False,
    functions: KernelFunctions = PLAIN,
) -> PipelineConfig:  # fmt: skip
    """The pipeline's configuration for a mission.

    Args:
        scenario: The mission.
        world: Its world: only limits and goal are passed on; the pipeline senses obstacles through the camera.
        directions: Ray direction of each pixel. Shape (n, 3).
        rewindable: Whether the flight can be restored to earlier instants.
        functions: Functions that the kernels call.
    """
    autopilot = scenario.autopilot
    growth = scenario.vehicle.collision_radius / _NOMINAL_RADIUS
    # copies: kernels would be compiled a second time for the world's read-only arrays
    limits = {name: getattr(world, name).copy() for name in _LIMITS}
    return PipelineConfig(
        autopilot=autopilot, planner=scenario.planner, map=scenario.map, camera=scenario.camera, directions=directions,
        **limits, seed=scenario.seed, v_max=scenario.v_max, a_max=scenario.a_max,
        plan_radius=autopilot.plan_radius * growth, check_radius=autopilot.check_radius * growth,
        control_period_us=CONTROL_PERIOD_US, tracker_slowdown=scenario.platform.tracker_slowdown,
        map_latency=1e-6 * stage_latency(scenario.platform, Stage.PERCEPTION),
        plan_latency=1e-6 * stage_latency(scenario.platform, Stage.PLANNING),
        velocity_lag=1.0 / scenario.vehicle.velocity_gain, noise=noise_of(scenario.localization), rewindable=rewindable,
        functions=functions,
    )  # fmt: skip


def noise_of(config: configs.LocalizationConfig) -> Noise | None:
    """Noise parameters of the estimator: the sensors' noise, bounded below by the resolution of its 4 ms steps."""
    if config.kind == "truth":
        return None
    scale = max(config.imu_noise, 1.0)
    return Noise(
        scale * imu.ACCELEROMETER_RANDOM_WALK, scale * imu.GYRO_RANDOM_WALK,
        scale * imu.ACCELEROMETER_BIAS_WALK, scale * imu.GYRO_BIAS_WALK,
        max(config.position_noise, _LEAST_POSITION_NOISE), max(config.heading_noise, _LEAST_HEADING_NOISE),
    )  # fmt: skip
