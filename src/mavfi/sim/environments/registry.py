"""Builds a world from an environment's configuration: finds generators, validates user input."""

import inspect
import warnings
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any, cast

import numpy as np

from mavfi.config import SCAN_ENDINGS, EnvironmentConfig, Vector
from mavfi.errors import BadInputError
from mavfi.files import is_file
from mavfi.mission import ARRIVAL_RADIUS, Scenario
from mavfi.plugins import load_object, parameters_of
from mavfi.sim.environments.world import World
from mavfi.sim.mjcf import find_vehicle

Generator = Callable[..., World]
"""Called as `generator(seed, **parameters)`; a generator with parameters `start` and `goal` receives those of the
mission, or None."""

ENTRY_POINT_GROUP = "mavfi.environments"

_GENERATED = ("cuboids", "factory", "farm", "clutter", "training")
_BUILT_IN = {name: f"mavfi.sim.environments.generated:{name}" for name in _GENERATED}
SCAN_GENERATOR = "octomap_file"
"""Generator of scanned maps."""
_BUILT_IN[SCAN_GENERATOR] = "mavfi.sim.environments.octomap_file:octomap_file"


def scenario_world(scenario: Scenario) -> World:
    """The world of a scenario; see `build_world`."""
    return build_world(scenario.environment, scenario.seed, scenario.start, scenario.goal, scenario.arrival_radius)


def build_world(
    environment: EnvironmentConfig,
    seed: int,
    start: Vector | None = None,
    goal: Vector | None = None,
    arrival_radius: float = ARRIVAL_RADIUS,
) -> World:
    """The world of a mission.

    Args:
        environment: Generator and parameters.
        seed: Seed of the mission; all randomness comes from it.
        start: Overrides the generator's start (m).
        goal: Overrides the generator's goal (m).
        arrival_radius: Distance from the goal that counts as arrival (m).

    Raises:
        BadInputError: Unknown generator or parameter, a parameter that the generator rejects, or a start or goal
            inside an obstacle or outside the flight volume, or a start within the arrival radius.
    """
    # A generator that has the parameters start and goal receives them.
    generator = find_generator(environment.generator)
    parameters = parameters_of("generator", environment.generator, generator)[1:]
    requested_ends = {"start": start, "goal": goal}
    ends = {}
    if set(requested_ends) <= set(parameters):
        ends = requested_ends
    source = f"environment {environment.name!r}"
    try:
        inspect.signature(generator).bind(seed, **environment.parameters, **ends)
    except TypeError as error:
        allowed = ", ".join(name for name in parameters if name not in ends)
        raise BadInputError(f"{source}: generator {environment.generator}: {error}; allowed: {allowed}") from None

    # Generate, and check the result, which may be that of a user's own function.
    try:
        world = generator(seed, **environment.parameters, **ends)
    except BadInputError as error:
        raise BadInputError(f"{source}: {error}") from None
    if not isinstance(world, World):
        raise BadInputError(
            f"{source}: generator {environment.generator}: gives no World, but a {type(world).__name__}"
        )
    _check_boxes(f"{source}: generator {environment.generator}", world)

    # In all worlds, requested ends replace those of the generator.
    overrides: dict[str, Any] = {key: np.array(point) for key, point in requested_ends.items() if point is not None}
    world = replace(world, **overrides)
    radius = _collision_radius(environment.vehicle)
    for key, point in (("start", world.start), ("goal", world.goal)):
        _check_end(source, key, point, world, radius)
    if world.course < arrival_radius:
        raise BadInputError(
            f"{source}: goal {_text(world.goal)}: {world.course:.2f} m from the start, where it counts as reached; "
            f"allowed: {arrival_radius:g} m or more"
        )
    return world


def _check_boxes(source: str, world: World) -> None:
    """Raise a BadInputError unless each pair of corners spans a box."""
    lower, upper = world.lower, world.upper
    if lower.shape != upper.shape or lower.shape[1:] != (3,):
        raise BadInputError(f"{source}: boxes of shapes {lower.shape} and {upper.shape}; allowed: (n, 3) both")
    wrong = np.flatnonzero(~(np.isfinite(lower) & np.isfinite(upper) & (lower < upper)).all(axis=1))
    if len(wrong):
        source = f"{source}: box {wrong[0]}: {_text(lower[wrong[0]])} to {_text(upper[wrong[0]])}"
        raise BadInputError(f"{source}; allowed: finite corners, each coordinate of the first below that of the second")


def find_generator(name: str) -> Generator:
    """A generator by name, or by "package.module:function".

    Args:
        name: One of the built-in generators, an entry point of the group `mavfi.environments`, or a function.

    Raises:
        BadInputError: Unknown name, or it cannot be imported.
    """
    return cast(Generator, load_object("generator", name, ENTRY_POINT_GROUP, _BUILT_IN))


def environment_for_file(path: str | Path) -> EnvironmentConfig:
    """The environment of a scanned map, with settings for the inside of a building; of a larger one on a coarser map.

    A small quadrotor flies slowly on a fine map, because a scan has narrow passages: unknown space is solid, and rays
    without a return leave specks of it in the middle of rooms (spheres of 0.28 m barely fit a corridor of 3 x 2.5 m).

    Args:
        path: OctoMap file ending in .bt or .ot.

    Raises:
        BadInputError: Another ending, or the file cannot be read.
    """
    path = Path(path)
    if path.suffix.lower() not in SCAN_ENDINGS:
        raise BadInputError(f"{path}: not a scanned map; allowed: a file ending in {' or '.join(SCAN_ENDINGS)}")
    if not is_file(path):
        raise BadInputError(f"{path}: there is no such file")
    from mavfi.sim.environments.octomap_file import map_resolution_for  # with scipy.ndimage, which is slow to import

    return EnvironmentConfig(
        name=path.stem,
        generator=SCAN_GENERATOR,
        parameters={"path": str(path)},
        vehicle="small_quad",
        v_max=0.6,
        map_resolution=map_resolution_for(str(path)),
        camera_range=8.0,
    )


@cache
def _collision_radius(vehicle: str) -> float:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # on what was assumed; whoever chose the vehicle has seen it
        return find_vehicle(vehicle).collision_radius


def _text(point: np.ndarray) -> str:
    return "(" + ", ".join(f"{value:g}" for value in point) + ")"


def _check_end(source: str, key: str, point: np.ndarray, world: World, radius: float) -> None:
    text = _text(point)
    low, high = world.flight_lower, world.flight_upper
    if not bool(np.all((point >= low) & (point <= high))):
        limits = ", ".join(f"{axis} {a:g} to {b:g}" for axis, a, b in zip("xyz", low, high, strict=True))
        raise BadInputError(f"{source}: {key} {text}: outside of the flight volume; allowed: {limits}")
    clearance = float(world.clearance(point)[0])
    if clearance < radius:
        obstacle = "an obstacle"
        if world.is_voxels:
            obstacle = "solid or unknown space"
        raise BadInputError(
            f"{source}: {key} {text}: {clearance:.2f} m from {obstacle}; allowed: at least {radius:g} m, "
            "the collision radius of the vehicle"
        )
