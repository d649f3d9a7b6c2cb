"""Path searches by name.  A user's own planner is a class with the interface of `PathSearch` behind an entry point."""

from typing import Protocol, cast

import numpy as np

from mavfi.config import PlannerConfig
from mavfi.kernels.planning import path as paths
from mavfi.kernels.planning import rrt_connect
from mavfi.numerics.random import seed_generator
from mavfi.numerics.voxels import Grid
from mavfi.plugins import build, load_object

GROUP = "mavfi.planners"
_PURPOSE = 1


class PathSearch(Protocol):
    """Finds paths on a map of room."""

    random: np.ndarray
    """Generator state; part of the kernel's memory. Shape (4,), uint64."""

    def __init__(self, config: PlannerConfig, seed: int) -> None: ...

    def search(
        self, counter: np.ndarray, grid: Grid, start: np.ndarray, goal: np.ndarray, lower: np.ndarray, upper: np.ndarray
    ) -> np.ndarray:
        """A free path.

        Args:
            counter: > 0 = blocked. Shape (grid.size,), int16.
            grid: Geometry.
            start: World frame (m). Shape (3,).
            goal: Same.
            lower: Corner of the box in which paths may lie (m). Shape (3,).
            upper: Same.

        Returns:
            Vertices from start to goal (m). Shape (n, 3); n = 0: none found.
        """


class RrtConnect:
    """Best of several RRT-Connect runs, shortened."""

    def __init__(self, config: PlannerConfig, seed: int) -> None:
        self._config = config
        self.random = seed_generator(seed, _PURPOSE)
        self._trees = rrt_connect.new_trees()
        self._path = np.zeros((2 * rrt_connect.NODE_LIMIT, 3))
        self._buffer = np.zeros_like(self._path)

    def search(
        self, counter: np.ndarray, grid: Grid, start: np.ndarray, goal: np.ndarray, lower: np.ndarray, upper: np.ndarray
    ) -> np.ndarray:
        """See `PathSearch.search`."""
        config = self._config
        best = np.zeros((0, 3))
        shortest = np.inf
        for attempt in range(config.restarts):
            count = rrt_connect.plan(
                counter, grid, start, goal, lower, upper, config.range, config.iterations, self.random, self._trees,
                self._path,
            )  # fmt: skip
            if count == 0:
                if attempt > 0 and len(best) == 0:
                    break  # two failures in a row: there is hardly a way
                continue
            count = paths.shortcut_greedy(counter, grid, self._path, count)
            length = paths.path_length(self._path, count)
            if length < shortest:
                shortest, best = length, self._path[:count].copy()
            if count == 2:
                break
        if len(best) > 2:
            self._path[: len(best)] = best
            count = paths.shortcut_random(
                counter, grid, self._path, len(best), config.shortcuts, self.random, self._buffer
            )
            best = self._path[:count].copy()
        return best


_SHIPPED = {"rrt_connect": "mavfi.pipeline.planners:RrtConnect"}


def make_search(config: PlannerConfig, seed: int) -> PathSearch:
    """The planner that a configuration names: a shipped one, an entry point of `mavfi.planners`, or "package:Class".

    Raises:
        BadInputError: There is no such planner, or it cannot be built.
    """
    factory = load_object("planner", config.name, GROUP, _SHIPPED)
    return cast(PathSearch, build("planner", config.name, factory, config, seed, needs=("search",)))
