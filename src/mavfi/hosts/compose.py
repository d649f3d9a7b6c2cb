"""From names to a scenario, and from a scenario to what simulator and pipeline need."""

from pathlib import Path

import numpy as np

from mavfi.config import (
    CameraConfig,
    EnvironmentConfig,
    MapConfig,
    PlannerConfig,
    PlatformConfig,
    StackConfig,
    Vector,
    VehicleConfig,
    names,
    parse,
    shipped,
)
from mavfi.errors import BadInputError
from mavfi.mission import Scenario
from mavfi.pipeline.kernel import PipelineConfig
from mavfi.platforms.compute import stage_latency
from mavfi.sim.environments import SCAN_ENDINGS, World, environment_for_file
from mavfi.states import Stage

CONTROL_PERIOD_US = 20_000
DEFAULT_V_MAX = 3.0
NOMINAL_HULL = 0.35
"""Hull that the radii of a stack are meant for (m)."""


def find_environment(name: str) -> EnvironmentConfig:
    """A shipped environment by name, a user's YAML file, or a scanned map (.bt, .ot) by path.

    Raises:
        BadInputError: There is no such environment.
    """
    if name.lower().endswith(SCAN_ENDINGS):
        return environment_for_file(Path(name))
    return shipped("environments", EnvironmentConfig, name)


def find_planner(name: str) -> PlannerConfig:
    """A shipped planner by name, a user's YAML file, or an entry point or "package:Class" with the default figures.

    Raises:
        BadInputError: The file cannot be read. A planner that does not exist is found out when it is to be made.
    """
    if name.endswith((".yaml", ".yml")) or name in names("planners"):
        return shipped("planners", PlannerConfig, name)
    return PlannerConfig(name=name)


def make_scenario(  # noqa: PLR0913 (one keyword for each option of the command line)
    environment: str,
    seed: int,
    *,
    stack: str = "published",
    platform: str = "i9-9940x",
    planner: str = "rrt_connect",
    v_max: float | None = None,
    start: Vector | None = None,
    goal: Vector | None = None,
    depth_noise: float = 0.0,
    map_kind: str = "dense",
) -> Scenario:
    """A scenario from names; what is not given comes from the environment, then from the defaults.

    Args:
        environment: Name or path.
        seed: Mission seed.
        stack: "published", "hardened", or a path to a YAML file.
        platform: Name or path.
        planner: Name, path to a YAML file, entry point or "package:Class".
        v_max: m/s.
        start: World frame (m); None = the environment's.
        goal: Same.
        depth_noise: Standard deviation / range.
        map_kind: "dense" or "octree".

    Raises:
        BadInputError: Something is not known, or does not fit together.
    """
    if seed < 0:
        raise BadInputError(f"seed: {seed}: must be 0 or more")
    world = find_environment(environment)
    speed = v_max if v_max is not None else (world.v_max or DEFAULT_V_MAX)
    if not 0.1 <= speed <= 20.0:
        raise BadInputError(f"v_max: {speed}: must lie between 0.1 and 20 m/s")
    camera = CameraConfig(noise=depth_noise) if world.camera_range is None else CameraConfig(
        noise=depth_noise, range=world.camera_range
    )  # fmt: skip
    return Scenario(
        environment=world, seed=seed, stack=shipped("stacks", StackConfig, stack),
        vehicle=shipped("vehicles", VehicleConfig, world.vehicle),
        platform=shipped("platforms", PlatformConfig, platform), planner=find_planner(planner), camera=camera,
        map=_map_config(map_kind, world.map_resolution),
        v_max=speed, start=start, goal=goal,
    )  # fmt: skip


def _map_config(kind: str, resolution: float | None) -> MapConfig:
    chosen = {"kind": kind} if resolution is None else {"kind": kind, "resolution": resolution}
    return parse(MapConfig, chosen, "map")


def pipeline_config(scenario: Scenario, world: World, directions: np.ndarray) -> PipelineConfig:
    """What the pipeline is told of a mission.

    Args:
        scenario: The mission.
        world: Its world: only limits and goal are passed on, obstacles are for the camera to see.
        directions: Ray of each pixel. Shape (n, 3).
    """
    stack = scenario.stack
    hull = scenario.vehicle.hull_radius / NOMINAL_HULL
    return PipelineConfig(
        stack=stack, planner=scenario.planner, map=scenario.map, camera=scenario.camera, directions=directions,
        arena_lower=world.arena_lower, arena_upper=world.arena_upper, flight_lower=world.flight_lower,
        flight_upper=world.flight_upper, goal=world.goal, seed=scenario.seed, v_max=scenario.v_max,
        a_max=scenario.a_max, plan_radius=stack.plan_radius * hull,
        check_radius=stack.check_radius * hull, control_period_us=CONTROL_PERIOD_US,
        tracker_slowdown=scenario.platform.tracker_slowdown,
        map_latency=1e-6 * stage_latency(scenario.platform, Stage.PERCEPTION),
        plan_latency=1e-6 * stage_latency(scenario.platform, Stage.PLANNING),
        velocity_lag=1.0 / scenario.vehicle.velocity_gain,
    )  # fmt: skip
