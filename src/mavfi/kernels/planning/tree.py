"""Common parts of the searches: drawing a sample, one step towards it, the path to a node."""

import math

import numpy as np

from mavfi.numerics.jit import kernel_jit
from mavfi.numerics.random import uniform


@kernel_jit
def draw(lower: np.ndarray, upper: np.ndarray, random: np.ndarray, sample: np.ndarray) -> None:
    """Uniform sample of a box.

    Args:
        lower: Corner (m). Shape (3,).
        upper: Opposite corner (m). Shape (3,).
        random: Generator state. Shape (4,), uint64.
        sample: Output (m). Shape (3,).
    """
    for axis in range(3):
        sample[axis] = lower[axis] + (upper[axis] - lower[axis]) * uniform(random)


@kernel_jit
def draw_towards(
    goal: np.ndarray, goal_bias: float, lower: np.ndarray, upper: np.ndarray, random: np.ndarray, sample: np.ndarray
) -> bool:
    """The goal with probability `goal_bias`, else a uniform sample; returns whether it is the goal."""
    if uniform(random) < goal_bias:
        for axis in range(3):
            sample[axis] = goal[axis]
        return True
    draw(lower, upper, random, sample)
    return False


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
def trace(nodes: np.ndarray, parents: np.ndarray, node: int, path: np.ndarray) -> int:
    """Vertices from the root of a tree to a node.

    Args:
        nodes: World frame (m). Shape (n, 3).
        parents: Index of the parent of each node; -1 = root. Shape (n,), int32.
        node: Where the path ends.
        path: Output. Shape (>= n, 3).

    Returns:
        Number of vertices.
    """
    count = 0
    while node >= 0:
        for axis in range(3):
            path[count, axis] = nodes[node, axis]
        count += 1
        node = parents[node]
    for i in range(count // 2):
        for axis in range(3):
            swap = path[i, axis]
            path[i, axis] = path[count - 1 - i, axis]
            path[count - 1 - i, axis] = swap
    return count
