"""Generators of worlds in the standard arena: cuboids, factory, farm, clutter, and those for training detectors.

Sparse and dense are worlds of cuboids with a square footprint, by [density, side].  The paper specifies Sparse as
[0.05, 6] and Dense as [0.2, 10] (MAVFI, section VI-A); density is interpreted as the share of the arena's ground area,
excluding the halos of start and goal, that is covered by footprints.
"""

import math

import numpy as np

from mavfi.errors import BadInputError
from mavfi.numerics.jit import kernel_jit
from mavfi.sim.environments.world import World

LENGTH = 120.0
"""Extent along x, from 0 (m)."""
HALF_WIDTH = 30.0
"""Extent along y, to both sides of 0 (m)."""
CEILING = 12.0
"""Height of the tallest obstacle (m)."""

_PURPOSE_WORLD, _PURPOSE_TRAINING = 0, 4
_CUBOIDS, _FACTORY, _FARM, _CLUTTER = range(4)
"""Numbers of the generators, in the addresses of their random streams."""


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


# ---- cuboids ---------------------------------------------------------------------------------------------------------
HALO = 6.0
"""Half side of the free square around start and goal (m)."""
_LARGEST_GAP = 3.0
_SMALLEST_GAP = 1.0
_RESTARTS = 12
_DARTS = 40_000


def cuboids(seed: int, density: float, side: float, gap: float | None = None) -> World:
    """Cuboids at random places of the arena.

    Any two are at least a gap apart along x or y, so that every gap can be flown through.  Heights are uniform between
    the side and the ceiling.

    Args:
        seed: Seed of the mission.
        density: Share of the arena's ground area, excluding halos, covered by footprints; met within half a cuboid.
        side: Side of the footprint (m).
        gap: Least distance of two cuboids (m); None = min(3 m, side / 2).  A smaller gap lets more cuboids fit.

    Raises:
        BadInputError: A parameter is out of range, or the cuboids do not fit.
    """
    density = checked_number("density", density, 0.0, 1.0)
    side = checked_number("side", side, 0.5, 2.0 * HALF_WIDTH)
    count = cuboid_count(density, side)
    usual = min(_LARGEST_GAP, 0.5 * side)
    gap = usual if gap is None else checked_number("gap", gap, _SMALLEST_GAP, 2.0 * HALF_WIDTH)
    if count > _most_cuboids(side, gap):
        raise _does_not_fit(density, side, gap, count)
    stream = world_stream(seed, _CUBOIDS)
    start, goal = draw_ends(stream)
    centres = _place(stream, np.stack([start[:2], goal[:2]]), count, side, gap)
    if centres is None:
        raise _does_not_fit(density, side, gap, count)
    heights = stream.uniform(min(side, CEILING), CEILING, count)
    lower = np.column_stack([centres - 0.5 * side, np.zeros(count)])
    upper = np.column_stack([centres + 0.5 * side, heights])
    return arena_world(lower, upper, start, goal)


def cuboid_count(density: float, side: float) -> int:
    """Number of cuboids for a density, rounded.

    Args:
        density: Share of the arena's ground area, halos excluded.
        side: Side of the footprint (m).
    """
    ground = LENGTH * 2.0 * HALF_WIDTH - 2.0 * (2.0 * HALO) ** 2
    return round(density * ground / (side * side))


def _most_cuboids(side: float, gap: float) -> int:
    """Upper bound on the number of cuboids: squares of side + gap in an arena enlarged by one gap."""
    pitch = side + gap
    return math.floor((LENGTH + gap) / pitch) * math.floor((2.0 * HALF_WIDTH + gap) / pitch)


def _does_not_fit(density: float, side: float, gap: float, count: int) -> BadInputError:
    return BadInputError(
        f"parameters density {density:g}, side {side:g}: {count} cuboids with gaps of {gap:g} m do not fit into "
        f"{LENGTH:g} x {2 * HALF_WIDTH:g} m; allowed: a lower density, about {0.45 * (side / (side + gap)) ** 2:.2g}"
    )


def _place(stream: np.random.Generator, ends: np.ndarray, count: int, side: float, gap: float) -> np.ndarray | None:
    """Random sequential placement, restarted a few times if it jams."""
    margin = np.array([0.5 * side, 0.5 * side - HALF_WIDTH])
    span = np.array([LENGTH - side, 2.0 * HALF_WIDTH - side])
    centres = np.empty((count, 2))
    for _ in range(_RESTARTS):
        darts = margin + span * stream.random((_DARTS, 2))
        if _throw(darts, ends, 0.5 * side + HALO, side + gap, centres) == count:
            return centres
    return None


@kernel_jit
def _throw(darts: np.ndarray, ends: np.ndarray, halo: float, pitch: float, centres: np.ndarray) -> int:
    """Keep each candidate that is far enough from the ends and from all candidates kept before.

    Args:
        darts: Candidates. Shape (m, 2).
        ends: Start and goal. Shape (2, 2).
        halo: Least distance (larger of x and y) from the ends.
        pitch: Least distance (larger of x and y) from kept candidates.
        centres: Output. Shape (n, 2).

    Returns:
        Number of kept candidates, at most n.
    """
    count = 0
    for i in range(len(darts)):
        if count == len(centres):
            break
        x, y = darts[i, 0], darts[i, 1]
        free = True
        for j in range(len(ends)):
            free = free and max(abs(x - ends[j, 0]), abs(y - ends[j, 1])) >= halo
        for j in range(count):
            if not free:
                break
            free = max(abs(x - centres[j, 0]), abs(y - centres[j, 1])) >= pitch
        if free:
            centres[count, 0] = x
            centres[count, 1] = y
            count += 1
    return count


# ---- factory ---------------------------------------------------------------------------------------------------------
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
    stream = world_stream(seed, _FACTORY)
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
        for across in _PLACES_IN_ROW:
            x, y = row + stream.uniform(-1.0, 1.0), across + stream.uniform(-1.0, 1.0)
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


# ---- farm ------------------------------------------------------------------------------------------------------------
_TREES = 8
_FROM_COURSE = 8.0
_FENCES_AT = (-25.0, 25.0)
_LOW = 1.1


def farm(seed: int) -> World:
    """Hedges across the course and fences along it, at most 1.1 m high, and eight trees at least 8 m from the course.

    Args:
        seed: Seed of the mission.
    """
    stream = world_stream(seed, _FARM)
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


# ---- clutter ---------------------------------------------------------------------------------------------------------
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
    stream = world_stream(seed, _CLUTTER)
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


# ---- training --------------------------------------------------------------------------------------------------------
DENSITY = (0.03, 0.22)
"""Range of densities."""
SIDE = (4.0, 10.0)
"""Range of sides (m)."""
EXCLUDED = ((0.05, 6.0), (0.20, 10.0))
"""[density, side] of the evaluation's cuboid worlds; the other two, factory and farm, have no such pair."""

_DENSITY_MARGIN, _SIDE_MARGIN = 0.015, 0.75


def training(seed: int) -> World:
    """A world of cuboids with density and side drawn by the seed.

    Args:
        seed: Seed of the mission.
    """
    return cuboids(seed, *draw_law(seed))


def draw_law(seed: int) -> tuple[float, float]:
    """Density and side (m) of a training world; never near a pair of the evaluation.

    Args:
        seed: Seed of the mission.
    """
    stream = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_PURPOSE_TRAINING,)))
    while True:
        density, side = float(stream.uniform(*DENSITY)), float(stream.uniform(*SIDE))
        if not any(abs(density - d) < _DENSITY_MARGIN and abs(side - s) < _SIDE_MARGIN for d, s in EXCLUDED):
            return density, side
