"""OctoMap's tree as plain Python objects, the bytes of its file format, and maps of both kinds to compare."""

import math
import struct

import numpy as np

from mavfi.kernels.perception import octomap, octree
from mavfi.kernels.perception.key_sets import KeyFrame
from mavfi.numerics.jit import kernel_jit

RULE = octomap.UpdateRule(*(octomap.log_odds(p) for p in (0.7, 0.4, 0.12, 0.97)))
_DEPTH = 16
_ORIGIN = 1 << 15


class Node:
    """A node with up to eight children."""

    def __init__(self, value=0.0):
        self.value = np.float32(value)
        self.children = {}


class NaiveOctree:
    """`updateNode` of the library, recursive, as its header file reads."""

    def __init__(self, rule=RULE):
        self.rule, self.root = rule, None

    def search(self, key):
        """The node that stands for a voxel, or None."""
        node = self.root
        for level in reversed(range(_DEPTH)):
            if node is None or not node.children:
                return node
            node = node.children.get(_slot(key, level))
        return node

    def update(self, key, hit):
        node = self.search(key)
        if node is not None:
            if hit and node.value >= self.rule.clamp_max or not hit and node.value <= self.rule.clamp_min:
                return
        created = self.root is None
        self.root = self.root or Node()
        self._descend(self.root, created, key, _DEPTH - 1, hit)

    def _descend(self, node, created, key, level, hit):
        if level < 0:
            value = np.float32(node.value + (self.rule.hit if hit else self.rule.miss))
            node.value = min(max(value, self.rule.clamp_min), self.rule.clamp_max)
            return
        slot, fresh = _slot(key, level), False
        if slot not in node.children:
            if not node.children and not created:
                node.children = {k: Node(node.value) for k in range(8)}
            else:
                node.children[slot], fresh = Node(), True
        self._descend(node.children[slot], fresh, key, level - 1, hit)
        children = node.children.values()
        if len(children) == 8 and not any(c.children for c in children) and len({c.value for c in children}) == 1:
            node.value, node.children = node.children[0].value, {}
        else:
            node.value = max(child.value for child in children)

    def data(self):
        """All nodes in the order and coding of a `.ot` file."""
        lines = []

        def write(node):
            lines.append(struct.pack("<fB", node.value, sum(1 << slot for slot in node.children)))
            for slot in sorted(node.children):
                write(node.children[slot])

        if self.root is not None:
            write(self.root)
        return b"".join(lines)


def _slot(key, level):
    return sum(((k + _ORIGIN) >> level & 1) << axis for axis, k in enumerate(key))


NODE = np.dtype([("value", "<f4"), ("children", "u1")])
"""A node in a `.ot` file."""


def tree_data(tree):
    """The same bytes of the array octree."""
    nodes = np.zeros(len(tree.log_odds), NODE)
    values, masks = np.zeros(len(nodes), np.float32), np.zeros(len(nodes), np.uint8)
    count = _in_order(tree.children, tree.log_odds, values, masks) if tree.counters[octree.NODES] else 0
    nodes["value"], nodes["children"] = values, masks
    return nodes[:count].tobytes()


@kernel_jit
def _in_order(children, log_odds, values, masks):
    stack = np.zeros(8 * _DEPTH + 8, np.int64)
    top, count = 1, 0
    while top > 0:
        top -= 1
        node = stack[top]
        mask = 0
        for slot in range(7, -1, -1):
            if children[node, slot] > 0:
                mask |= 1 << slot
                stack[top] = children[node, slot]
                top += 1
        values[count] = log_odds[node]
        masks[count] = mask
        count += 1
    return count


def leaves(data):
    """Lower key (3), edge in finest voxels, and log-odds of each leaf of a `.ot` file's nodes. Shapes (n, 4), (n,)."""
    nodes = np.frombuffer(data, NODE)
    boxes, values = np.zeros((len(nodes), 4), np.int64), np.zeros(len(nodes), np.float32)
    count, used = _leaves(nodes["value"].copy(), nodes["children"].copy(), boxes, values)
    assert used == len(nodes)
    return boxes[:count], values[:count]


@kernel_jit
def _leaves(node_values, masks, boxes, values):
    stack = np.zeros((8 * _DEPTH + 8, 4), np.int64)
    stack[0, :3] = -_ORIGIN
    stack[0, 3] = 1 << _DEPTH
    top, at, count = 1, 0, 0
    while top > 0 and at < len(masks):
        top -= 1
        x, y, z, edge = stack[top, 0], stack[top, 1], stack[top, 2], stack[top, 3]
        half = edge // 2
        if masks[at] == 0:
            boxes[count, 0], boxes[count, 1], boxes[count, 2], boxes[count, 3] = x, y, z, edge
            values[count] = node_values[at]
            count += 1
        for slot in range(7, -1, -1):
            if masks[at] >> slot & 1:
                stack[top, 0] = x + half * (slot & 1)
                stack[top, 1] = y + half * (slot >> 1 & 1)
                stack[top, 2] = z + half * (slot >> 2)
                stack[top, 3] = half
                top += 1
        at += 1
    return count, at


def dense_from(data, frame):
    """Log-odds of every voxel of a grid from a `.ot` file's nodes; NaN = unknown."""
    dense = np.full((frame.nx, frame.ny, frame.nz), np.nan, np.float32)
    boxes, values = leaves(data)
    _fill(boxes, values, np.array([frame.kx, frame.ky, frame.kz]), dense)
    return dense.reshape(-1)


@kernel_jit
def _fill(boxes, values, first, dense):
    for n in range(len(values)):
        x, y, z = boxes[n, 0] - first[0], boxes[n, 1] - first[1], boxes[n, 2] - first[2]
        edge = boxes[n, 3]
        for i in range(max(x, 0), min(x + edge, dense.shape[0])):
            for j in range(max(y, 0), min(y + edge, dense.shape[1])):
                for k in range(max(z, 0), min(z + edge, dense.shape[2])):
                    dense[i, j, k] = values[n]


def frame_around(lower, upper, resolution):
    """A grid that holds a box, shifted by half a voxel as those of missions."""
    first = np.floor(np.asarray(lower) / resolution).astype(int) - 2
    number = np.ceil(np.asarray(upper) / resolution).astype(int) + 3 - first
    half = 0.5 * resolution
    return KeyFrame(resolution, half, half, half, *map(int, first), *map(int, number))


def depth_of(data):
    """Number of levels below the root, and how many leaves are larger than a voxel."""
    edges = leaves(data)[0][:, 3]
    return _DEPTH - int(math.log2(edges.min())), int((edges > 1).sum())
