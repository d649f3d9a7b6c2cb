"""A planner: a straight way if it is free, else one corner beside or above it, else RRT-Connect."""

import numpy as np

from mavfi.config import PlannerConfig
from mavfi.numerics.random import seed_generator
from mavfi.numerics.voxels import Grid, segment_free
from mavfi.pipeline.planners import RrtConnect


class MyPlanner:
    """Called for each path of a mission; what it returns is smoothed, timed and checked by the pipeline."""

    def __init__(self, config: PlannerConfig, seed: int) -> None:
        # All randomness of a planner is in `random`, so that a flight is the same each time.
        self.random = seed_generator(seed, 1)
        self._fallback = RrtConnect(config, seed)
        self._fallback.random = self.random

    def search(
        self, counter: np.ndarray, grid: Grid, start: np.ndarray, goal: np.ndarray, lower: np.ndarray, upper: np.ndarray
    ) -> np.ndarray:
        """Vertices from start to goal (m); an empty array of shape (0, 3) if there is no path.

        Args:
            counter: The map: blocked where > 0. Shape (grid.size,), int16.
            grid: Its geometry.
            start: World frame (m). Shape (3,).
            goal: World frame (m). Shape (3,).
            lower: Corner of the box that contains all paths (m). Shape (3,).
            upper: Opposite corner (m). Shape (3,).
        """
        if segment_free(counter, grid, start, goal):
            return np.array([start, goal])
        middle = 0.5 * (start + goal)
        for distance in np.arange(2.0, 20.1, 2.0):  # the shortest detour first
            for side in ((0.0, 1.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, 1.0)):
                corner = np.clip(middle + distance * np.array(side), lower, upper)
                if segment_free(counter, grid, start, corner) and segment_free(counter, grid, corner, goal):
                    return np.array([start, corner, goal])
        return self._fallback.search(counter, grid, start, goal, lower, upper)
