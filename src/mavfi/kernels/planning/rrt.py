"""RRT (LaValle 1998): one tree grows from the start towards random samples, up to an iteration count."""

from typing import NamedTuple

import numpy as np

from mavfi.kernels.planning.nearest import PAYS_FROM, Index, clear, new_index, scan, search
from mavfi.kernels.planning.tree import draw_towards, steer, trace
from mavfi.numerics.jit import kernel_jit
from mavfi.numerics.voxels import Grid, segment_free


class Tree(NamedTuple):
    """Memory of the search.

    Attributes:
        nodes: Root first (m). Shape (n, 3).
        parents: Index of each node's parent; -1 = root. Shape (n,), int32.
        near: Index for nearest nodes.
    """

    nodes: np.ndarray
    parents: np.ndarray
    near: Index


def new_tree(nodes: int) -> Tree:
    """Memory for a number of nodes; iterations + 1 are sufficient."""
    return Tree(np.zeros((nodes, 3)), np.zeros(nodes, np.int32), new_index(nodes))


@kernel_jit
def plan(
    counter: np.ndarray,
    grid: Grid,
    start: np.ndarray,
    goal: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    max_step: float,
    goal_bias: float,
    iterations: int,
    random: np.ndarray,
    tree: Tree,
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
        goal_bias: Probability that the sample is the goal.
        iterations: Budget.
        random: Generator state. Shape (4,), uint64.
        tree: Search memory; overwritten. A full one ends the search.
        path: Output. Shape (>= nodes of the tree, 3).

    Returns:
        Number of vertices in `path`; 0 = none found.
    """
    if segment_free(counter, grid, start, goal):
        path[0] = start
        path[1] = goal
        return 2
    clear(tree.near, lower, upper)
    tree.nodes[0] = start
    tree.parents[0] = -1
    count = 1
    sample = np.empty(3)
    new = np.empty(3)
    for _ in range(iterations):
        if count >= tree.nodes.shape[0]:
            return 0
        is_goal = draw_towards(goal, goal_bias, lower, upper, random, sample)
        # passing the index costs more than scanning a small tree
        small = count < PAYS_FROM
        source = scan(tree.nodes, count, sample) if small else search(tree.near, tree.nodes, count, sample)
        reached = steer(tree.nodes[source], sample, max_step, new)
        if not segment_free(counter, grid, tree.nodes[source], new):
            continue
        for axis in range(3):
            tree.nodes[count, axis] = new[axis]
        tree.parents[count] = source
        count += 1
        if is_goal and reached:
            return trace(tree.nodes, tree.parents, count - 1, path)
    return 0
