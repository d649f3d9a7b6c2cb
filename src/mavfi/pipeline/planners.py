"""Path searches by name.  A user's own planner is a class with the interface of `PathSearch` and an entry point."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Any, Protocol

import numpy as np

from mavfi.config import PlannerConfig
from mavfi.errors import BadInputError
from mavfi.kernels.planning import path as paths
from mavfi.kernels.planning import rrt, rrt_connect, rrt_star
from mavfi.kernels.planning.trajectory import CURVE_LIMIT
from mavfi.numerics.random import seed_generator
from mavfi.numerics.voxels import Grid
from mavfi.pipeline.functions import PLAIN, KernelFunctions
from mavfi.plugins import build, load_object

GROUP = "mavfi.planners"
"""Entry-point group of path searches."""
_PURPOSE = 1
"""Number of the planner's random stream among those of a mission's seed."""
_SHORTCUT_ROOM = 2
"""Vertices that a random shortcut may add to a path."""
_STAR_NODE_LIMIT = 200_001
"""Largest tree of RRT* (nodes)."""

_Problem = tuple[np.ndarray, Grid, np.ndarray, np.ndarray, np.ndarray, np.ndarray]
"""Arguments of `PathSearch.search`."""
MOST_VERTICES = CURVE_LIMIT // 40
"""Vertices of a path up to which it is timed."""


class PathSearch(Protocol):
    """Finds paths on a clearance map."""

    random: np.ndarray
    """Generator state; part of the kernel's memory. Shape (4,), uint64."""

    def __init__(self, config: PlannerConfig, seed: int) -> None: ...

    def search(
        self, counter: np.ndarray, grid: Grid, start: np.ndarray, goal: np.ndarray, lower: np.ndarray, upper: np.ndarray
    ) -> np.ndarray:
        """Search for a collision-free path.

        Args:
            counter: Blocked where > 0. Shape (grid.size,), int16.
            grid: Geometry of the map.
            start: World frame (m). Shape (3,).
            goal: World frame (m). Shape (3,).
            lower: Corner of the box that contains all paths (m). Shape (3,).
            upper: Opposite corner (m). Shape (3,).

        Returns:
            Finite vertices from start to goal (m). Shape (n, 3), n at most `MOST_VERTICES`; n = 0: none found.
        """


class SearchScratch:
    """`Scratch` of a path search: a copy of its arrays, shared by all instants between two searches.

    Args:
        arrays: The arrays.
    """

    def __init__(self, arrays: Sequence[np.ndarray]) -> None:
        self._arrays = arrays
        self._saved: tuple[np.ndarray, ...] | None = None

    def changes(self) -> None:
        """The arrays are written now."""
        self._saved = None

    def save(self) -> tuple[np.ndarray, ...]:
        """See `Scratch.save`."""
        if self._saved is None:
            self._saved = tuple(array.copy() for array in self._arrays)
        return self._saved

    def restore(self, saved: tuple[np.ndarray, ...]) -> None:
        """See `Scratch.restore`; arrays are written at once."""
        if saved is not self._saved:
            for array, content in zip(self._arrays, saved, strict=True):
                array[:] = content
        self._saved = saved

    def fill(self) -> None:
        """See `Scratch.fill`."""


def arrays_of(value: Any) -> list[np.ndarray]:  # noqa: ANN401
    """All arrays in nested tuples, in order."""
    if isinstance(value, tuple):
        return [array for part in value for array in arrays_of(part)]
    if isinstance(value, np.ndarray):
        return [value]
    return []


class SamplingSearch(ABC):
    """Best of several runs of a sampling-based planner, shortened.  Its generator is its only memory."""

    functions: KernelFunctions = PLAIN
    """Compiled functions that it calls."""
    scratch: SearchScratch | None = None
    """Its work arrays; None = they are too large to be saved."""

    def __init__(self, config: PlannerConfig, seed: int, runs: int, vertices: int) -> None:
        self._config = config
        self._runs = runs
        self.random = seed_generator(seed, _PURPOSE)
        self._path = np.zeros((vertices + _SHORTCUT_ROOM, 3))
        self._buffer = np.zeros_like(self._path)

    def save(self) -> np.ndarray:
        """See `Keeper.save`."""
        return self.random.copy()

    def restore(self, saved: np.ndarray) -> None:
        """See `Keeper.restore`."""
        self.random[:] = saved

    def same(self, saved: np.ndarray) -> bool:
        """See `Keeper.same`."""
        return bool((self.random == saved).all())

    def arrays(self) -> dict[str, np.ndarray]:
        """See `Keeper.arrays`."""
        return {"random": self.random}

    @abstractmethod
    def _run(self, problem: _Problem) -> int:
        """Write a path to `_path`; returns its number of vertices, 0 = none found."""

    def search(
        self, counter: np.ndarray, grid: Grid, start: np.ndarray, goal: np.ndarray, lower: np.ndarray, upper: np.ndarray
    ) -> np.ndarray:
        """See `PathSearch.search`."""
        if self.scratch is not None:
            self.scratch.changes()
        best = np.zeros((0, 3))
        shortest = np.inf
        for attempt in range(min(self._runs, self._config.restarts)):  # bounded twice: memory may be corrupted
            count = self._run((counter, grid, start, goal, lower, upper))
            if count == 0:
                if attempt > 0 and len(best) == 0:
                    break  # two consecutive failures: a path is unlikely to exist
                continue
            count = self.functions.shortcut_greedy(counter, grid, self._path, count)
            length = paths.path_length(self._path, count)
            if length < shortest:
                shortest = length
                best = self._path[:count].copy()
            if count == 2:
                break
        if len(best) > 2:
            self._path[: len(best)] = best
            count = self.functions.shortcut_random(
                counter, grid, self._path, len(best), self._config.shortcuts, self.random, self._buffer
            )
            best = self._path[:count].copy()
        return best


class Rrt(SamplingSearch):
    """Best of several RRT runs, shortened."""

    def __init__(self, config: PlannerConfig, seed: int) -> None:
        super().__init__(config, seed, config.restarts, config.iterations + 1)
        self._tree = rrt.new_tree(config.iterations + 1)
        self.scratch = SearchScratch(arrays_of((self._tree, self._path, self._buffer)))

    def _run(self, problem: _Problem) -> int:
        """See `SamplingSearch`."""
        config = self._config
        return int(
            self.functions.plan_rrt(
                *problem, config.range, config.goal_bias, config.iterations, self.random, self._tree, self._path
            )
        )


class RrtConnect(SamplingSearch):
    """Best of several RRT-Connect runs, shortened."""

    def __init__(self, config: PlannerConfig, seed: int) -> None:
        super().__init__(config, seed, config.restarts, 2 * rrt_connect.NODE_LIMIT)
        self._trees = rrt_connect.new_trees()
        self.scratch = SearchScratch(arrays_of((self._trees, self._path, self._buffer)))

    def _run(self, problem: _Problem) -> int:
        """See `SamplingSearch`."""
        return int(
            self.functions.plan_rrt_connect(
                *problem, self._config.range, self._config.iterations, self.random, self._trees, self._path
            )
        )


class RrtStar(SamplingSearch):
    """One RRT* run, shortened.

    Its budget is `iterations`.  If no path is found, the same tree continues to grow until the first path, for at most
    `restarts` budgets: the number of samples allowed to the other planners.  No other planner is used as a fallback.
    """

    def __init__(self, config: PlannerConfig, seed: int) -> None:
        self._longest = config.iterations * config.restarts
        nodes = min(self._longest + 1, _STAR_NODE_LIMIT)
        super().__init__(config, seed, 1, nodes)
        self._tree = rrt_star.new_tree(nodes)

    def _run(self, problem: _Problem) -> int:
        """See `SamplingSearch`."""
        config = self._config
        return int(
            self.functions.plan_rrt_star(
                *problem,
                config.range,
                config.goal_bias,
                config.iterations,
                min(self._longest, config.iterations * config.restarts),
                self.random,
                self._tree,
                self._path,
            )
        )


_SHIPPED = {
    "rrt": "mavfi.pipeline.planners:Rrt",
    "rrt_connect": "mavfi.pipeline.planners:RrtConnect",
    "rrt_star": "mavfi.pipeline.planners:RrtStar",
}
"""Addresses of the shipped planners, by name."""
_METHODS = {"search": "counter, grid, start, goal, lower, upper"}
"""Parameters of a planner's methods."""


def find_search(name: str) -> Callable[..., PathSearch]:
    """A planner's class, called with its configuration and the mission's seed.

    Args:
        name: A shipped name, an entry point of `mavfi.planners`, or "package.module:Class".

    Raises:
        BadInputError: It is not known, not allowed, or cannot be imported.
    """
    factory: Callable[..., PathSearch] = load_object(
        "planner", name, GROUP, _SHIPPED, also="a YAML file, or package:Class"
    )
    return factory


def make_search(config: PlannerConfig, seed: int, functions: KernelFunctions = PLAIN) -> PathSearch:
    """Construct a planner; see `find_search`.

    Raises:
        BadInputError: It does not exist or cannot be constructed.
    """
    factory = find_search(config.name)
    search: PathSearch = build("planner", config.name, factory, config, seed, needs=_METHODS)
    random = getattr(search, "random", None)
    if not isinstance(random, np.ndarray) or random.dtype != np.uint64 or random.shape != (4,):
        raise BadInputError(f"planner {config.name!r}: lacks random, the state of its generator: shape (4,), uint64")
    if isinstance(search, SamplingSearch):
        search.functions = functions
    return search


def checked_path(search: PathSearch, returned: np.ndarray) -> np.ndarray:
    """The path that a planner returned, whose start and goal are finite also after a fault.  Shape (n, 3).

    Where it begins and ends is not checked: a fault in the planner may have moved that.

    Args:
        search: The planner.
        returned: What its `search` returned.

    Raises:
        BadInputError: A user's planner returned something else than `PathSearch.search` promises.
    """
    if isinstance(search, SamplingSearch):
        return returned
    kind = type(search)
    try:
        path = np.asarray(returned)
        is_path = path.shape[:1] == (0,) or (path.ndim == 2 and path.shape[1] == 3 and path.dtype.kind in "fiu")
    except ValueError:  # rows of different lengths
        is_path = False
    source = f"planner {kind.__module__}:{kind.__qualname__}: search returned"
    if not is_path:
        text = f"{' '.join(repr(returned).split())[:60]}; allowed: an array of shape (n, 3), n = 0 if there is no path"
        raise BadInputError(f"{source} {text}")
    if not np.isfinite(path).all():
        raise BadInputError(f"{source} vertices that are not finite; allowed: finite ones, or an empty array")
    if len(path) > MOST_VERTICES:
        raise BadInputError(f"{source} {len(path)} vertices; allowed: at most {MOST_VERTICES}")
    if len(path) == 1:
        raise BadInputError(f"{source} 1 vertex; allowed: 2 or more, from start to goal, or none if there is no path")
    return path
