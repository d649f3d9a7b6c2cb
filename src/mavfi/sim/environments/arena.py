"""Common parts of all generated worlds: the arena, the draw of start and goal, and the world's random stream."""

import numpy as np

from mavfi.errors import BadInputError
from mavfi.sim.environments.world import World

LENGTH = 120.0
"""Extent along x, from 0 (m)."""
HALF_WIDTH = 30.0
"""Extent along y, to both sides of 0 (m)."""
CEILING = 12.0
"""Height of the tallest obstacle (m)."""

_PURPOSE_WORLD = 0


def world_stream(seed: int, law: int) -> np.random.Generator:
    """The random stream of a world.

    Args:
        seed: Seed of the mission.
        law: Number of the generator, so that two generators share no draws.
    """
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed, spawn_key=(_PURPOSE_WORLD, law))))


def draw_ends(
    stream: np.random.Generator, half_width: float = 20.0, height: tuple[float, float] = (2.5, 5.0)
) -> tuple[np.ndarray, np.ndarray]:
    """Start and goal of a course of about 100 m along x; sides and heights are independent.

    Args:
        stream: The world's random stream.
        half_width: Largest |y| (m).
        height: Lowest and highest z (m).

    Returns:
        Start and goal (m). Shapes (3,).
    """
    ends = [
        np.array([x + stream.uniform(-2, 2), stream.uniform(-half_width, half_width), stream.uniform(*height)])
        for x in (10.0, LENGTH - 10.0)
    ]
    return ends[0], ends[1]


def arena_world(lower: np.ndarray, upper: np.ndarray, start: np.ndarray, goal: np.ndarray) -> World:
    """A world of boxes in the standard arena.

    The edge of the arena is a limit of the planner, not a wall; the planner stays 1 m inside it, at heights of 1.6 to
    9.6 m, so that the flight stays in the band of 1 to 10 m.

    Args:
        lower: Lower corners of the boxes (m). Shape (n, 3).
        upper: Upper corners of the boxes (m). Shape (n, 3).
        start: Start (m). Shape (3,).
        goal: Goal (m). Shape (3,).
    """
    return World(
        start=start,
        goal=goal,
        arena_lower=np.array([0.0, -HALF_WIDTH, 0.0]),
        arena_upper=np.array([LENGTH, HALF_WIDTH, CEILING]),
        flight_lower=np.array([1.0, 1.0 - HALF_WIDTH, 1.6]),
        flight_upper=np.array([LENGTH - 1.0, HALF_WIDTH - 1.0, 9.6]),
        lower=lower,
        upper=upper,
    )


def checked_number(name: str, value: object, low: float, high: float) -> float:
    """A generator's parameter as a number.

    Args:
        name: Name of the parameter.
        value: The given value.
        low: Smallest allowed value.
        high: Largest allowed value.

    Raises:
        BadInputError: It is not a number within the limits.
    """
    if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
        raise BadInputError(f"parameter {name!r}: {value!r}; allowed: a number from {low:g} to {high:g}")
    return float(value)
