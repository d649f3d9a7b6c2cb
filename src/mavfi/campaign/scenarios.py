"""Names of configurations become the `Scenario` that a flight is a function of."""

from mavfi.config import (
    CameraConfig,
    EnvironmentConfig,
    MapConfig,
    PlannerConfig,
    PlatformConfig,
    StackConfig,
    Vector,
    VehicleConfig,
    shipped,
)
from mavfi.mission import Scenario


def build_scenario(  # noqa: PLR0913 - what a user can choose, by name
    environment: str,
    seed: int,
    *,
    stack: str = "published",
    platform: str = "i9-9940x",
    planner: str = "rrt_connect",
    v_max: float | None = None,
    start: Vector | None = None,
    goal: Vector | None = None,
) -> Scenario:
    """Resolve names; what the environment asks for replaces the defaults of camera, map and radii.

    Args:
        environment: Name of a shipped environment, or a path to a YAML file.
        seed: Seed of the mission.
        stack: Name or path.
        platform: Name or path.
        planner: Entry point of the group mavfi.planners.
        v_max: Speed limit (m/s); None = the environment's, or else the default.
        start: Start (m); None = drawn by the seed.
        goal: Goal (m); None = drawn by the seed.

    Raises:
        BadInputError: A name is not known, or a file is wrong.
    """
    world = shipped("environments", EnvironmentConfig, environment)
    rules = shipped("stacks", StackConfig, stack)
    radii = {"plan_radius": world.plan_radius, "check_radius": world.check_radius}
    speed = v_max if v_max is not None else world.v_max
    return Scenario(
        environment=world,
        seed=seed,
        stack=rules.model_copy(update={key: radius for key, radius in radii.items() if radius is not None}),
        vehicle=shipped("vehicles", VehicleConfig, world.vehicle),
        platform=shipped("platforms", PlatformConfig, platform),
        planner=PlannerConfig(name=planner),
        camera=CameraConfig() if world.camera_range is None else CameraConfig(range=world.camera_range),
        map=MapConfig() if world.map_resolution is None else MapConfig(resolution=world.map_resolution),
        start=start,
        goal=goal,
        **({} if speed is None else {"v_max": speed}),
    )
