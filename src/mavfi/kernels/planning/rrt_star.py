"""RRT* (Karaman & Frazzoli 2011, algorithm 6): an RRT that maintains the cheapest known path to each node.

The near set is the ball of radius gamma (log n / n)^(1/3), at most the range; a new node takes the cheapest parent in
it, and becomes the parent of those nodes in it that are cheaper to reach through it.  Once reached, the goal is an
ordinary node, and is not drawn again.  Costs are sums along the tree in a fixed order and never grow, bit for bit.
"""

import math
from typing import NamedTuple

import numpy as np

from mavfi.kernels.planning.nearest import Index, ball, clear, nearest, new_index
from mavfi.kernels.planning.path import distance
from mavfi.kernels.planning.tree import draw, draw_towards, steer, trace
from mavfi.numerics.elementary import cbrt, log
from mavfi.numerics.jit import kernel_jit
from mavfi.numerics.voxels import Grid, segment_free

_MARGIN = 1.1
"""gamma / its lower bound (Karaman & Frazzoli 2011, theorem 38)."""
_UNKNOWN, _FREE, _BLOCKED = 0, 1, 2


class CostTree(NamedTuple):
    """Memory of the search.

    Attributes:
        nodes: Root first (m). Shape (n, 3).
        parents: Index of each node's parent; -1 = root. Shape (n,), int32.
        costs: Length of the path from the root (m). Shape (n,).
        child: First child of each node; -1 = none. Shape (n,), int32.
        sibling: Next child of the same parent; -1 = none. Shape (n,), int32.
        near: Index of nodes by position.
        ball: Near set of the new node. Shape (n,), int32.
        through: Cost of the new node through each of them (m). Shape (n,).
        edges: Whether the edge to each of them is free, if known. Shape (n,), int8.
        stack: Nodes whose descendants are still to be updated. Shape (n,), int32.
        state: Number of nodes, goal node or -1, completed iterations. Shape (3,), int64.
    """

    nodes: np.ndarray
    parents: np.ndarray
    costs: np.ndarray
    child: np.ndarray
    sibling: np.ndarray
    near: Index
    ball: np.ndarray
    through: np.ndarray
    edges: np.ndarray
    stack: np.ndarray
    state: np.ndarray


def new_tree(nodes: int) -> CostTree:
    """Memory for a number of nodes; iterations + 1 are sufficient."""
    whole = [np.zeros(nodes, np.int32) for _ in range(5)]
    return CostTree(
        np.zeros((nodes, 3)),
        whole[0],
        np.zeros(nodes),
        whole[1],
        whole[2],
        new_index(nodes),
        whole[3],
        np.zeros(nodes),
        np.zeros(nodes, np.int8),
        whole[4],
        np.zeros(3, np.int64),
    )


@kernel_jit
def ball_factor(lower: np.ndarray, upper: np.ndarray) -> float:
    """Gamma for a sampled box: 1.1 (2 (1 + 1/d) volume / volume of the unit ball)^(1/d) with d = 3 (m)."""
    volume = abs((upper[0] - lower[0]) * (upper[1] - lower[1]) * (upper[2] - lower[2]))
    return float(_MARGIN * cbrt(2.0 * (1.0 + 1.0 / 3.0) * volume / (4.0 / 3.0 * math.pi)))


@kernel_jit
def plant(tree: CostTree, start: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> None:
    """Reset the tree to its root."""
    clear(tree.near, lower, upper)
    for axis in range(3):
        tree.nodes[0, axis] = start[axis]
    tree.parents[0] = -1
    tree.costs[0] = 0.0
    tree.child[0] = -1
    tree.sibling[0] = -1
    tree.state[0] = 1
    tree.state[1] = -1
    tree.state[2] = 0


@kernel_jit
def _before(near: np.ndarray, through: np.ndarray, a: int, b: int) -> bool:
    """Order of the near set: by cost of the new node through it; for equal costs the older node first."""
    if through[a] != through[b]:
        return bool(through[a] < through[b])
    return bool(near[a] < near[b])


@kernel_jit
def _swap(near: np.ndarray, through: np.ndarray, a: int, b: int) -> None:
    node = near[a]
    near[a] = near[b]
    near[b] = node
    cost = through[a]
    through[a] = through[b]
    through[b] = cost


@kernel_jit
def _sift(near: np.ndarray, through: np.ndarray, top: int, end: int) -> None:
    """Sift an entry down the heap."""
    while 2 * top + 1 < end:
        later = 2 * top + 1
        if later + 1 < end and _before(near, through, later, later + 1):
            later += 1
        if not _before(near, through, top, later):
            return
        _swap(near, through, top, later)
        top = later


@kernel_jit
def _sort(near: np.ndarray, through: np.ndarray, size: int) -> None:
    """Heap sort of the near set: in place, without a slow worst case."""
    for top in range(size // 2 - 1, -1, -1):
        _sift(near, through, top, size)
    for end in range(size - 1, 0, -1):
        _swap(near, through, 0, end)
        _sift(near, through, 0, end)


@kernel_jit
def _attach(tree: CostTree, node: int, parent: int) -> None:
    """Make a node a child of a parent, and set its cost to that through the parent."""
    tree.parents[node] = parent
    tree.costs[node] = tree.costs[parent] + distance(tree.nodes[parent], tree.nodes[node])
    tree.sibling[node] = tree.child[parent]
    tree.child[parent] = node


@kernel_jit
def _detach(tree: CostTree, node: int) -> None:
    """Remove a node from its parent's children."""
    parent = tree.parents[node]
    if tree.child[parent] == node:
        tree.child[parent] = tree.sibling[node]
        return
    other = tree.child[parent]
    while tree.sibling[other] != node:
        other = tree.sibling[other]
    tree.sibling[other] = tree.sibling[node]


@kernel_jit
def _pass_on(tree: CostTree, node: int) -> None:
    """Update the costs of all descendants."""
    tree.stack[0] = node
    size = 1
    while size > 0:
        size -= 1
        parent = tree.stack[size]
        child = tree.child[parent]
        while child >= 0:
            tree.costs[child] = tree.costs[parent] + distance(tree.nodes[parent], tree.nodes[child])
            tree.stack[size] = child
            size += 1
            child = tree.sibling[child]


@kernel_jit
def _choose_parent(counter: np.ndarray, grid: Grid, tree: CostTree, new: int, nearest_node: int, size: int) -> None:
    """Attach the new node to the cheapest node of its near set with a free edge."""
    parent = nearest_node
    limit = tree.costs[nearest_node] + distance(tree.nodes[nearest_node], tree.nodes[new])
    for i in range(size):
        other = tree.ball[i]
        if not tree.through[i] < limit:
            break
        free = segment_free(counter, grid, tree.nodes[other], tree.nodes[new])
        tree.edges[i] = _FREE if free else _BLOCKED
        if free:
            parent = other
            break
    _attach(tree, new, parent)


@kernel_jit
def _rewire(counter: np.ndarray, grid: Grid, tree: CostTree, new: int, size: int) -> None:
    """Reroute nodes of the near set through the new node if that makes them cheaper to reach."""
    for i in range(size):
        other = tree.ball[i]
        if tree.edges[i] == _BLOCKED:
            continue
        if not tree.costs[new] + distance(tree.nodes[new], tree.nodes[other]) < tree.costs[other]:
            continue
        if tree.edges[i] == _FREE or segment_free(counter, grid, tree.nodes[new], tree.nodes[other]):
            _detach(tree, other)
            _attach(tree, other, new)
            _pass_on(tree, other)


@kernel_jit
def _insert(counter: np.ndarray, grid: Grid, tree: CostTree, new: np.ndarray, nearest_node: int, radius: float) -> None:
    """Add a node whose edge from its nearest node is free."""
    index = tree.state[0]
    size = ball(tree.near, tree.nodes, index, new, radius, tree.ball)
    for i in range(size):
        tree.through[i] = tree.costs[tree.ball[i]] + distance(tree.nodes[tree.ball[i]], new)
        tree.edges[i] = _UNKNOWN
    _sort(tree.ball, tree.through, size)
    for axis in range(3):
        tree.nodes[index, axis] = new[axis]
    tree.child[index] = -1
    _choose_parent(counter, grid, tree, index, nearest_node, size)
    tree.state[0] = index + 1
    _rewire(counter, grid, tree, index, size)


@kernel_jit
def grow(
    counter: np.ndarray,
    grid: Grid,
    goal: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    max_step: float,
    goal_bias: float,
    iterations: int,
    random: np.ndarray,
    tree: CostTree,
) -> None:
    """Grow a tree by a number of iterations. Arguments as for `plan`."""
    sample = np.empty(3)
    new = np.empty(3)
    gamma = ball_factor(lower, upper)
    for _ in range(iterations):
        count = tree.state[0]
        if count >= tree.nodes.shape[0]:
            return
        tree.state[2] += 1
        is_goal = False
        if tree.state[1] < 0:
            is_goal = draw_towards(goal, goal_bias, lower, upper, random, sample)
        else:
            draw(lower, upper, random, sample)
        source = nearest(tree.near, tree.nodes, count, sample)
        reached = steer(tree.nodes[source], sample, max_step, new)
        if distance(tree.nodes[source], new) == 0.0 or not segment_free(counter, grid, tree.nodes[source], new):
            continue
        radius = min(max_step, gamma * cbrt(log(count + 1.0) / (count + 1.0)))
        _insert(counter, grid, tree, new, source, radius)
        if is_goal and reached:
            tree.state[1] = count


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
    longest: int,
    random: np.ndarray,
    tree: CostTree,
    path: np.ndarray,
) -> int:
    """Find a short path: the best one after the budget.

    Args:
        counter: > 0 = blocked. Shape (grid.size,).
        grid: Geometry.
        start: World frame (m). Shape (3,).
        goal: World frame (m). Shape (3,).
        lower: Corner of the sampled box (m). Shape (3,).
        upper: Opposite corner (m). Shape (3,).
        max_step: Longest extension, and largest radius of the near set (m).
        goal_bias: Probability that the sample is the goal, until it is in the tree.
        iterations: Budget.
        longest: Without a path after the budget, the search continues up to the first one, at most to this iteration.
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
    plant(tree, start, lower, upper)
    grow(counter, grid, goal, lower, upper, max_step, goal_bias, iterations, random, tree)
    for _ in range(longest - iterations):
        if tree.state[1] >= 0:
            break
        grow(counter, grid, goal, lower, upper, max_step, goal_bias, 1, random, tree)
    if tree.state[1] < 0:
        return 0
    return trace(tree.nodes, tree.parents, tree.state[1], path)
