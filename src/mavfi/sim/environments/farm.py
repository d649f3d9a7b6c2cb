"""`farm`: hedges and fences below flight altitude, a few trees next to the course."""

import numpy as np

from mavfi.sim.environments.arena import LENGTH, arena_world, draw_ends, world_stream
from mavfi.sim.environments.world import World

_LAW = 2
_TREES = 8
_FROM_COURSE = 8.0
_FENCES_AT = (-25.0, 25.0)
_LOW = 1.1


def farm(seed: int) -> World:
    """Hedges across the course and fences along it, at most 1.1 m high, and eight trees at least 8 m from the course.

    Args:
        seed: Seed of the mission.
    """
    stream = world_stream(seed, _LAW)
    start, goal = draw_ends(stream, half_width=15.0, height=(3.0, 5.0))
    boxes = [
        (x, stream.uniform(-28.0, -5.0), 0.0, x + 1.0, stream.uniform(5.0, 28.0), stream.uniform(0.6, _LOW))
        for x in np.arange(20.0, LENGTH - 15.0, stream.uniform(12.0, 18.0))
    ]
    boxes += [(5.0, y, 0.0, LENGTH - 5.0, y + 0.2, _LOW) for y in _FENCES_AT]
    trees = 0
    while trees < _TREES:
        x, y = stream.uniform(5.0, LENGTH - 5.0), stream.uniform(-28.0, 28.0)
        along = (x - start[0]) / (goal[0] - start[0])
        if abs(y - (start[1] + along * (goal[1] - start[1]))) < _FROM_COURSE:
            continue
        height = stream.uniform(4.0, 8.0)
        boxes.append((x - 0.3, y - 0.3, 0.0, x + 0.3, y + 0.3, height - 2.0))
        boxes.append((x - 1.5, y - 1.5, height - 2.0, x + 1.5, y + 1.5, height))
        trees += 1
    table = np.array(boxes)
    return arena_world(table[:, :3], table[:, 3:], start, goal)
