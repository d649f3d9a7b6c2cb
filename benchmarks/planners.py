"""Planners of mavfi and OMPL on the same problems: maps, segment validity, range, goal bias, number of samples.

OMPL (Sucan, Moll & Kavraki 2012) is configured to match mavfi: shrinking ball instead of k nearest neighbours in RRT*,
no path simplification.  It validates segments by a Python function, which costs time; a second configuration, common
when OMPL is used from Python, validates discrete states along a segment instead.
"""

import time
from functools import cache
from importlib.util import find_spec
from statistics import median
from typing import Any, NamedTuple

import numpy as np

from benchmarks.rows import Row
from mavfi.config import EnvironmentConfig, shipped
from mavfi.kernels.planning import nearest, rrt, rrt_connect, rrt_star
from mavfi.kernels.planning import path as paths
from mavfi.numerics.jit import kernel_jit
from mavfi.numerics.random import seed_generator
from mavfi.numerics.voxels import Grid, segment_free, voxel_of
from mavfi.sim.environments import build_world

NAMES = ("rrt", "rrt_connect", "rrt_star")
ROOM = 0.8
"""Clearance of planned paths (m)."""
GOAL_BIAS = 0.05
MOST_NODES = 20_000
RUNS = 60
NODES = (1000, 5000, 10_000, 20_000)
TARGETS = {"rrt_connect": 14.0}
"""Target speed-up over OMPL."""
_STATE_SPACING = 0.25
"""Spacing of validated states along a segment in OMPL's second configuration (m): half a voxel."""


class Problem(NamedTuple):
    """A clearance map, start and goal without line of sight, and the sampled box."""

    counter: np.ndarray
    grid: Grid
    start: np.ndarray
    goal: np.ndarray
    lower: np.ndarray
    upper: np.ndarray


class Search(NamedTuple):
    """Range (m) and number of samples of a search."""

    max_step: float
    iterations: int


class Found(NamedTuple):
    """Length of the path (m), infinite if none; wall time (s); samples, and validity checks made through Python."""

    length: float
    seconds: float
    samples: int
    checks: int = 0


@cache
def problem(environment: str, seed: int, resolution: float = 0.5) -> Problem:
    """A complete generated world as a map.

    Raises:
        ValueError: The problem is trivial: start and goal are in line of sight.
    """
    world = build_world(shipped("environments", EnvironmentConfig, environment), seed)
    shape = np.ceil((world.arena_upper - world.arena_lower) / resolution).astype(int)
    (x, y, z), (nx, ny, nz) = map(float, world.arena_lower), map(int, shape)
    grid = Grid(x, y, z, 1.0 / resolution, nx, ny, nz)
    axes = [low + resolution * (np.arange(n) + 0.5) for low, n in zip(world.arena_lower, shape, strict=True)]
    centres = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    counter = (world.clearance(centres) < ROOM).astype(np.int16)
    made = Problem(counter, grid, world.start, world.goal, world.flight_lower, world.flight_upper)
    if segment_free(counter, grid, made.start, made.goal):
        raise ValueError(f"{environment} {seed}: the goal can be seen from the start")
    return made


@cache
def _memory(name: str) -> tuple[Any, np.ndarray]:
    """Working memory of a search, and a buffer for a path."""
    if name == "rrt_connect":
        return rrt_connect.new_trees(), np.zeros((2 * rrt_connect.NODE_LIMIT, 3))
    kernel = rrt if name == "rrt" else rrt_star
    return kernel.new_tree(MOST_NODES + 1), np.zeros((MOST_NODES + 1, 3))


def ours(name: str, given: Problem, search: Search, seed: int) -> Found:
    """One run of a mavfi planner, without shortcuts."""
    memory, path = _memory(name)
    random = seed_generator(seed)
    start = time.perf_counter()
    if name == "rrt":
        count = rrt.plan(*given, search.max_step, GOAL_BIAS, search.iterations, random, memory, path)
    elif name == "rrt_connect":
        count = rrt_connect.plan(*given, search.max_step, search.iterations, random, memory, path)
    else:
        budget = search.iterations, search.iterations
        count = rrt_star.plan(*given, search.max_step, GOAL_BIAS, *budget, random, memory, path)
    seconds = time.perf_counter() - start
    return Found(paths.path_length(path, count) if count else np.inf, seconds, search.iterations)


@cache
def _space(given: str, seed: int, by_states: bool) -> Any:
    """OMPL's space with mavfi's validity check; cached per problem, as validator and space reference each other.

    The last element is a list whose first entry counts the checks.
    """
    from ompl import base

    counter, grid, _, _, lower, upper = problem(given, seed)
    space = base.RealVectorStateSpace(3)
    bounds = base.RealVectorBounds(3)
    for axis in range(3):
        bounds.setLow(axis, float(lower[axis]))
        bounds.setHigh(axis, float(upper[axis]))
    space.setBounds(bounds)
    information = base.SpaceInformation(space)
    ends = np.empty((2, 3))
    checks = [0]

    def state_free(state: Any) -> bool:
        checks[0] += 1
        voxel = voxel_of(grid, state[0], state[1], state[2])
        return voxel >= 0 and bool(counter[voxel] <= 0)

    if by_states:
        information.setStateValidityChecker(state_free)
        information.setStateValidityCheckingResolution(_STATE_SPACING / space.getMaximumExtent())
        information.setup()
        return space, information, None, checks

    class Segments(base.MotionValidator):
        def checkMotion(self, first: Any, second: Any) -> bool:  # noqa: N802
            checks[0] += 1
            ends[0] = first[0], first[1], first[2]
            ends[1] = second[0], second[1], second[2]
            return segment_free(counter, grid, ends[0], ends[1])

    validator = Segments(information)
    information.setMotionValidator(validator)
    information.setStateValidityChecker(lambda state: True)
    information.setup()
    return space, information, validator, checks


def theirs(name: str, environment: str, world: int, search: Search, seed: int, by_states: bool = False) -> Found:
    """One run of OMPL's planner on the same problem; `by_states` = it validates states along a segment."""
    from ompl import base, geometric, util

    util.setLogLevel(util.LOG_NONE)
    util.RNG.setSeed(seed + 1)
    given = problem(environment, world)
    space, information, _, checks = _space(environment, world, by_states)
    definition = base.ProblemDefinition(information)
    ends = [space.allocState(), space.allocState()]
    for axis in range(3):
        ends[0][axis], ends[1][axis] = float(given.start[axis]), float(given.goal[axis])
    definition.setStartAndGoalStates(ends[0], ends[1])
    planner = {"rrt": geometric.RRT, "rrt_connect": geometric.RRTConnect, "rrt_star": geometric.RRTstar}[name](
        information
    )
    planner.setRange(search.max_step)
    if name != "rrt_connect":
        planner.setGoalBias(GOAL_BIAS)
    if name == "rrt_star":
        planner.setKNearest(False)
        planner.setRewireFactor(1.1)
    planner.setProblemDefinition(definition)
    planner.setup()
    asked = [0]

    def enough() -> bool:
        asked[0] += 1
        return asked[0] > search.iterations

    checks[0] = 0
    start = time.perf_counter()
    planner.solve(base.PlannerTerminationCondition(enough))
    seconds = time.perf_counter() - start
    exact = definition.hasExactSolution()
    return Found(definition.getSolutionPath().length() if exact else np.inf, seconds, asked[0] - 1, checks[0])


def check_cost(environment: str, by_states: bool) -> float:
    """Minimum cost of one validity check called from OMPL through Python, on a short segment or a state (s)."""
    given = problem(environment, 0)
    space, information, validator, _ = _space(environment, 0, by_states)
    state = space.allocState()
    for axis in range(3):
        state[axis] = float(given.start[axis])
    best = np.inf
    for _ in range(5):
        start = time.perf_counter()
        for _ in range(1000):
            information.isValid(state) if by_states else validator.checkMotion(state, state)
        best = min(best, time.perf_counter() - start)
    return best / 1000


def search_rows() -> list[Row]:
    """Wall time of one search without shortcuts, and of OMPL's, if installed, in both configurations."""
    budgets = {"rrt": Search(4.0, 10_000), "rrt_connect": Search(4.0, 4000), "rrt_star": Search(8.0, 1500)}
    rows = []
    for environment in ("dense", "factory"):
        given = problem(environment, 0)
        for name, search in budgets.items():
            ours(name, given, search, 0)
            own = median(ours(name, given, search, seed).seconds for seed in range(RUNS))
            what = f"{name}, {environment}, median of {RUNS}"
            if not find_spec("ompl"):
                rows.append(Row(what, f"{1e3 * own:.3f} ms; OMPL is not installed"))
                continue
            ways = (False,) if name == "rrt_star" else (False, True)
            rows += [_against_ompl(what, name, environment, search, own, by_states) for by_states in ways]
    return rows


def _against_ompl(what: str, name: str, environment: str, search: Search, own: float, by_states: bool) -> Row:
    """Wall time (s) of mavfi and OMPL, and the share of the latter spent in checks called through Python."""
    runs = [theirs(name, environment, 0, search, seed, by_states) for seed in range(RUNS)]
    other, checks = median(run.seconds for run in runs), median(run.checks for run in runs)
    spent = checks * check_cost(environment, by_states)
    kind = "states" if by_states else "segments"
    value = (
        f"{1e3 * own:.3f} ms; OMPL {1e3 * other:.3f} ms, {other / own:.1f} x; {checks:.0f} checks of {kind} by a "
        f"Python function took at least {1e3 * spent:.3f} ms of that"
    )
    return Row(f"{what}, OMPL checks {kind}", value, other / own, TARGETS.get(name))


@kernel_jit
def _find_all(index: nearest.Index, nodes: np.ndarray, targets: np.ndarray, scan: bool) -> int:
    total = 0
    for i in range(targets.shape[0]):
        if scan:
            total += nearest.scan(nodes, nodes.shape[0], targets[i])
        else:
            total += nearest.search(index, nodes, nodes.shape[0], targets[i])
    return total


def nearest_rows() -> list[Row]:
    """Time of one nearest-node query, by linear scan and by index, for nodes spread over a flight volume."""
    random = np.random.default_rng(0)
    _, _, _, _, lower, upper = problem("dense", 0)
    targets = random.uniform(lower, upper, (1000, 3))
    rows = []
    for count in NODES:
        nodes = random.uniform(lower, upper, (count, 3))
        index = nearest.new_index(count)
        nearest.clear(index, lower, upper)
        times = []
        for scan in (True, False):
            _find_all(index, nodes, targets, scan)  # compiles, and inserts the nodes
            spent = []
            for _ in range(5):
                start = time.perf_counter()
                _find_all(index, nodes, targets, scan)
                spent.append(time.perf_counter() - start)
            times.append(1e6 * min(spent) / len(targets))
        text = f"scan {times[0]:.2f} us, index {times[1]:.2f} us, {times[0] / times[1]:.1f} x"
        rows.append(Row(f"nearest of {count} nodes", text))
    return rows
