"""Trees of a library as tables, and the sums of their leaves in compiled code."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from mavfi.detectors.autoencoder import INPUT_LIMIT
from mavfi.extras.bench.library import RATES, Inputs
from mavfi.numerics.elementary import exp
from mavfi.numerics.jit import kernel_jit


class Branch(NamedTuple):
    """A node with children.

    Attributes:
        column: The input that it compares.
        threshold: The largest input that goes to `low`.
        low: A child.
        high: The other.
    """

    column: int
    threshold: float
    low: "Tree"
    high: "Tree"


Tree = float | Branch
"""A branch, or the value of a leaf."""


class Forest(NamedTuple):
    """Trees; the score is shift + sign * value, with value = sum of the leaves / unit, or with `decays` exp(-value).

    Attributes:
        spans: First and one past the last tree of each state. Shape (slots, 2), int64.
        unit: Of each state, > 0. Shape (slots,).
        decays: See above.
        sign: 1 or -1.
        shift: See above.
        roots: Root of each tree. Shape (t,), int64.
        depths: Depth of each tree. Shape (t,), int64.
        nodes: See `pack`. Shape (k,), int64.
        values: Value of each leaf. Shape (k,).
    """

    spans: np.ndarray
    unit: np.ndarray
    decays: bool
    sign: float
    shift: float
    roots: np.ndarray
    depths: np.ndarray
    nodes: np.ndarray
    values: np.ndarray


class Trees(NamedTuple):
    """Trees of a state, and the unit of the sum of their leaves."""

    trees: Sequence[Tree]
    unit: float


CODES_FROM, _CODES_TO = -(1 << 15) - 1, 1 << 15
"""All codes are between these."""


def limit_of(branch: Branch, inputs: Inputs) -> int:
    """Largest code that goes to the lower child of a branch."""
    scale = float(inputs.scale[branch.column])
    if not -INPUT_LIMIT <= branch.threshold < INPUT_LIMIT:  # inputs are clamped to these: all codes, or none
        return CODES_FROM if branch.threshold < 0.0 else _CODES_TO - 1
    found = min(max(math.floor(branch.threshold * scale), CODES_FROM), _CODES_TO - 1)
    while found < _CODES_TO - 1 and (found + 1) / scale <= branch.threshold:
        found += 1
    while found > CODES_FROM and found / scale > branch.threshold:
        found -= 1
    return found


def pack(limit: int, field: int, below: int) -> int:
    """A node in one word, since a walk is as fast as its loads.

    Args:
        limit: Largest code that goes to the lower child.
        field: Index of the code, < 256.
        below: The lower child, followed by the upper one; a leaf is its own.
    """
    return (below << 40) + (field << 32) + (limit - CODES_FROM)


@kernel_jit
def leaf_sum(codes: np.ndarray, forest: Forest, first: int, last: int) -> float:
    """Sum of the leaves that codes, shape (n,), reach in the trees [first, last)."""
    total = 0.0
    for tree in range(first, last):
        node = forest.roots[tree]
        for _ in range(forest.depths[tree]):  # no branch that depends on the codes: several trees at a time
            word = forest.nodes[node]
            above = codes[(word >> 32) & 0xFF] - CODES_FROM > (word & 0xFFFFFFFF)
            node = (word >> 40) + int(above)
        total += forest.values[node]
    return total


@kernel_jit
def rate_by_forest(codes: np.ndarray, slot: int, forest: Forest) -> float:
    """See `library.rate`; 0 for a state without trees."""
    first, last = forest.spans[slot]
    if first == last:
        return 0.0
    value = leaf_sum(codes, forest, first, last) / forest.unit[slot]
    return forest.shift + forest.sign * (exp(-value) if forest.decays else value)


RATES[Forest] = rate_by_forest


def spans_of(counts: Sequence[int] | np.ndarray) -> np.ndarray:
    """First and one past the last of parts that follow each other. Shape (k, 2), int64."""
    ends = np.cumsum(counts, dtype=np.int64)
    return np.stack([ends - counts, ends], axis=1).astype(np.int64)


def forest_of(
    states: Sequence[Trees], inputs: Inputs, decays: bool = False, sign: float = 1.0, shift: float = 0.0
) -> Forest:  # fmt: skip
    """The tables of a forest.

    Args:
        states: Trees of each state.
        inputs: What their columns are.
        decays: See `Forest`.
        sign: See `Forest`.
        shift: See `Forest`.
    """
    nodes, roots, depths = _Nodes(inputs), [], []
    for tree in (tree for own in states for tree in own.trees):
        roots.append(len(nodes.values))
        depths.append(nodes.add(tree))
    return Forest(
        spans_of([len(own.trees) for own in states]),
        np.array([own.unit for own in states], np.float64), decays, sign, shift, np.array(roots, np.int64),
        np.array(depths, np.int64), np.array(nodes.words, np.int64), np.array(nodes.values, np.float64),
    )  # fmt: skip


class _Nodes:
    """Nodes of trees, see `Forest`."""

    def __init__(self, inputs: Inputs) -> None:
        self.words: list[int] = []
        self.values: list[float] = []
        self._inputs = inputs

    def add(self, tree: Tree) -> int:
        """Append a tree; returns its depth."""
        level, depth = [(self._leaf(), tree)], -1
        while level:
            level, depth = [pair for place, part in level for pair in self._fill(place, part)], depth + 1
        return depth

    def _leaf(self) -> int:
        self.words.append(pack(_CODES_TO, 0, len(self.words)))
        self.values.append(0.0)
        return len(self.words) - 1

    def _fill(self, place: int, tree: Tree) -> list[tuple[int, Tree]]:
        """Fill in a node; returns its children with their places."""
        if not isinstance(tree, Branch):
            self.values[place] = tree
            return []
        field = int(self._inputs.columns[tree.column])
        self.words[place] = pack(limit_of(tree, self._inputs), field, len(self.words))
        return [(self._leaf(), tree.low), (self._leaf(), tree.high)]
