"""OctoMap's octree with its nodes in arrays (Hornung et al. 2013, sections 3.2-3.4), for studies that strike nodes.

Keys have 16 bits, a node eight children, an inner node the largest log-odds of its children.  Eight equal children
without children are pruned into their parent; a pruned node that is updated below is expanded again.  Each step is that
of the library's `updateNode`, so that nodes and values equal the library's.

Indices may be corrupted: one that lies outside of the arrays is no child, a descent ends after 16 levels, and no memory
is taken where none is left.  Changes are journalled node by node, so that `rollback` restores every bit.
"""

from typing import NamedTuple

import numpy as np

from mavfi.kernels.perception.key_sets import KeyFrame
from mavfi.kernels.perception.octomap import UpdateRule
from mavfi.numerics.jit import kernel_jit

DEPTH = 16
NEEDED = 8 * DEPTH
"""Most nodes that one update takes: where it expands a node on each level."""
USED, FREE_HEAD, FREE_COUNT, NODES = range(4)
"""`Octree.counters`: first index never used, first free node (0 = none), how many are free, nodes in the tree."""
NOTED, EPOCH = 0, 1
"""`Journal.counters`: nodes noted since the mark, number of the mark; the tree's counters at the mark follow."""
_AT_MARK = 2
_ORIGIN = 1 << (DEPTH - 1)
_F32 = np.float32
_UNKNOWN = np.float32(np.nan)
_LEAST = np.float32(np.finfo(np.float32).min)


class Octree(NamedTuple):
    """The nodes; node 0 is the root.

    Attributes:
        children: Index of each child, by x + 2 y + 4 z of the key's bit on that level; 0 = none. In a free node, the
            first number is the next free node. Shape (capacity, 8), int32.
        log_odds: Shape (capacity,), float32.
        counters: See `USED`. Shape (4,), int64.
    """

    children: np.ndarray
    log_odds: np.ndarray
    counters: np.ndarray


class Journal(NamedTuple):
    """What nodes held at the last mark, noted when they are first changed after it.

    Attributes:
        stamp: Mark after which a node was last noted. Shape (capacity,), int32.
        node: Nodes in the order in which they were noted. Shape (capacity,), int32.
        children: What they held. Shape (capacity, 8), int32.
        log_odds: Same. Shape (capacity,), float32.
        counters: See `NOTED`. Shape (6,), int64.
    """

    stamp: np.ndarray
    node: np.ndarray
    children: np.ndarray
    log_odds: np.ndarray
    counters: np.ndarray


def new_octree(capacity: int) -> tuple[Octree, Journal]:
    """An empty tree, marked.

    Args:
        capacity: Number of nodes that there is room for, at least `NEEDED` + 1.
    """
    tree = Octree(np.zeros((capacity, 8), np.int32), np.zeros(capacity, np.float32), np.array([1, 0, 0, 0]))
    journal = Journal(
        np.zeros(capacity, np.int32), np.zeros(capacity, np.int32), np.zeros((capacity, 8), np.int32),
        np.zeros(capacity, np.float32), np.zeros(6, np.int64),
    )  # fmt: skip
    mark(tree, journal)
    return tree, journal


def enlarged(tree: Octree, journal: Journal, capacity: int) -> tuple[Octree, Journal]:
    """The same tree and journal with room for more nodes; arguments as in `new_octree`."""
    more, more_journal = new_octree(capacity)
    for old, new in zip((*tree, *journal), (*more, *more_journal), strict=True):
        new[: len(old)] = old
    return more, more_journal


def largest_tree(frame: KeyFrame) -> int:
    """The capacity that a tree over a grid never exceeds: all its nodes on all levels, and the room of one update."""
    axes = ((frame.kx, frame.nx), (frame.ky, frame.ny), (frame.kz, frame.nz))
    nodes = 0
    for level in range(DEPTH + 1):
        on_level = 1
        for first, number in axes:
            on_level *= ((first + number - 1 + _ORIGIN) >> level) - ((first + _ORIGIN) >> level) + 1
        nodes += on_level
    return nodes + NEEDED + 1


@kernel_jit
def mark(tree: Octree, journal: Journal) -> None:
    """Remember the tree as it is."""
    journal.counters[NOTED] = 0
    journal.counters[EPOCH] += 1
    journal.counters[_AT_MARK:] = tree.counters


@kernel_jit
def rollback(tree: Octree, journal: Journal) -> None:
    """Put the tree back to the last mark, bit by bit."""
    for i in range(min(journal.counters[NOTED], journal.node.shape[0])):
        node = journal.node[i]
        if 0 <= node < tree.log_odds.shape[0]:
            tree.children[node, :] = journal.children[i, :]
            tree.log_odds[node] = journal.log_odds[i]
    tree.counters[:] = journal.counters[_AT_MARK:]
    mark(tree, journal)


@kernel_jit
def _note(tree: Octree, journal: Journal, node: int) -> None:
    """Keep what a node holds, before it is changed for the first time since the mark."""
    count = journal.counters[NOTED]
    if journal.stamp[node] == journal.counters[EPOCH] or not (0 <= count < journal.node.shape[0]):
        return
    journal.stamp[node] = journal.counters[EPOCH]
    journal.node[count] = node
    journal.children[count, :] = tree.children[node, :]
    journal.log_odds[count] = tree.log_odds[node]
    journal.counters[NOTED] = count + 1


@kernel_jit
def _set_log_odds(tree: Octree, journal: Journal, node: int, value: np.float32) -> None:
    if not (tree.log_odds[node] == value):  # a NaN is always written
        _note(tree, journal, node)
        tree.log_odds[node] = value


@kernel_jit
def _child(tree: Octree, node: int, slot: int) -> int:
    """Index of a child; 0 = there is none."""
    child = int(tree.children[node, slot])
    return child if 0 < child < tree.log_odds.shape[0] else 0


@kernel_jit
def _has_children(tree: Octree, node: int) -> bool:
    for slot in range(8):
        if _child(tree, node, slot) > 0:
            return True
    return False


@kernel_jit
def _take(tree: Octree, journal: Journal, value: np.float32) -> int:
    """A new node without children; 0 = there is no room."""
    node = int(tree.counters[FREE_HEAD])
    if 0 < node < tree.log_odds.shape[0]:
        tree.counters[FREE_HEAD] = tree.children[node, 0]
        tree.counters[FREE_COUNT] -= 1
    else:
        node = int(tree.counters[USED])
        if not (0 < node < tree.log_odds.shape[0]):
            return 0
        tree.counters[USED] = node + 1
    _note(tree, journal, node)
    tree.children[node, :] = 0
    tree.log_odds[node] = value
    tree.counters[NODES] += 1
    return node


@kernel_jit
def _append(tree: Octree, journal: Journal, node: int, slot: int, value: np.float32) -> int:
    """Give a node a child; returns it, 0 = there is no room."""
    child = _take(tree, journal, value)
    if child > 0:
        _note(tree, journal, node)
        tree.children[node, slot] = child
    return child


@kernel_jit
def _prune(tree: Octree, journal: Journal, node: int) -> None:
    """Free the eight children of a node."""
    _note(tree, journal, node)
    for slot in range(8):
        child = _child(tree, node, slot)
        tree.children[node, slot] = 0
        _note(tree, journal, child)
        tree.children[child, 0] = tree.counters[FREE_HEAD]
        tree.counters[FREE_HEAD] = child
    tree.counters[FREE_COUNT] += 8
    tree.counters[NODES] -= 8


@kernel_jit
def _collapsible(tree: Octree, node: int) -> bool:
    """Whether a node has eight equal children without children."""
    first = _child(tree, node, 0)
    if first == 0 or _has_children(tree, first):
        return False
    for slot in range(1, 8):
        child = _child(tree, node, slot)
        if child == 0 or not (tree.log_odds[child] == tree.log_odds[first]) or _has_children(tree, child):
            return False
    return True


@kernel_jit
def _largest(tree: Octree, node: int) -> np.float32:
    """Largest log-odds of a node's children."""
    largest = _LEAST
    for slot in range(8):
        child = _child(tree, node, slot)
        if child > 0 and tree.log_odds[child] > largest:
            largest = tree.log_odds[child]
    return largest


@kernel_jit
def search(tree: Octree, kx: int, ky: int, kz: int) -> np.float32:
    """Log-odds of a voxel, also where it is part of a pruned node; NaN = unknown.

    Args:
        tree: The map.
        kx: Key along x; 0 begins at the origin of the shifted frame, as in `KeyFrame`.
        ky: Same along y.
        kz: Same along z.
    """
    if tree.counters[NODES] <= 0:
        return _UNKNOWN
    kx += _ORIGIN
    ky += _ORIGIN
    kz += _ORIGIN
    node = 0
    for level in range(DEPTH - 1, -1, -1):
        child = _child(tree, node, (kx >> level & 1) | (ky >> level & 1) << 1 | (kz >> level & 1) << 2)
        if child == 0:
            return _UNKNOWN if _has_children(tree, node) else _F32(tree.log_odds[node])
        node = child
    return _F32(tree.log_odds[node])


@kernel_jit
def _reach(tree: Octree, journal: Journal, kx: int, ky: int, kz: int, path: np.ndarray) -> int:
    """Index of the node of a voxel, which is made if there is none, and those above it; 0 = there is no room."""
    kx += _ORIGIN
    ky += _ORIGIN
    kz += _ORIGIN
    created = tree.counters[NODES] <= 0
    if created:
        _note(tree, journal, 0)
        tree.children[0, :] = 0
        tree.log_odds[0] = _F32(0.0)
        tree.counters[NODES] = 1
    node = 0
    for level in range(DEPTH - 1, -1, -1):
        path[level] = node
        slot = (kx >> level & 1) | (ky >> level & 1) << 1 | (kz >> level & 1) << 2
        child = _child(tree, node, slot)
        if child > 0:
            created = False
        elif created or _has_children(tree, node):
            child = _append(tree, journal, node, slot, _F32(0.0))
            created = True
        else:  # it was pruned
            for sibling in range(8):
                _append(tree, journal, node, sibling, tree.log_odds[node])
            child = _child(tree, node, slot)
        if child == 0:
            return 0
        node = child
    return node


@kernel_jit
def update_node(
    tree: Octree, journal: Journal, rule: UpdateRule, kx: int, ky: int, kz: int, hit: bool, path: np.ndarray
) -> np.float32:
    """Update one voxel, and the nodes above it.

    Args:
        tree: The map; changed.
        journal: Changed.
        rule: Increments and clamps.
        kx: Key, as in `search`.
        ky: Same.
        kz: Same.
        hit: Whether the voxel was hit, or freed.
        path: Work space. Shape (DEPTH,), int64.

    Returns:
        Its log-odds after that; NaN where there was no room.
    """
    known = search(tree, kx, ky, kz)
    if (known >= rule.clamp_max) if hit else (known <= rule.clamp_min):
        return known
    node = _reach(tree, journal, kx, ky, kz, path)
    if node == 0:
        return _UNKNOWN
    value = _F32(tree.log_odds[node] + (rule.hit if hit else rule.miss))
    if value < rule.clamp_min:
        value = rule.clamp_min
    elif value > rule.clamp_max:
        value = rule.clamp_max
    _set_log_odds(tree, journal, node, value)
    for level in range(DEPTH):
        node = path[level]
        if _collapsible(tree, node):
            _set_log_odds(tree, journal, node, tree.log_odds[_child(tree, node, 0)])
            _prune(tree, journal, node)
        else:
            _set_log_odds(tree, journal, node, _largest(tree, node))
    return value


@kernel_jit
def update_voxels(
    tree: Octree, journal: Journal, frame: KeyFrame, rule: UpdateRule, voxels: np.ndarray, n_free: int, first: int,
    after: np.ndarray,
) -> int:  # fmt: skip
    """Update the voxels of a scan, as far as there is room.

    Args:
        tree: The map; changed.
        journal: Changed.
        frame: Grid.
        rule: Increments and clamps.
        voxels: As `key_sets.collect` finds them. Shape (n,), int32.
        n_free: How many of them are free; these come first.
        first: Which one to begin with.
        after: Result: their log-odds after the update. Shape (n,), float32.

    Returns:
        How many voxels are updated: n, or the first one for which the tree has no room; that one left it as it was.
    """
    path = np.empty(DEPTH, np.int64)
    for i in range(max(first, 0), voxels.shape[0]):
        room = tree.log_odds.shape[0] - tree.counters[USED] + tree.counters[FREE_COUNT]
        if not (room >= NEEDED):
            return i
        kx = frame.kx + voxels[i] // (frame.ny * frame.nz)
        ky = frame.ky + (voxels[i] // frame.nz) % frame.ny
        kz = frame.kz + voxels[i] % frame.nz
        after[i] = update_node(tree, journal, rule, kx, ky, kz, i >= n_free, path)
    return len(voxels)


@kernel_jit
def to_dense(tree: Octree, frame: KeyFrame, log_odds: np.ndarray) -> None:
    """Log-odds of every voxel of a grid, 0 = unknown, as the dense map holds them.

    Args:
        tree: The map.
        frame: Grid.
        log_odds: Result. Shape (nx * ny * nz,), float32.
    """
    voxel = 0
    for ix in range(frame.nx):
        for iy in range(frame.ny):
            for iz in range(frame.nz):
                value = search(tree, frame.kx + ix, frame.ky + iy, frame.kz + iz)
                log_odds[voxel] = _F32(0.0) if np.isnan(value) else value
                voxel += 1
