"""Every compiled kernel with sound arguments; results and work space come last."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from mavfi.kernels.control import pid
from mavfi.kernels.perception import (
    clearance,
    collision_check,
    key_sets,
    octomap,
    octree,
    point_cloud,
    state_estimation,
)
from mavfi.kernels.perception.state_estimation import Noise, Spread
from mavfi.kernels.planning import (
    knots,
    minimum_snap,
    nearest,
    rrt,
    rrt_connect,
    rrt_star,
    time_allocation,
    trajectory,
    travel,
    tree,
    waypoint,
)
from mavfi.kernels.planning import path as paths
from mavfi.numerics.random import seed_generator
from mavfi.numerics.voxels import Grid, first_blocked, offsets_within, segment_free, voxel_of

GRID = Grid(-2.0, -2.0, 0.0, 2.0, 12, 10, 6)
LOWER, UPPER = np.array([-2.0, -2.0, 0.0]), np.array([4.0, 3.0, 3.0])
FRAME = octomap.KeyFrame(0.5, 0.25, 0.25, 0.25, -4, -4, 0, 12, 10, 6)
RULE = octomap.UpdateRule(*(octomap.log_odds(p) for p in (0.7, 0.4, 0.12, 0.97)))
GAINS = pid.Gains(np.full(3, 0.2), np.full(3, 0.1), np.full(3, 0.1), 1.0, 1.0, 0.4, 3.0, 10.0, 1.5)
PACE = travel.Pace(5.0, 1.0, 2.5, 3.5, 2.0)
LIMITS = trajectory.Limits(3.0, 1.0, 3.5, 2.5, 4.0, 2.0, 3.0)
SENSORS = Noise(2e-3, 9e-5, 1e-5, 1e-6, 0.05, 0.025)
ALIGNED = Spread(0.02, 0.01, 0.002, 0.0002)
CURVE_LIMITS = knots.CurveLimits(3.0, 4.5, 1.0, 3.5, 2.5, 4.0, 2.0, 1.5)
OFFSETS = offsets_within(0.8, 0.5, False)


@dataclass(frozen=True)
class Case:
    """A kernel, and a maker of fresh sound arguments."""

    function: Any
    arguments: Callable[[], list[Any]]


def blocked():
    counter = np.zeros(GRID.size, np.int16)
    counter[::7] = 1
    return counter


def points(count=8):
    rows = np.zeros((count, 11))
    rows[:, 0] = np.linspace(-1.5, 3.5, count)
    rows[:, 2] = 1.0
    rows[:, 4] = 2.0
    rows[:, 10] = 0.02
    return rows


def vertices(count, room):
    path = np.zeros((room, 3))
    path[:count] = np.linspace([-1.9, -1.9, 0.1], [3.9, 2.9, 2.9], count)
    path[1 : count - 1, 1] += 0.4
    return path


def path_of(count):
    return vertices(count, count)


def scan():
    cloud = np.random.default_rng(0).uniform(-4, 4, (20, 3)).astype(np.float32)
    state = np.zeros(720, np.float32), np.zeros(720, np.int32)
    return [cloud, np.array([0.1, 0.2, 1.0]), 6.0, FRAME, RULE, *state, 1, np.zeros(721, np.int32),
            np.zeros(720, np.float32)]  # fmt: skip


def nodes():
    """An octree in which a scan was stored."""
    tree = octree.new_octree(octree.largest_tree(FRAME))
    voxels = np.arange(0, 720, 7, dtype=np.int32)
    octree.update_voxels(tree, FRAME, RULE, voxels, 60, 0, np.zeros(len(voxels), np.float32))
    return tree


def node_updates():
    voxels = np.array([0, 1, 719, 300, 7, 14, 2**31 - 1, -(2**31)], np.int32)
    return [nodes(), FRAME, RULE, voxels, 4, 0, np.zeros(8, np.float32)]


def updates():
    counters = [GRID, np.zeros(GRID.size, np.uint8), np.zeros(GRID.size, np.int16), OFFSETS,
                np.zeros(GRID.size, np.int16), OFFSETS]  # fmt: skip
    voxels = np.array([0, -1, 719, 720, 300, 2**31 - 1, -(2**31)], np.int32)
    return [voxels, np.ones(7, np.float32), *counters, np.zeros(7, np.int32), np.zeros(7, np.uint8)]


def estimate():
    nominal = np.zeros(16)
    nominal[6] = 1.0
    return nominal


def curve(count=30):
    return np.linspace([-1.9, -1.9, 0.1], [3.9, 2.9, 2.9], count)


def timed_points():
    """Points, times, start and work space of a minimum-snap curve."""
    still = np.array([1.0, 0.0, 0.0]), np.zeros(3)
    return [path_of(5), np.full(4, 1.2), 5, *still, np.zeros((5, 3, 6)), np.zeros((5, 4, 3))]


def solved():
    """Ends and times of such a curve."""
    arguments = timed_points()
    minimum_snap.solve(*arguments)
    return [arguments[6], arguments[1]]


def planning_problem():
    ends = np.array([-1.9, -1.9, 0.7]), np.array([3.9, 2.9, 2.9])
    return [blocked(), GRID, *ends, LOWER.copy(), UPPER.copy()]


def nearest_in(nodes, target, lower, upper, search, *ball):
    """What a search in an index of all nodes finds."""
    index = nearest.new_index(len(nodes))
    nearest.clear(index, lower, upper)
    return search(index, nodes, len(nodes), target, *ball)


CASES = {
    "voxel_of": Case(voxel_of, lambda: [GRID, 0.3, 0.4, 0.5]),
    "first_blocked": Case(
        first_blocked,
        lambda: [blocked(), GRID, np.array([-1.9, -1.9, 0.1]), np.array([3.9, 2.9, 2.9]), True],
    ),
    "segment_free": Case(
        segment_free, lambda: [blocked(), GRID, np.array([-1.9, -1.9, 0.1]), np.array([3.9, 2.9, 2.9])]
    ),
    "back_project": Case(
        point_cloud.back_project,
        lambda: [
            np.ones(6, np.float32),
            np.full((6, 3), 0.6),
            np.eye(3),
            np.ones(3),
            20.0,
            np.zeros((6, 3), np.float32),
        ],
    ),
    "insert_scan": Case(
        octomap.insert_scan,
        scan,
    ),
    "collect": Case(
        key_sets.collect,
        lambda: [*scan()[:4], np.zeros(720, np.int32), 1, np.zeros(721, np.int32)],
    ),
    "update_voxels": Case(octree.update_voxels, node_updates),
    "search": Case(octree.search, lambda: [nodes(), 0, 0, 2]),
    "to_dense": Case(
        octree.to_dense,
        lambda: [nodes(), FRAME, np.zeros(720, np.float32)],
    ),
    "apply_updates": Case(
        clearance.apply_updates,
        updates,
    ),
    "time_to_collision": Case(
        collision_check.time_to_collision,
        lambda: [blocked(), GRID, np.zeros(3), points(), 1, 0.1, True],
    ),
    "known_free_distance": Case(
        collision_check.known_free_distance,
        lambda: [np.zeros(GRID.size, np.int16), np.ones(GRID.size, np.uint8), GRID, points(), 1, 5.0, 1, True],
    ),
    "nearest_scan": Case(nearest.scan, lambda: [np.ones((5, 3)), 5, np.zeros(3)]),
    "nearest_search": Case(
        lambda nodes, target, lower, upper: nearest_in(nodes, target, lower, upper, nearest.search),
        lambda: [curve(), np.zeros(3), LOWER.copy(), UPPER.copy()],
    ),
    "ball_scan": Case(nearest.scan_ball, lambda: [curve(), 30, np.zeros(3), 2.0, np.zeros(30, np.int32)]),
    "ball_search": Case(
        lambda nodes, target, lower, upper, radius, found: nearest_in(
            nodes, target, lower, upper, nearest.search_ball, radius, found
        ),
        lambda: [curve(), np.zeros(3), LOWER.copy(), UPPER.copy(), 2.0, np.zeros(30, np.int32)],
    ),
    "steer": Case(tree.steer, lambda: [np.zeros(3), np.ones(3), 0.5, np.zeros(3)]),
    "rrt": Case(
        rrt.plan,
        lambda: [*planning_problem(), 1.0, 0.05, 50, seed_generator(1), rrt.new_tree(51), np.zeros((51, 3))],
    ),
    "rrt_star": Case(
        rrt_star.plan,
        lambda: [
            *planning_problem(),
            1.0,
            0.05,
            400,
            800,
            seed_generator(1),
            rrt_star.new_tree(801),
            np.zeros((801, 3)),
        ],
    ),
    "rrt_connect": Case(
        rrt_connect.plan,
        lambda: [
            *planning_problem(),
            1.0,
            50,
            seed_generator(1),
            rrt_connect.new_trees(),
            np.zeros((2 * rrt_connect.NODE_LIMIT, 3)),
        ],
    ),
    "nearest_clear": Case(
        paths.nearest_clear,
        lambda: [
            blocked(),
            blocked(),
            blocked(),
            GRID,
            np.array([-1.9, -1.9, 0.1]),
            LOWER.copy(),
            UPPER.copy(),
            1.5,
            np.zeros(3),
        ],
    ),
    "shortcut_greedy": Case(paths.shortcut_greedy, lambda: [blocked(), GRID, path_of(6), 6]),
    "shortcut_random": Case(
        paths.shortcut_random,
        lambda: [blocked(), GRID, vertices(6, 12), 6, 20, seed_generator(2), np.zeros((12, 3))],
    ),
    "travel_time": Case(
        travel.travel_time,
        lambda: [blocked(), GRID, path_of(6), 6, np.ones(3), PACE],
    ),
    "quicken": Case(
        travel.quicken,
        lambda: [
            np.zeros(GRID.size, np.int16),
            blocked(),
            GRID,
            LOWER.copy(),
            UPPER.copy(),
            path_of(6),
            6,
            np.ones(3),
            PACE,
            20,
            seed_generator(2),
            np.zeros((6, 3)),
        ],
    ),
    "smooth": Case(
        trajectory.smooth,
        lambda: [
            np.zeros(GRID.size, np.int16),
            GRID,
            path_of(5),
            5,
            1.0,
            0.3,
            np.zeros((trajectory.CURVE_LIMIT, 3)),
            np.zeros((trajectory.CURVE_LIMIT, 3)),
        ],
    ),
    "speed_profile": Case(
        trajectory.speed_profile,
        lambda: [blocked(), GRID, curve(), 30, 1.0, LIMITS, np.zeros(30), np.zeros(30)],
    ),
    "sample": Case(
        trajectory.sample,
        lambda: [curve(), 30, np.linspace(0, 8.6, 30), np.full(30, 2.0), 0.02, 3.0, 0.0, np.zeros((400, 11))],
    ),
    "solve": Case(
        minimum_snap.solve,
        timed_points,
    ),
    "coefficients": Case(minimum_snap.coefficients, lambda: [solved()[0], 1, 1.2, np.zeros((8, 3))]),
    "peaks": Case(minimum_snap.peaks, lambda: [solved()[0], 1, 1.2]),
    "evaluate": Case(minimum_snap.evaluate, lambda: [np.ones((8, 3)), np.zeros(3), 1.2, 0.3, np.zeros(9)]),
    "sample of polynomials": Case(
        minimum_snap.sample, lambda: [*solved(), 5, 0.02, 3.0, 0.1, 1.5, np.zeros((400, 11))]
    ),
    "first_knots": Case(knots.first_knots, lambda: [path_of(5), 5, CURVE_LIMITS, knots.new_work()]),
    "fit": Case(
        time_allocation.fit,
        lambda: [
            np.zeros(GRID.size, np.int16),
            blocked(),
            GRID,
            path_of(5),
            5,
            np.array([1.0, 0.5, 0.0]),
            np.zeros(3),
            CURVE_LIMITS,
            knots.new_work(),
        ],
    ),
    "hold_points": Case(trajectory.hold_points, lambda: [points(50), 50, 25, 0.02, 15, np.zeros((400, 11))]),
    "advance_index": Case(waypoint.advance_index, lambda: [points(), 3, 0.0, np.zeros(11)]),
    "arc_lengths": Case(waypoint.arc_lengths, lambda: [points(), np.zeros(8)]),
    "advance_clock": Case(
        waypoint.advance_clock,
        lambda: [np.array([1.0, 0.5, 0.0]), points(), np.linspace(0, 5, 8), 0.02, 3.0, 4.0, 2.5, 0.5, 1.0],
    ),
    "reference": Case(waypoint.reference, lambda: [np.array([1.0, 0.5, 0.0]), points(), np.zeros(11)]),
    "align": Case(state_estimation.align, lambda: [np.ones(16), np.eye(15), np.ones(4), SENSORS, ALIGNED]),
    "turn": Case(state_estimation.turn, lambda: [np.array((1.0, 0.0, 0.0, 0.0)), 0.1, 0.2, 0.3]),
    "predict": Case(state_estimation.predict, lambda: [estimate(), np.eye(15), np.ones(6), 0.004, SENSORS]),
    "correct": Case(
        state_estimation.correct,
        lambda: [estimate(), np.eye(15), np.ones(4), SENSORS],
    ),
    "usable_sample": Case(state_estimation.usable_sample, lambda: [np.ones(6)]),
    "usable_fix": Case(state_estimation.usable_fix, lambda: [np.ones(4)]),
    "track": Case(pid.track, lambda: [np.ones(11), np.ones(13), np.zeros(pid.MEMORY_WIDTH), GAINS, 0.02, np.zeros(4)]),
}
