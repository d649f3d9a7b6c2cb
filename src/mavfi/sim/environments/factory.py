"""`factory`: a hall with outer walls, inner walls with doors, rows of blocks, and pillars."""

import numpy as np

from mavfi.sim.environments.arena import CEILING, HALF_WIDTH, LENGTH, arena_world, draw_ends, world_stream
from mavfi.sim.environments.world import World

_LAW = 1
_WALL = 0.5
_WALLS_AT = (34.0, 60.0, 86.0)
_ROWS = np.arange(14.0, LENGTH - 8.0, 9.0)
_PLACES_IN_ROW = np.arange(-24.0, 25.0, 8.0)
_BLOCK, _PILLAR = 1.5, 0.5
_AISLE = 3.0

Box = tuple[float, float, float, float, float]
"""x from, to; y from, to; height (m); stands on the ground."""


def factory(seed: int) -> World:
    """A hall with three inner walls across the course, each with two doors of 4 to 5 m, and obstacles on the floor.

    Blocks (3 x 3 m, 2 to 5 m high) and pillars (1 x 1 m, to the ceiling) stand in rows, at least 3 m apart, and away
    from walls, doors, start and goal.  There is no roof.

    Args:
        seed: Seed of the mission.
    """
    stream = world_stream(seed, _LAW)
    start, goal = draw_ends(stream, half_width=18.0)
    walls = np.array(_WALLS_AT) + stream.uniform(-3.0, 3.0, len(_WALLS_AT))
    boxes = _outer_walls()
    doors: list[tuple[float, float]] = []
    for x in walls:
        boxes += _wall_with_doors(stream, float(x), doors)
    boxes += _floor(stream, np.stack([start, goal]), walls, np.array(doors))
    table = np.array(boxes)
    lower = np.column_stack([table[:, 0], table[:, 2], np.zeros(len(table))])
    return arena_world(lower, table[:, [1, 3, 4]], start, goal)


def _outer_walls() -> list[Box]:
    inner_y, inner_x = HALF_WIDTH - _WALL, LENGTH - _WALL
    return [
        (0.0, LENGTH, -HALF_WIDTH, -inner_y, CEILING),
        (0.0, LENGTH, inner_y, HALF_WIDTH, CEILING),
        (0.0, _WALL, -inner_y, inner_y, CEILING),
        (inner_x, LENGTH, -inner_y, inner_y, CEILING),
    ]


def _wall_with_doors(stream: np.random.Generator, x: float, doors: list[tuple[float, float]]) -> list[Box]:
    """The pieces of an inner wall; its two doors, one in each half, are appended to `doors`."""
    edges = [-HALF_WIDTH + _WALL]
    for half in (-1.0, 1.0):
        y, width = half * stream.uniform(5.0, 22.0), stream.uniform(4.0, 5.0)
        edges += [y - 0.5 * width, y + 0.5 * width]
        doors.append((x, y))
    edges.append(HALF_WIDTH - _WALL)
    pieces = zip(edges[::2], edges[1::2], strict=True)
    return [(x - 0.5 * _WALL, x + 0.5 * _WALL, low, high, CEILING) for low, high in pieces]


def _floor(stream: np.random.Generator, ends: np.ndarray, walls: np.ndarray, doors: np.ndarray) -> list[Box]:
    """Blocks and pillars: each place of a row has a block (45 %), a pillar (30 %) or nothing."""
    boxes: list[Box] = []
    placed: list[tuple[float, float, float]] = []
    for row in _ROWS:
        for place in _PLACES_IN_ROW:
            x, y = row + stream.uniform(-1.0, 1.0), place + stream.uniform(-1.0, 1.0)
            kind, height = stream.random(), stream.uniform(2.0, 5.0)
            half = _BLOCK if kind < 0.45 else _PILLAR
            if kind > 0.75 or not _is_free(x, y, half, ends, walls, doors) or _is_near(x, y, half, placed):
                continue
            placed.append((x, y, half))
            boxes.append((x - half, x + half, y - half, y + half, height if half == _BLOCK else CEILING))
    return boxes


def _is_free(x: float, y: float, half: float, ends: np.ndarray, walls: np.ndarray, doors: np.ndarray) -> bool:
    from_ends = np.abs(ends[:, :2] - (x, y)) > half + 5.0
    from_doors = np.abs(doors - (x, y)) > np.array([half + 5.0, half + 4.0])
    from_walls = np.abs(walls - x) > half + 3.5
    return bool(from_ends.any(axis=1).all() and from_doors.any(axis=1).all() and from_walls.all())


def _is_near(x: float, y: float, half: float, placed: list[tuple[float, float, float]]) -> bool:
    return any(max(abs(x - a), abs(y - b)) < half + c + _AISLE for a, b, c in placed)
