"""`clutter`: overlapping boxes without a minimum gap, a harder test than the paper's worlds."""

import numpy as np

from mavfi.sim.environments.arena import CEILING, HALF_WIDTH, LENGTH, arena_world, checked_number, world_stream
from mavfi.sim.environments.world import World

_LAW = 3
_FREE = 3.0


def clutter(seed: int, boxes: int = 200) -> World:
    """Boxes 1 to 6 m wide and at least 2 m high, anywhere between start and goal; 3 m around both ends stay free.

    Args:
        seed: Seed of the mission.
        boxes: Number of boxes.

    Raises:
        BadInputError: `boxes` is out of range.
    """
    count = int(checked_number("boxes", boxes, 0, 2000))
    stream = world_stream(seed, _LAW)
    start, goal = (
        np.array([x, 0.0, 3.0]) + stream.uniform((-1.0, -4.0, -0.5), (1.0, 4.0, 1.0)) for x in (10.0, LENGTH - 10.0)
    )
    lower, upper = np.empty((count, 3)), np.empty((count, 3))
    filled = 0
    while filled < count:
        half = 0.5 * stream.uniform(1.0, 6.0, 2)
        height = min(stream.uniform(2.0, 15.0), CEILING)
        side = HALF_WIDTH - half[1]
        centre = np.array([stream.uniform(10.0, LENGTH - 10.0), stream.uniform(-side, side)])
        if all(np.any(np.abs(centre - end[:2]) >= half + _FREE) for end in (start, goal)):
            lower[filled] = (*(centre - half), 0.0)
            upper[filled] = (*(centre + half), height)
            filled += 1
    return arena_world(lower, upper, start, goal)
