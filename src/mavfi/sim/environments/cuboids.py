"""`sparse`, `dense` and similar worlds: cuboids with a square footprint, by [density, side].

The paper specifies Sparse as [0.05, 6] and Dense as [0.2, 10] (MAVFI, section VI-A); density is interpreted as the
share of the arena's ground area, excluding the halos of start and goal, that is covered by footprints.
"""

import math

import numpy as np

from mavfi.errors import BadInputError
from mavfi.numerics.jit import kernel_jit
from mavfi.sim.environments.arena import (
    CEILING,
    HALF_WIDTH,
    LENGTH,
    arena_world,
    checked_number,
    draw_ends,
    world_stream,
)
from mavfi.sim.environments.world import World

HALO = 6.0
"""Half side of the free square around start and goal (m)."""
_LAW = 0
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
    stream = world_stream(seed, _LAW)
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


# ---- training worlds -------------------------------------------------------------------------------------------------

DENSITY = (0.03, 0.22)
"""Range of densities."""
SIDE = (4.0, 10.0)
"""Range of sides (m)."""
EXCLUDED = ((0.05, 6.0), (0.20, 10.0))
"""[density, side] of the evaluation's cuboid worlds; the other two, factory and farm, have no such pair."""

_DENSITY_MARGIN, _SIDE_MARGIN = 0.015, 0.75
_PURPOSE_TRAINING = 4


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
