"""Nearest node and nodes in a ball among the nodes of a search tree: linear scan, and a grid of buckets.

The grid answers exactly as the scan does, ties included: of nodes at the same distance the one that was added first.
Its cells are cubes over the sampled box; nodes and queries outside of it count as lying in the cells at its edge, which
never makes anything farther away than it is, so the bounds hold for them, too.
"""

import math
from typing import NamedTuple

import numpy as np

from mavfi.kernels.planning.path import distance
from mavfi.numerics.jit import kernel_jit
from mavfi.numerics.voxels import COORDINATE_LIMIT, usable

CELL_LIMIT = 8192
PAYS_FROM = 256
"""Number of nodes from which on the grid is faster than the scan (`make bench`)."""
BALL_PAYS_FROM = 128
"""Same for the nodes in a ball."""
_GROWTH = 1.25
_GROWTHS = 64
_ROUNDING = 1.0 - 1e-9


class Buckets(NamedTuple):
    """Memory of the grid.

    Attributes:
        frame: Lower corner (m), cells per metre. Shape (4,).
        cells: Number of cells along x, y, z; number of nodes in the grid. Shape (4,), int64.
        first: First node of each cell; -1 = none. Shape (CELL_LIMIT,), int32.
        following: Next node of the same cell; -1 = none. Shape (number of nodes,), int32.
    """

    frame: np.ndarray
    cells: np.ndarray
    first: np.ndarray
    following: np.ndarray


def new_buckets(nodes: int) -> Buckets:
    """Memory for a number of nodes."""
    return Buckets(np.zeros(4), np.zeros(4, np.int64), np.zeros(CELL_LIMIT, np.int32), np.zeros(nodes, np.int32))


@kernel_jit
def clear(buckets: Buckets, lower: np.ndarray, upper: np.ndarray) -> None:
    """Forget all nodes, and lay the grid over a box; a box that is not sound becomes one cell.

    Args:
        buckets: Changed.
        lower: Corner of the sampled box (m). Shape (3,).
        upper: Same.
    """
    frame, cells = buckets.frame, buckets.cells
    volume = 1.0
    sound = usable(lower[0], lower[1], lower[2]) and usable(upper[0], upper[1], upper[2])
    for axis in range(3):
        frame[axis] = lower[axis] if sound else 0.0
        cells[axis] = 1
        volume *= max(upper[axis] - lower[axis], 1e-3)
    frame[3] = 1.0 / (2.0 * COORDINATE_LIMIT)
    cells[3] = 0
    edge = (volume / CELL_LIMIT) ** (1.0 / 3.0)
    for _ in range(_GROWTHS if sound else 0):
        total = 1.0
        for axis in range(3):
            total *= math.floor(max(upper[axis] - lower[axis], 0.0) / edge) + 1.0
        if total <= CELL_LIMIT:
            frame[3] = 1.0 / edge
            for axis in range(3):
                cells[axis] = int(math.floor(max(upper[axis] - lower[axis], 0.0) / edge)) + 1
            return
        edge *= _GROWTH


@kernel_jit
def _cell(buckets: Buckets, axis: int, value: float) -> int:
    """Index of the cell along an axis; of that at the edge for a value outside or one that is not a number."""
    share = (value - buckets.frame[axis]) * buckets.frame[3]
    last = buckets.cells[axis] - 1
    if not share > 0.0:
        return 0
    return last if share >= last else int(share)


@kernel_jit
def _take_in(buckets: Buckets, nodes: np.ndarray, count: int) -> None:
    """Put the nodes that are not yet in the grid into it."""
    done = buckets.cells[3]
    if done == 0:
        buckets.first[:] = -1
    for i in range(done, count):
        x = _cell(buckets, 0, nodes[i, 0])
        y = _cell(buckets, 1, nodes[i, 1])
        z = _cell(buckets, 2, nodes[i, 2])
        cell = (x * buckets.cells[1] + y) * buckets.cells[2] + z
        buckets.following[i] = buckets.first[cell]
        buckets.first[cell] = i
    buckets.cells[3] = count


@kernel_jit
def _square(nodes: np.ndarray, i: int, target: np.ndarray) -> float:
    dx = nodes[i, 0] - target[0]
    dy = nodes[i, 1] - target[1]
    dz = nodes[i, 2] - target[2]
    return dx * dx + dy * dy + dz * dz


@kernel_jit
def scan(nodes: np.ndarray, count: int, target: np.ndarray) -> int:
    """Index of the node nearest to a point; 0 if no distance is a number.

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
def _nearer_in(
    buckets: Buckets, nodes: np.ndarray, cell: int, target: np.ndarray, best: int, best_square: float
) -> tuple[int, float]:
    """The better one of the best node so far and those of a cell."""
    i = buckets.first[cell]
    while i >= 0:
        square = _square(nodes, i, target)
        if square < best_square or (square == best_square and i < best):
            best_square = square
            best = i
        i = buckets.following[i]
    return best, best_square


@kernel_jit
def search(buckets: Buckets, nodes: np.ndarray, count: int, target: np.ndarray) -> int:
    """Same answer as `scan`, from the cells around the target, in rings of growing distance.

    Args:
        buckets: Memory; takes the nodes in that are new.
        nodes: World frame (m). Shape (>= count, 3).
        count: Number of nodes.
        target: World frame (m). Shape (3,).
    """
    if not usable(target[0], target[1], target[2]):
        return scan(nodes, count, target)
    _take_in(buckets, nodes, count)
    nx, ny, nz = buckets.cells[0], buckets.cells[1], buckets.cells[2]
    cx, cy, cz = _cell(buckets, 0, target[0]), _cell(buckets, 1, target[1]), _cell(buckets, 2, target[2])
    best = 0
    best_square = np.inf
    for ring in range(max(nx, ny, nz)):
        gap = (ring - 1) / buckets.frame[3]  # a node of this ring is at least so far away
        if ring > 0 and best_square < gap * gap * _ROUNDING:
            break
        for ix in range(max(cx - ring, 0), min(cx + ring, nx - 1) + 1):
            for iy in range(max(cy - ring, 0), min(cy + ring, ny - 1) + 1):
                column = (ix * ny + iy) * nz
                if abs(ix - cx) == ring or abs(iy - cy) == ring:
                    for iz in range(max(cz - ring, 0), min(cz + ring, nz - 1) + 1):
                        best, best_square = _nearer_in(buckets, nodes, column + iz, target, best, best_square)
                    continue
                if cz - ring >= 0:
                    best, best_square = _nearer_in(buckets, nodes, column + cz - ring, target, best, best_square)
                if cz + ring < nz:
                    best, best_square = _nearer_in(buckets, nodes, column + cz + ring, target, best, best_square)
    return best


@kernel_jit
def nearest(buckets: Buckets, nodes: np.ndarray, count: int, target: np.ndarray) -> int:
    """Index of the node nearest to a point, by whichever way is faster. Arguments as in `search`."""
    if count < PAYS_FROM:
        return scan(nodes, count, target)
    return search(buckets, nodes, count, target)


@kernel_jit
def scan_ball(nodes: np.ndarray, count: int, centre: np.ndarray, radius: float, found: np.ndarray) -> int:
    """Nodes within a radius of a point.

    Args:
        nodes: World frame (m). Shape (>= count, 3).
        count: Number of nodes.
        centre: World frame (m). Shape (3,).
        radius: m.
        found: Result: their indices. Shape (>= count,), int32.

    Returns:
        Number of them.
    """
    size = 0
    for i in range(count):
        if distance(nodes[i], centre) <= radius:
            found[size] = i
            size += 1
    return size


@kernel_jit
def search_ball(
    buckets: Buckets, nodes: np.ndarray, count: int, centre: np.ndarray, radius: float, found: np.ndarray
) -> int:
    """Same nodes as `scan_ball`, in another order; `buckets` takes the nodes in that are new."""
    if not (usable(centre[0], centre[1], centre[2]) and abs(radius) < COORDINATE_LIMIT):
        return scan_ball(nodes, count, centre, radius, found)
    _take_in(buckets, nodes, count)
    reach = radius + 1e-6
    ny, nz = buckets.cells[1], buckets.cells[2]
    size = 0
    for ix in range(_cell(buckets, 0, centre[0] - reach), _cell(buckets, 0, centre[0] + reach) + 1):
        for iy in range(_cell(buckets, 1, centre[1] - reach), _cell(buckets, 1, centre[1] + reach) + 1):
            for iz in range(_cell(buckets, 2, centre[2] - reach), _cell(buckets, 2, centre[2] + reach) + 1):
                i = buckets.first[(ix * ny + iy) * nz + iz]
                while i >= 0:
                    if distance(nodes[i], centre) <= radius:
                        found[size] = i
                        size += 1
                    i = buckets.following[i]
    return size


@kernel_jit
def ball(buckets: Buckets, nodes: np.ndarray, count: int, centre: np.ndarray, radius: float, found: np.ndarray) -> int:
    """Nodes within a radius, in no particular order, by whichever way is faster. Arguments as in `search_ball`."""
    if count < BALL_PAYS_FROM:
        return scan_ball(nodes, count, centre, radius, found)
    return search_ball(buckets, nodes, count, centre, radius, found)
