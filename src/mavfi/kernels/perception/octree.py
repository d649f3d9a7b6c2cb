"""OctoMap's octree with its nodes in arrays (Hornung et al. 2013, sections 3.2-3.4), for studies with faults in nodes.

Keys have 16 bits, a node has eight children, an inner node has the largest log-odds of its children.  Eight equal leaf
children are pruned into their parent; updating part of a pruned node expands it again.  Each step is that of the
library's `updateNode`, so that nodes and values equal the library's.

Indices may be corrupted: one outside the arrays counts as no child, a descent ends after 16 levels, and no node is
allocated from an exhausted pool.
"""

from typing import NamedTuple

import numpy as np

from mavfi.kernels.perception.key_sets import KeyFrame
from mavfi.kernels.perception.octomap import UpdateRule
from mavfi.numerics.jit import kernel_jit

DEPTH = 16
NEEDED = 8 * DEPTH
"""Largest number of nodes allocated by one update: an expansion on each level."""
USED, FREE_HEAD, FREE_COUNT, NODES = range(4)
"""`Octree.counters`: first index never used, first free node (0 = none), number of free nodes, nodes in the tree."""
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


def new_octree(capacity: int) -> Octree:
    """An empty tree.

    Args:
        capacity: Largest number of nodes, at least `NEEDED` + 1.
    """
    return Octree(np.zeros((capacity, 8), np.int32), np.zeros(capacity, np.float32), np.array([1, 0, 0, 0]))


def copy_into(source: Octree, target: Octree) -> None:
    """Copy a tree into one at least as large; unused entries become 0."""
    used = len(source.log_odds)
    for old, new in zip(source[:2], target[:2], strict=True):
        new[:used] = old
        new[used:] = 0
    target.counters[:] = source.counters


def compact_copy(tree: Octree) -> Octree:
    """A copy with only the nodes that were ever used."""
    used = min(max(int(tree.counters[USED]), 0), len(tree.log_odds))
    return Octree(tree.children[:used].copy(), tree.log_odds[:used].copy(), tree.counters.copy())


def largest_tree(frame: KeyFrame) -> int:
    """Upper bound of the capacity of a tree over a grid: its nodes on all levels, and those of one update."""
    axes = ((frame.kx, frame.nx), (frame.ky, frame.ny), (frame.kz, frame.nz))
    nodes = 0
    for level in range(DEPTH + 1):
        on_level = 1
        for first, number in axes:
            on_level *= ((first + number - 1 + _ORIGIN) >> level) - ((first + _ORIGIN) >> level) + 1
        nodes += on_level
    return nodes + NEEDED + 1


@kernel_jit
def _child(children: np.ndarray, node: int, slot: int) -> int:
    """Index of a child; 0 = none."""
    child = int(children[node, slot])
    return child if 0 < child < children.shape[0] else 0


@kernel_jit
def _has_children(children: np.ndarray, node: int) -> bool:
    for slot in range(8):
        if 0 < children[node, slot] < children.shape[0]:
            return True
    return False


@kernel_jit
def _take(children: np.ndarray, log_odds: np.ndarray, counters: np.ndarray, value: np.float32) -> int:
    """A new node without children; 0 = the pool is full."""
    node = int(counters[FREE_HEAD])
    if 0 < node < children.shape[0]:
        counters[FREE_HEAD] = children[node, 0]
        counters[FREE_COUNT] -= 1
    else:
        node = int(counters[USED])
        if not (0 < node < children.shape[0]):
            return 0
        counters[USED] = node + 1
    for slot in range(8):
        children[node, slot] = 0
    log_odds[node] = value
    counters[NODES] += 1
    return node


@kernel_jit
def _prune(children: np.ndarray, counters: np.ndarray, node: int) -> None:
    """Free the eight children of a node."""
    for slot in range(8):
        child = _child(children, node, slot)
        children[node, slot] = 0
        children[child, 0] = counters[FREE_HEAD]
        counters[FREE_HEAD] = child
    counters[FREE_COUNT] += 8
    counters[NODES] -= 8


@kernel_jit
def _are_leaves(children: np.ndarray, node: int) -> bool:
    """Whether none of a node's children has children."""
    for slot in range(8):
        if _has_children(children, _child(children, node, slot)):
            return False
    return True


@kernel_jit
def _find(children: np.ndarray, log_odds: np.ndarray, kx: int, ky: int, kz: int) -> np.float32:
    """Implements `search` for a tree that is not empty, with keys from 0 on."""
    node = 0
    for level in range(DEPTH - 1, -1, -1):
        child = _child(children, node, (kx >> level & 1) | (ky >> level & 1) << 1 | (kz >> level & 1) << 2)
        if child == 0:
            return _UNKNOWN if _has_children(children, node) else _F32(log_odds[node])
        node = child
    return _F32(log_odds[node])


@kernel_jit
def search(tree: Octree, kx: int, ky: int, kz: int) -> np.float32:
    """Log-odds of a voxel, including voxels of a pruned node; NaN = unknown.

    Args:
        tree: The map.
        kx: Key along x; 0 begins at the origin of the shifted frame, as in `KeyFrame`.
        ky: Key along y.
        kz: Key along z.
    """
    if tree.counters[NODES] <= 0:
        return _UNKNOWN
    return _find(tree.children, tree.log_odds, kx + _ORIGIN, ky + _ORIGIN, kz + _ORIGIN)


@kernel_jit
def _reach(tree: Octree, kx: int, ky: int, kz: int, path: np.ndarray) -> int:
    """Index of the node of a voxel, created with its ancestors if absent; 0 = the pool is full."""
    children, log_odds, counters = tree.children, tree.log_odds, tree.counters
    created = counters[NODES] <= 0
    if created:
        for slot in range(8):
            children[0, slot] = 0
        log_odds[0] = _F32(0.0)
        counters[NODES] = 1
    node = 0
    for level in range(DEPTH - 1, -1, -1):
        path[level] = node
        slot = (kx >> level & 1) | (ky >> level & 1) << 1 | (kz >> level & 1) << 2
        child = _child(children, node, slot)
        if child > 0:
            created = False
        elif created or _has_children(children, node):
            child = _take(children, log_odds, counters, _F32(0.0))
            children[node, slot] = child
            created = True
        else:  # it had been pruned
            for sibling in range(8):
                children[node, sibling] = _take(children, log_odds, counters, log_odds[node])
            child = _child(children, node, slot)
        if child == 0:
            return 0
        node = child
    return node


@kernel_jit
def _raise_to_root(tree: Octree, path: np.ndarray) -> None:
    """Prune the nodes of a path, or set them to the largest log-odds of their children, bottom-up."""
    children, log_odds = tree.children, tree.log_odds
    for level in range(DEPTH):
        node = path[level]
        largest = _LEAST
        first = _UNKNOWN
        equal = 0
        for slot in range(8):
            child = children[node, slot]
            if 0 < child < children.shape[0]:
                value = log_odds[child]
                if slot == 0:
                    first = value
                equal += value == first
                largest = value if value > largest else largest  # a NaN is never the largest
        log_odds[node] = largest
        if equal == 8 and _are_leaves(children, node):
            _prune(children, tree.counters, node)


@kernel_jit
def update_node(tree: Octree, rule: UpdateRule, kx: int, ky: int, kz: int, hit: bool, path: np.ndarray) -> np.float32:
    """Update one voxel, and the nodes above it.

    Args:
        tree: The map; changed.
        rule: Increments and clamps.
        kx: Key along x, as in `search`.
        ky: Key along y.
        kz: Key along z.
        hit: Whether the voxel was hit; otherwise it is freed.
        path: Work space. Shape (DEPTH,), int64.

    Returns:
        Its log-odds after the update; NaN if the pool is full.
    """
    known = search(tree, kx, ky, kz)
    if (known >= rule.clamp_max) if hit else (known <= rule.clamp_min):
        return known
    node = _reach(tree, kx + _ORIGIN, ky + _ORIGIN, kz + _ORIGIN, path)
    if node == 0:
        return _UNKNOWN
    value = _F32(tree.log_odds[node] + (rule.hit if hit else rule.miss))
    if value < rule.clamp_min:
        value = rule.clamp_min
    elif value > rule.clamp_max:
        value = rule.clamp_max
    tree.log_odds[node] = value
    _raise_to_root(tree, path)
    return value


@kernel_jit
def update_voxels(
    tree: Octree,
    frame: KeyFrame,
    rule: UpdateRule,
    voxels: np.ndarray,
    n_free: int,
    first: int,
    after: np.ndarray,
) -> int:
    """Update the voxels of a scan while the pool suffices.

    Args:
        tree: The map; changed.
        frame: Grid.
        rule: Increments and clamps.
        voxels: As found by `key_sets.collect`. Shape (n,), int32.
        n_free: Number of free voxels, which come first.
        first: Index of the first voxel to update.
        after: Output: their log-odds after the update. Shape (n,), float32.

    Returns:
        Number of updated voxels: n, or the index of the first one that does not fit and is not in the tree.
    """
    path = np.empty(DEPTH, np.int64)
    for i in range(max(first, 0), voxels.shape[0]):
        room = tree.log_odds.shape[0] - tree.counters[USED] + tree.counters[FREE_COUNT]
        if not (room >= NEEDED):
            return i
        kx = frame.kx + voxels[i] // (frame.ny * frame.nz)
        ky = frame.ky + (voxels[i] // frame.nz) % frame.ny
        kz = frame.kz + voxels[i] % frame.nz
        after[i] = update_node(tree, rule, kx, ky, kz, i >= n_free, path)
    return len(voxels)


@kernel_jit
def to_dense(tree: Octree, frame: KeyFrame, log_odds: np.ndarray) -> None:
    """Log-odds of every voxel of a grid, 0 = unknown, as in the dense map.

    Args:
        tree: The map.
        frame: Grid.
        log_odds: Output. Shape (nx * ny * nz,), float32.
    """
    voxel = 0
    for ix in range(frame.nx):
        for iy in range(frame.ny):
            for iz in range(frame.nz):
                value = search(tree, frame.kx + ix, frame.ky + iy, frame.kz + iz)
                log_odds[voxel] = _F32(0.0) if np.isnan(value) else value
                voxel += 1
