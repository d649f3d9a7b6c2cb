"""A planner of one's own: two straight legs, over a point to the side of, or above, the middle of the way.

    mavfi fly --environment sparse --seed 7 --planner examples.planner_detour:Detour

run from the folder that holds `examples`, or `planner_detour:Detour` from within it.  An installed package can give it
a name instead: an entry point of the group `mavfi.planners`.
"""

import numpy as np

from mavfi.config import PlannerConfig
from mavfi.numerics.random import seed_generator
from mavfi.numerics.voxels import Grid, segment_free
from mavfi.pipeline.planners import RrtConnect


class Detour:
    """Takes the shortest free detour; where none is free it leaves the search to RRT-Connect."""

    sideways = np.arange(-20.0, 20.1, 2.0)
    upward = np.arange(0.0, 6.1, 1.0)

    def __init__(self, config: PlannerConfig, seed: int) -> None:
        self.random = seed_generator(seed, 1)
        self._fallback = RrtConnect(config, seed)
        self._fallback.random = self.random  # so that one state holds all randomness

    def search(
        self, counter: np.ndarray, grid: Grid, start: np.ndarray, goal: np.ndarray, lower: np.ndarray, upper: np.ndarray
    ) -> np.ndarray:
        """Called with a map (> 0 = too near to an obstacle); answers vertices from start to goal, none = no path."""
        middle = 0.5 * (start + goal)
        by_length = sorted((abs(y) + z, y, z) for y in self.sideways for z in self.upward)
        for _, y, z in by_length:
            via = np.clip(middle + (0.0, y, z), lower, upper)
            if segment_free(counter, grid, start, via) and segment_free(counter, grid, via, goal):
                return np.array([start, via, goal])
        return self._fallback.search(counter, grid, start, goal, lower, upper)
