"""`training`: randomised worlds for training detectors, disjoint from those of the evaluation."""

import numpy as np

from mavfi.sim.environments.cuboids import cuboids
from mavfi.sim.environments.world import World

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
