"""A world of your own: a row of gates to fly through.

A generator of worlds is a function `(seed, **parameters) -> World`.  Name it in an environment file,

    name: gates
    generator: examples.environment_gates:gates      # or the name of an entry point of the group mavfi.environments
    parameters: {count: 4, opening: 5.0}

and fly it with `mavfi fly --environment gates.yaml --seed 1`.
"""

import numpy as np

from mavfi.config import EnvironmentConfig
from mavfi.sim.environments import World, build_world
from mavfi.sim.environments.generated import CEILING, HALF_WIDTH, LENGTH, arena_world, draw_ends, world_stream


def gates(seed: int, count: int = 4, opening: float = 5.0) -> World:
    """Walls across the arena, each with one opening from the ground to the ceiling at a place that the seed draws.

    Args:
        seed: Seed of the mission.
        count: How many walls.
        opening: Width of the openings (m).
    """
    stream = world_stream(seed, law=100)
    start, goal = draw_ends(stream)
    lower, upper = [], []
    for x in np.linspace(0.0, LENGTH, count + 2)[1:-1]:
        middle = stream.uniform(-15.0, 15.0)
        for low, high in ((-HALF_WIDTH, middle - 0.5 * opening), (middle + 0.5 * opening, HALF_WIDTH)):
            lower.append((x, low, 0.0))
            upper.append((x + 0.5, high, CEILING))
    return arena_world(np.array(lower), np.array(upper), start, goal)


def main() -> None:
    environment = EnvironmentConfig(name="gates", generator="examples.environment_gates:gates", parameters={"count": 3})
    world = build_world(environment, seed=1)
    print(f"{len(world.lower)} walls between {world.start.round(1)} and {world.goal.round(1)}")


if __name__ == "__main__":
    main()
