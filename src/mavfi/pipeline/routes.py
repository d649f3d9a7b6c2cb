"""Path selection: searches on the clearance map, and the choice among their results.

A path keeps the planner's radius where possible.  If this causes a long detour or fails, paths through narrow passages
are searched with the checker's radius; the fastest path is selected.
"""

import time

import numpy as np

from mavfi.kernels.perception.clearance import OCCUPIED
from mavfi.kernels.planning import path as paths
from mavfi.kernels.planning import travel
from mavfi.numerics.voxels import voxel_of
from mavfi.pipeline.clearance_map import ClearanceMap
from mavfi.pipeline.kernel import PipelineConfig
from mavfi.pipeline.memory import Keeper, OpaqueKeeper, Scratch, declared_arrays
from mavfi.pipeline.planners import PathSearch, SamplingSearch, checked_path, make_search

TIGHT_SPEED = 2.0
"""Speed limit where only the checker's radius fits (m/s)."""
PLANNING_ACCELERATION = 2.5
"""Planned acceleration along the path (m/s^2); half of a_max, the rest is reserved for corners and tracking."""
LATERAL_SHARE = 0.7
"""Planned lateral acceleration / a_max."""
NOMINAL_SPEED = 3.0
"""Speed limit for which lengths are specified (m/s); below it they scale with the speed."""
BLEND = 3.5
"""Longest distance of a corner blend from its corner at the nominal speed (m)."""
_REACH = 3.0
"""Distance from a blocked start or goal within which a free point is searched for (m)."""
_TRIES = 200
"""Number of random improvements of a path."""
_GOOD_ENOUGH = 1.15
"""Travel time of a path / of the straight line, below which no further search is made."""
_STRETCH_STEP = 0.25
"""Longest distance of the points at which a path is examined for narrow passages (m)."""
_LOCAL_ITERATIONS = 300
"""Iterations of the search for a bypass of a narrow passage."""
_LOCAL_MARGIN = 6.0
"""Margin of the box for bypasses around the passage (m)."""
_SHORTCUTS = 80
"""Number of random shortcuts of a path with bypasses."""


class _Searches(OpaqueKeeper[tuple[PathSearch, PathSearch]]):
    """The search of whole paths, and that of bypasses, which share one generator."""

    def arrays(self) -> dict[str, np.ndarray]:
        """The generator, and what the search of whole paths declares."""
        search = self.content[0]
        return {"random": search.random, **declared_arrays(search)}


class Routes:
    """Finds paths to the goal.

    Attributes:
        clearance_map: The clearance map for the searches.
        keeper: The searches' memory: the generator; for a user's planner the whole object.
        scratch: Work arrays of the searches; None = they cannot be saved.
        wall_times: Time that each search of a whole path took here (s); no part of the flight.
    """

    def __init__(self, config: PipelineConfig) -> None:
        self._config = config
        self.wall_times: list[float] = []
        self.clearance_map = ClearanceMap(config)
        search = make_search(config.planner, config.seed, config.functions)
        small = config.planner.model_copy(update={"iterations": _LOCAL_ITERATIONS, "restarts": 1})
        local = make_search(small, config.seed, config.functions)
        local.random = search.random  # a single stream to roll back
        self._searches = _Searches((search, local))
        self.keeper: Keeper = self._searches
        if isinstance(search, SamplingSearch):
            self.keeper = search
        scratch = []
        for planner in (search, local):
            if isinstance(planner, SamplingSearch) and planner.scratch is not None:
                scratch.append(planner.scratch)
        self.scratch: tuple[Scratch, ...] | None = None
        if len(scratch) == 2:  # of both searches
            self.scratch = tuple(scratch)
        v_max = config.v_max
        self._pace = travel.Pace(
            v_max,
            min(TIGHT_SPEED, v_max),
            PLANNING_ACCELERATION,
            LATERAL_SHARE * config.a_max,
            BLEND * min(1.0, v_max / NOMINAL_SPEED),
        )
        self._occupied = np.zeros(self.clearance_map.grid.size, np.int16)
        self._buffer = np.zeros((2, 20_000, 3))

    @property
    def search(self) -> PathSearch:
        """The configured planner."""
        return self._searches.content[0]

    @property
    def random(self) -> np.ndarray:
        """State of the planner's generator. Shape (4,), uint64."""
        return self.search.random

    def between(self, start: np.ndarray, counter: np.ndarray, goal: np.ndarray | None = None) -> np.ndarray | None:
        """Vertices from (near) `start` to (near) the goal (None = the mission's) in `counter`; None = no path."""
        config = self._config
        clearance = self.clearance_map
        if goal is None:
            goal = config.goal
        first = np.zeros(3)
        last = np.empty(3)
        box = config.flight_lower, config.flight_upper
        core = self._core()
        if not paths.nearest_clear(counter, clearance.narrow, core, clearance.grid, start, *box, _REACH, first):
            return None
        if not paths.nearest_clear(clearance.wide, clearance.narrow, core, clearance.grid, goal, *box, _REACH, last):
            last[:] = goal
        began = time.perf_counter()
        vertices = self.search.search(counter, clearance.grid, first, last, *box)
        self.wall_times.append(time.perf_counter() - began)
        path = checked_path(self.search, vertices)
        if len(path):
            return path
        return None

    def _core(self) -> np.ndarray:
        """Voxels (> 0) that an escape from a blocked place must avoid; the published code has none. Shape (size,)."""
        if self._config.autopilot.replanning == "every_map":
            np.equal(self.clearance_map.cells, OCCUPIED, out=self._occupied, casting="unsafe")
        return self._occupied

    def first_found(self, start: np.ndarray) -> np.ndarray | None:
        """A path with the planner's radius or, failing that, with the checker's."""
        for counter in (self.clearance_map.wide, self.clearance_map.narrow):
            path = self.between(start, counter)
            if path is not None:
                return _from(start, path)
        return None

    def fastest(self, start: np.ndarray, velocity: np.ndarray) -> np.ndarray | None:
        """The fastest of several paths; narrow passages are used only if necessary.

        Start position (m) and velocity (m/s) are in the world frame.
        """
        straight = np.array([start, self._config.goal])
        good_time = _GOOD_ENOUGH * paths.path_length(straight, 2) / self._config.v_max
        best = None
        best_time = np.inf
        wide = self.clearance_map.wide
        narrow = self.clearance_map.narrow
        for counter in (wide, narrow):
            for _ in range(self._config.autopilot.searches):
                path = self.between(start, counter)
                if path is None:
                    break
                path = _from(start, path)
                if counter is narrow:
                    path = self._widened(path)
                path = self._quickened(path, velocity, counter)
                time = self._time(path, velocity)
                if time < best_time:
                    best = path
                    best_time = time
                if best_time <= good_time:
                    return best
        return best

    def _time(self, path: np.ndarray, velocity: np.ndarray) -> float:
        """Travel time of a path (s), begun at a velocity (m/s)."""
        return travel.travel_time(
            self.clearance_map.wide, self.clearance_map.grid, path, len(path), velocity, self._pace
        )

    def _quickened(self, path: np.ndarray, velocity: np.ndarray, counter: np.ndarray) -> np.ndarray:
        """Path after stochastic local improvements that avoid `counter`."""
        clearance = self.clearance_map
        work, buffer = self._buffer
        if len(path) > len(work) - 2:
            return path
        work[: len(path)] = path
        count = travel.quicken(
            counter,
            clearance.wide,
            clearance.grid,
            self._config.flight_lower,
            self._config.flight_upper,
            work,
            len(path),
            velocity,
            self._pace,
            _TRIES,
            self.search.random,
            buffer,
        )
        return work[:count].copy()

    # ---- narrow passages --------------------------------------------------------------------------------------------
    def _widened(self, path: np.ndarray) -> np.ndarray:
        """The path, rerouted with the planner's radius where possible."""
        points = _samples(path)
        tight = [self._is_tight(point) for point in points]
        pieces: list[np.ndarray] = [points[:1]]
        done = 0  # index of the last point in `pieces`
        for i in range(1, len(points)):
            if tight[i] and i < len(points) - 1:
                continue  # within a narrow section
            if i > done + 1 and not tight[done]:
                pieces.append(self._around(points[done : i + 1]))
            else:
                pieces.append(points[done + 1 : i + 1])
            done = i
        return self._shortened(np.vstack(pieces))

    def _is_tight(self, point: np.ndarray) -> bool:
        voxel = voxel_of(self.clearance_map.grid, point[0], point[1], point[2])
        return voxel >= 0 and bool(self.clearance_map.wide[voxel] > 0)

    def _around(self, stretch: np.ndarray) -> np.ndarray:
        """Replacement of a narrow section, without its first point: a faster bypass, or the section itself."""
        config = self._config
        clearance = self.clearance_map
        lower = np.maximum(config.flight_lower, stretch.min(0) - _LOCAL_MARGIN)
        upper = np.minimum(config.flight_upper, stretch.max(0) + _LOCAL_MARGIN)
        if not self._is_tight(stretch[-1]):
            local = self._searches.content[1]
            ends = stretch[0], stretch[-1]
            vertices = local.search(clearance.wide, clearance.grid, *ends, lower, upper)
            bypass = checked_path(local, vertices)
            still = np.zeros(3)
            if len(bypass) and self._time(bypass, still) < self._time(stretch, still):
                return bypass[1:]
        return stretch[1:]

    def _shortened(self, path: np.ndarray) -> np.ndarray:
        """The path with collision-free straight shortcuts."""
        clearance = self.clearance_map
        work, buffer = self._buffer
        if len(path) > len(work) - 2:
            return path
        work[: len(path)] = path
        count = paths.shortcut_greedy(clearance.wide, clearance.grid, work, len(path))
        count = paths.shortcut_random(
            clearance.wide, clearance.grid, work, count, _SHORTCUTS, self.search.random, buffer
        )
        return work[:count].copy()


def _from(start: np.ndarray, path: np.ndarray) -> np.ndarray:
    """The path, extended to start exactly at `start`."""
    if paths.distance(path[0], start) <= 1e-6:
        return path
    return np.vstack([start, path])


def _samples(path: np.ndarray) -> np.ndarray:
    """Vertices of a path and intermediate points."""
    pieces = [path[:1]]
    for a, b in zip(path[:-1], path[1:], strict=True):
        steps = max(1, int(np.ceil(paths.distance(a, b) / _STRETCH_STEP)))
        pieces.append(a + (b - a) * (np.arange(1, steps + 1) / steps)[:, None])
    return np.vstack(pieces)
