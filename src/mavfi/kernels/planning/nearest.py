"""Nearest node, and nodes in a ball, among those of a search tree: linear scan, and an index that grows with the tree.

The index is a k-d tree that halves its cells (Samet 2006, section 1.5), so that its depth does not depend on the order
of insertion: each cell holds one node, later ones go to its halves.  Results equal those of the scan, including ties:
of nodes at the same distance the one added first.  The distances used for pruning cells (Arya & Mount 1993) are sums of
the same form as those of nodes, so rounding cannot make them too large.
"""

import math
from typing import NamedTuple

import numpy as np

from mavfi.numerics.jit import kernel_jit

PAYS_FROM = 256
"""Number of nodes from which the index is faster than the scan."""


class Index(NamedTuple):
    """Memory of the index; a cell has the number of its node.

    Attributes:
        box: Corners of the sampled box (m). Shape (2, 3).
        cell: Cell of the node being inserted (m). Shape (2, 3).
        axis: Axis along which each cell is halved. Shape (n,), int8.
        split: Coordinate of the split (m). Shape (n,).
        halves: Cell below and cell above; -1 = none. Shape (n, 2), int32.
        size: Number of nodes in the index. Shape (1,), int64.
        stack: Cells still to be searched. Shape (n,), int32.
        offsets: Distance of the target from each of them along each axis (m). Shape (n, 3).
    """

    box: np.ndarray
    cell: np.ndarray
    axis: np.ndarray
    split: np.ndarray
    halves: np.ndarray
    size: np.ndarray
    stack: np.ndarray
    offsets: np.ndarray


def new_index(nodes: int) -> Index:
    """Memory for a number of nodes."""
    return Index(
        np.zeros((2, 3)),
        np.zeros((2, 3)),
        np.zeros(nodes, np.int8),
        np.zeros(nodes),
        np.zeros((nodes, 2), np.int32),
        np.zeros(1, np.int64),
        np.zeros(nodes, np.int32),
        np.zeros((nodes, 3)),
    )


@kernel_jit
def clear(index: Index, lower: np.ndarray, upper: np.ndarray) -> None:
    """Remove all nodes.

    Args:
        index: Changed.
        lower: Corner of the sampled box (m). Nodes may lie outside it. Shape (3,).
        upper: Opposite corner (m). Shape (3,).
    """
    for axis in range(3):
        index.box[0, axis] = lower[axis]
        index.box[1, axis] = upper[axis]
    index.size[0] = 0


@kernel_jit
def _halve(index: Index, node: int) -> None:
    """Assign `cell` to a node, halved along its longest edge."""
    cell = index.cell
    longest = 0
    for axis in range(1, 3):
        if cell[1, axis] - cell[0, axis] > cell[1, longest] - cell[0, longest]:
            longest = axis
    index.axis[node] = longest
    index.split[node] = 0.5 * (cell[0, longest] + cell[1, longest])
    index.halves[node, 0] = -1
    index.halves[node, 1] = -1


@kernel_jit
def _take_in(index: Index, nodes: np.ndarray, count: int) -> None:
    """Insert all nodes that are not yet in the index."""
    cell = index.cell
    for new in range(index.size[0], count):
        for axis in range(3):
            cell[0, axis] = index.box[0, axis]
            cell[1, axis] = index.box[1, axis]
        node = 0 if new > 0 else -1
        while node >= 0:
            axis = index.axis[node]
            half = 0 if nodes[new, axis] < index.split[node] else 1
            cell[1 - half, axis] = index.split[node]
            below = index.halves[node, half]
            if below < 0:
                index.halves[node, half] = new
            node = below
        _halve(index, new)
    index.size[0] = count


@kernel_jit
def _square(nodes: np.ndarray, i: int, target: np.ndarray) -> float:
    dx = nodes[i, 0] - target[0]
    dy = nodes[i, 1] - target[1]
    dz = nodes[i, 2] - target[2]
    return float(dx * dx + dy * dy + dz * dz)


@kernel_jit
def _step_down(
    index: Index, node: int, target: np.ndarray, ox: float, oy: float, oz: float, size: int
) -> tuple[int, int]:
    """The half of a cell that contains the target, and the size of the stack, onto which the other half is pushed.

    Args:
        index: Memory.
        node: Cell.
        target: World frame (m). Shape (3,).
        ox: Distance of the target from the cell along x (m).
        oy: Distance of the target from the cell along y (m).
        oz: Distance of the target from the cell along z (m).
        size: Number of cells on the stack.
    """
    axis = index.axis[node]
    away = target[axis] - index.split[node]
    half = 0 if away < 0.0 else 1
    other = index.halves[node, 1 - half]
    if other >= 0:
        index.stack[size] = other
        index.offsets[size, 0] = ox
        index.offsets[size, 1] = oy
        index.offsets[size, 2] = oz
        index.offsets[size, axis] = away
        size += 1
    return index.halves[node, half], size


@kernel_jit
def scan(nodes: np.ndarray, count: int, target: np.ndarray) -> int:
    """Index of the node nearest to a point; 0 if all distances are NaN.

    Args:
        nodes: World frame (m). Shape (>= count, 3).
        count: Number of nodes.
        target: World frame (m). Shape (3,).
    """
    best = 0
    best_square = np.inf
    for i in range(count):
        square = _square(nodes, i, target)
        if square < best_square:
            best_square = square
            best = i
    return best


@kernel_jit
def search(index: Index, nodes: np.ndarray, count: int, target: np.ndarray) -> int:
    """Same result as `scan`, from the index.

    Args:
        index: Memory; new nodes are inserted.
        nodes: World frame (m). Shape (>= count, 3).
        count: Number of nodes, at least 1.
        target: World frame (m). Shape (3,).
    """
    _take_in(index, nodes, count)
    best = 0
    best_square = np.inf
    index.stack[0] = 0
    index.offsets[0] = 0.0
    size = 1
    while size > 0:
        size -= 1
        node = index.stack[size]
        ox, oy, oz = index.offsets[size, 0], index.offsets[size, 1], index.offsets[size, 2]
        if ox * ox + oy * oy + oz * oz > best_square:
            continue
        while node >= 0:
            square = _square(nodes, node, target)
            if square < best_square or (square == best_square and node < best):
                best_square = square
                best = node
            node, size = _step_down(index, node, target, ox, oy, oz, size)
    return best


@kernel_jit
def nearest(index: Index, nodes: np.ndarray, count: int, target: np.ndarray) -> int:
    """Index of the node nearest to a point, by the faster method. Arguments as for `search`."""
    if count < PAYS_FROM:
        return scan(nodes, count, target)
    return search(index, nodes, count, target)


@kernel_jit
def scan_ball(nodes: np.ndarray, count: int, centre: np.ndarray, radius: float, near: np.ndarray) -> int:
    """Nodes within a radius of a point.

    Args:
        nodes: World frame (m). Shape (>= count, 3).
        count: Number of nodes.
        centre: World frame (m). Shape (3,).
        radius: Radius (m).
        near: Output: their indices. Shape (>= count,), int32.

    Returns:
        Number of nodes found.
    """
    size = 0
    for i in range(count):
        if math.sqrt(_square(nodes, i, centre)) <= radius:
            near[size] = i
            size += 1
    return size


@kernel_jit
def search_ball(
    index: Index, nodes: np.ndarray, count: int, centre: np.ndarray, radius: float, near: np.ndarray
) -> int:
    """Same nodes as `scan_ball`, in another order; new nodes are inserted into `index`."""
    _take_in(index, nodes, count)
    within = 0
    index.stack[0] = 0
    index.offsets[0] = 0.0
    size = 1
    while size > 0:
        size -= 1
        node = index.stack[size]
        ox, oy, oz = index.offsets[size, 0], index.offsets[size, 1], index.offsets[size, 2]
        if math.sqrt(ox * ox + oy * oy + oz * oz) > radius:
            continue
        while node >= 0:
            if math.sqrt(_square(nodes, node, centre)) <= radius:
                near[within] = node
                within += 1
            node, size = _step_down(index, node, centre, ox, oy, oz, size)
    return within


@kernel_jit
def ball(index: Index, nodes: np.ndarray, count: int, centre: np.ndarray, radius: float, near: np.ndarray) -> int:
    """Nodes within a radius, in no particular order, by the faster method. Arguments as for `search_ball`."""
    if count < PAYS_FROM:
        return scan_ball(nodes, count, centre, radius, near)
    return search_ball(index, nodes, count, centre, radius, near)
