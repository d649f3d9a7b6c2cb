"""RRT-Connect (Kuffner & LaValle 2000): two trees grow towards each other, up to an iteration count."""

from typing import NamedTuple

import numpy as np

from mavfi.kernels.planning.nearest import PAYS_FROM, Index, clear, new_index, scan, search
from mavfi.kernels.planning.tree import draw, steer, trace
from mavfi.numerics.jit import kernel_jit
from mavfi.numerics.voxels import Grid, segment_free

NODE_LIMIT = 8000


class Trees(NamedTuple):
    """Memory of the search: the trees from start and goal.

    Attributes:
        nodes: Shape (2, NODE_LIMIT, 3), m.
        parents: Shape (2, NODE_LIMIT), int32; -1 = root.
        counts: Nodes in use. Shape (2,), int64.
        near_start: Index for nearest nodes of the first tree.
        near_goal: Index for nearest nodes of the second tree.
    """

    nodes: np.ndarray
    parents: np.ndarray
    counts: np.ndarray
    near_start: Index
    near_goal: Index


def new_trees() -> Trees:
    """Empty search memory."""
    return Trees(
        np.zeros((2, NODE_LIMIT, 3)),
        np.zeros((2, NODE_LIMIT), np.int32),
        np.zeros(2, np.int64),
        new_index(NODE_LIMIT),
        new_index(NODE_LIMIT),
    )


@kernel_jit
def _search(trees: Trees, which: int, target: np.ndarray) -> int:
    """Index of the node of a large tree nearest to a point."""
    if which == 0:
        return search(trees.near_start, trees.nodes[0], trees.counts[0], target)
    return search(trees.near_goal, trees.nodes[1], trees.counts[1], target)


@kernel_jit
def _extend(
    counter: np.ndarray,
    grid: Grid,
    nodes: np.ndarray,
    parents: np.ndarray,
    counts: np.ndarray,
    which: int,
    source: int,
    target: np.ndarray,
    max_step: float,
    new: np.ndarray,
) -> int:
    """Add one node to a tree: 0 = trapped, 1 = advanced, 2 = reached the target."""
    reached = steer(nodes[which, source], target, max_step, new)
    if not segment_free(counter, grid, nodes[which, source], new):
        return 0
    index = counts[which]
    for axis in range(3):
        nodes[which, index, axis] = new[axis]
    parents[which, index] = source
    counts[which] = index + 1
    return 2 if reached else 1


@kernel_jit
def _collect(trees: Trees, from_start: int, from_goal: int, path: np.ndarray) -> int:
    """Path through both trees; their common vertex is included once."""
    count = trace(trees.nodes[0], trees.parents[0], from_start, path)
    node = trees.parents[1, from_goal]
    while node >= 0:
        path[count] = trees.nodes[1, node]
        count += 1
        node = trees.parents[1, node]
    return count


@kernel_jit
def _plant(trees: Trees, start: np.ndarray, goal: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> None:
    """Reset both trees to their root."""
    clear(trees.near_start, lower, upper)
    clear(trees.near_goal, lower, upper)
    for axis in range(3):
        trees.nodes[0, 0, axis] = start[axis]
        trees.nodes[1, 0, axis] = goal[axis]
    for which in range(2):
        trees.parents[which, 0] = -1
        trees.counts[which] = 1


@kernel_jit
def plan(
    counter: np.ndarray,
    grid: Grid,
    start: np.ndarray,
    goal: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    max_step: float,
    iterations: int,
    random: np.ndarray,
    trees: Trees,
    path: np.ndarray,
) -> int:
    """Find a path.

    Args:
        counter: > 0 = blocked. Shape (grid.size,).
        grid: Geometry.
        start: World frame (m). Shape (3,).
        goal: World frame (m). Shape (3,).
        lower: Corner of the sampled box (m). Shape (3,).
        upper: Opposite corner (m). Shape (3,).
        max_step: Longest extension (m).
        iterations: Budget.
        random: Generator state. Shape (4,), uint64.
        trees: Search memory; overwritten.
        path: Output. Shape (2 * NODE_LIMIT, 3).

    Returns:
        Number of vertices in `path`; 0 = none found.
    """
    if segment_free(counter, grid, start, goal):
        path[0] = start
        path[1] = goal
        return 2
    _plant(trees, start, goal, lower, upper)
    # separate arrays: passing all of `trees` to a function costs more than scanning a small tree
    nodes, parents, counts = trees.nodes, trees.parents, trees.counts
    sample = np.empty(3)
    new = np.empty(3)
    joint = np.empty(3)
    which = 0
    for _ in range(iterations):
        draw(lower, upper, random, sample)
        small = counts[which] < PAYS_FROM
        source = scan(nodes[which], counts[which], sample) if small else _search(trees, which, sample)
        if _extend(counter, grid, nodes, parents, counts, which, source, sample, max_step, new) > 0:
            other = 1 - which
            small = counts[other] < PAYS_FROM
            source = scan(nodes[other], counts[other], new) if small else _search(trees, other, new)
            result = 1
            while result == 1 and counts[other] < NODE_LIMIT:
                result = _extend(counter, grid, nodes, parents, counts, other, source, new, max_step, joint)
                source = counts[other] - 1
            if result == 2:
                ends = (counts[which] - 1, counts[other] - 1)
                if which == 0:
                    return _collect(trees, ends[0], ends[1], path)
                return _collect(trees, ends[1], ends[0], path)
        if counts[0] >= NODE_LIMIT - 1 or counts[1] >= NODE_LIMIT - 1:
            return 0
        which = 1 - which
    return 0
