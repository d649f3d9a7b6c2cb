"""RRT-Connect (Kuffner & LaValle 2000): two trees that grow towards each other. Stops on an iteration count."""

import math
from typing import NamedTuple

import numpy as np

from mavfi.numerics.jit import kernel_jit
from mavfi.numerics.random import uniform
from mavfi.numerics.voxels import Grid, segment_free

NODE_LIMIT = 8000


class Trees(NamedTuple):
    """Memory of the search: nodes (NODE_LIMIT, 3) and parents (NODE_LIMIT,) of both trees.

    Attributes:
        nodes: Shape (2, NODE_LIMIT, 3), m.
        parents: Shape (2, NODE_LIMIT), int32; -1 = root.
        counts: Nodes in use. Shape (2,), int64.
    """

    nodes: np.ndarray
    parents: np.ndarray
    counts: np.ndarray


def new_trees() -> Trees:
    """Empty search memory."""
    return Trees(np.zeros((2, NODE_LIMIT, 3)), np.zeros((2, NODE_LIMIT), np.int32), np.zeros(2, np.int64))


@kernel_jit
def nearest(nodes: np.ndarray, count: int, target: np.ndarray) -> int:
    """Index of the node nearest to a point (linear scan)."""
    best = 0
    best_square = np.inf
    for i in range(count):
        dx = nodes[i, 0] - target[0]
        dy = nodes[i, 1] - target[1]
        dz = nodes[i, 2] - target[2]
        square = dx * dx + dy * dy + dz * dz
        if square < best_square:
            best_square = square
            best = i
    return best


@kernel_jit
def steer(source: np.ndarray, target: np.ndarray, max_step: float, result: np.ndarray) -> bool:
    """Point at most `max_step` from `source` towards `target`; returns whether it is the target itself."""
    distance = math.sqrt((target[0] - source[0]) ** 2 + (target[1] - source[1]) ** 2 + (target[2] - source[2]) ** 2)
    share = 1.0 if distance <= max_step else max_step / distance
    for axis in range(3):
        result[axis] = source[axis] + (target[axis] - source[axis]) * share
    if share == 1.0:
        for axis in range(3):
            result[axis] = target[axis]
        return True
    return False


@kernel_jit
def _extend(
    counter: np.ndarray, grid: Grid, trees: Trees, which: int, source: int, target: np.ndarray, max_step: float,
    new: np.ndarray,
) -> int:  # fmt: skip
    """Add one node to a tree: 0 = trapped, 1 = advanced, 2 = reached the target."""
    reached = steer(trees.nodes[which, source], target, max_step, new)
    if not segment_free(counter, grid, trees.nodes[which, source], new):
        return 0
    index = trees.counts[which]
    for axis in range(3):
        trees.nodes[which, index, axis] = new[axis]
    trees.parents[which, index] = source
    trees.counts[which] = index + 1
    return 2 if reached else 1


@kernel_jit
def _collect(trees: Trees, from_start: int, from_goal: int, path: np.ndarray) -> int:
    """Path through both trees; the joint is in both and kept once."""
    count = 0
    node = from_start
    while node >= 0:
        path[count] = trees.nodes[0, node]
        count += 1
        node = trees.parents[0, node]
    for i in range(count // 2):
        for axis in range(3):
            swap = path[i, axis]
            path[i, axis] = path[count - 1 - i, axis]
            path[count - 1 - i, axis] = swap
    node = trees.parents[1, from_goal]
    while node >= 0:
        path[count] = trees.nodes[1, node]
        count += 1
        node = trees.parents[1, node]
    return count


@kernel_jit
def _plant(trees: Trees, start: np.ndarray, goal: np.ndarray) -> None:
    """Make both trees consist of their root."""
    for axis in range(3):
        trees.nodes[0, 0, axis] = start[axis]
        trees.nodes[1, 0, axis] = goal[axis]
    for which in range(2):
        trees.parents[which, 0] = -1
        trees.counts[which] = 1


@kernel_jit
def plan(
    counter: np.ndarray, grid: Grid, start: np.ndarray, goal: np.ndarray, lower: np.ndarray, upper: np.ndarray,
    max_step: float, iterations: int, random: np.ndarray, trees: Trees, path: np.ndarray,
) -> int:  # fmt: skip
    """Find a path.

    Args:
        counter: > 0 = blocked. Shape (grid.size,).
        grid: Geometry.
        start: World frame (m). Shape (3,).
        goal: Same.
        lower: Corner of the sampled box (m). Shape (3,).
        upper: Same.
        max_step: Longest extension (m).
        iterations: Budget.
        random: Generator state. Shape (4,), uint64.
        trees: Search memory; overwritten.
        path: Result. Shape (2 * NODE_LIMIT, 3).

    Returns:
        Number of vertices in `path`; 0 = none found.
    """
    if segment_free(counter, grid, start, goal):
        path[0] = start
        path[1] = goal
        return 2
    _plant(trees, start, goal)
    sample = np.empty(3)
    new = np.empty(3)
    joint = np.empty(3)
    which = 0
    for _ in range(iterations):
        for axis in range(3):
            sample[axis] = lower[axis] + (upper[axis] - lower[axis]) * uniform(random)
        source = nearest(trees.nodes[which], trees.counts[which], sample)
        if _extend(counter, grid, trees, which, source, sample, max_step, new) > 0:
            other = 1 - which
            source = nearest(trees.nodes[other], trees.counts[other], new)
            result = 1
            while result == 1 and trees.counts[other] < NODE_LIMIT:
                result = _extend(counter, grid, trees, other, source, new, max_step, joint)
                source = trees.counts[other] - 1
            if result == 2:
                ends = (trees.counts[which] - 1, trees.counts[other] - 1)
                if which == 0:
                    return _collect(trees, ends[0], ends[1], path)
                return _collect(trees, ends[1], ends[0], path)
        if trees.counts[0] >= NODE_LIMIT - 1 or trees.counts[1] >= NODE_LIMIT - 1:
            return 0
        which = 1 - which
    return 0
