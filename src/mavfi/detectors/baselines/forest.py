"""Trees of a library as tables, and the sums of their leaves in compiled code."""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from mavfi.detectors.baselines.library import RATES, ModelScorer, admit_by_model, judge_model, kinds_with
from mavfi.numerics.elementary import exp
from mavfi.numerics.jit import kernel_jit, short_jit
from mavfi.numerics.lent import header_of
from mavfi.numerics.stored import load


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
    """Groups of trees; a state's value is the largest |input - sum of the leaves| / unit among its groups.

    The score is that value; with `decays` exp(-value); with a sign of -1 its negative; `shift` is added.

    Attributes:
        spans: First and one past the last group of each state. Shape (slots, 2), int64.
        groups: First and one past the last tree of each group. Shape (g, 2), int64.
        column: Input of each group; -1 = none. Shape (g,), int64.
        unit: > 0. Shape (g,).
        decays: See above.
        sign: 1 or -1.
        shift: See above.
        roots: Root of each tree. Shape (t,), int64.
        depths: Depth of each tree. Shape (t,), int64.
        columns: Input compared by each node. Shape (k,), int32.
        thresholds: Infinite in leaves. Shape (k,).
        below: The lower child of each node, followed by the upper one; a leaf is its own. Shape (k,), int32.
        values: Value of each leaf. Shape (k,).
    """

    spans: np.ndarray
    groups: np.ndarray
    column: np.ndarray
    unit: np.ndarray
    decays: bool
    sign: float
    shift: float
    roots: np.ndarray
    depths: np.ndarray
    columns: np.ndarray
    thresholds: np.ndarray
    below: np.ndarray
    values: np.ndarray


class Group(NamedTuple):
    """See `Forest`."""

    trees: Sequence[Tree]
    unit: float
    column: int = -1


@kernel_jit
def leaf_sum(row: np.ndarray, forest: Forest, first: int, last: int) -> float:
    """Sum of the leaves that inputs, shape (w,), reach in the trees [first, last)."""
    total = 0.0
    for tree in range(first, last):
        node = forest.roots[tree]
        for _ in range(forest.depths[tree]):  # no branch that depends on the inputs: several trees at a time
            node = forest.below[node] + int(row[forest.columns[node]] > forest.thresholds[node])
        total += forest.values[node]
    return total


@kernel_jit
def rate_by_forest(row: np.ndarray, slot: int, forest: Forest) -> float:
    """See `library.rate`; 0 for a state without groups."""
    first, last = forest.spans[slot]
    worst = 0.0
    for group in range(first, last):
        column = forest.column[group]
        value = row[column] if column >= 0 else 0.0
        value -= leaf_sum(row, forest, forest.groups[group, 0], forest.groups[group, 1])
        worst = max(worst, abs(value) / forest.unit[group])
    if first == last:
        return 0.0
    return forest.shift + forest.sign * (exp(-worst) if forest.decays else worst)


RATES[Forest] = rate_by_forest


def forest_of(
    states: Sequence[Sequence[Group]], decays: bool = False, sign: float = 1.0, shift: float = 0.0
) -> Forest:  # fmt: skip
    """The tables of a forest.

    Args:
        states: Groups of each state.
        decays: See `Forest`.
        sign: See `Forest`.
        shift: See `Forest`.
    """
    groups = [group for own in states for group in own]
    ends = np.cumsum([len(own) for own in states])
    lasts = np.cumsum([len(group.trees) for group in groups], dtype=np.int64)
    nodes, roots, depths = _Nodes(), [], []
    for tree in (tree for group in groups for tree in group.trees):
        roots.append(len(nodes.values))
        depths.append(nodes.add(tree))
    return Forest(
        np.stack([ends - [len(own) for own in states], ends], axis=1).astype(np.int64),
        np.stack([lasts - [len(group.trees) for group in groups], lasts], axis=1).astype(np.int64),
        np.array([group.column for group in groups], np.int64),
        np.array([group.unit for group in groups], np.float64), decays, sign, shift, np.array(roots, np.int64),
        np.array(depths, np.int64), np.array(nodes.columns, np.int32),
        np.array(nodes.thresholds, np.float64), np.array(nodes.below, np.int32), np.array(nodes.values, np.float64),
    )  # fmt: skip


class _Nodes:
    """Columns of the table of nodes, see `Forest`."""

    def __init__(self) -> None:
        self.columns: list[int] = []
        self.thresholds: list[float] = []
        self.below: list[int] = []
        self.values: list[float] = []

    def add(self, tree: Tree) -> int:
        """Append a tree; returns its depth."""
        level, depth = [(self._leaf(), tree)], -1
        while level:
            level, depth = [pair for place, part in level for pair in self._fill(place, part)], depth + 1
        return depth

    def _leaf(self) -> int:
        self.columns.append(0)
        self.thresholds.append(math.inf)
        self.values.append(0.0)
        self.below.append(len(self.below))
        return len(self.below) - 1

    def _fill(self, place: int, tree: Tree) -> list[tuple[int, Tree]]:
        """Fill in a node; returns its children with their places."""
        if not isinstance(tree, Branch):
            self.values[place] = tree
            return []
        self.columns[place], self.thresholds[place], low, high = tree
        self.below[place] = len(self.below)
        return [(self._leaf(), low), (self._leaf(), high)]


_KIND, _ADMISSION = kinds_with(forest_of([[Group([0.0], 1.0)]]))


@kernel_jit
def _forest_at(address: int) -> float:
    return judge_model(*load(address, _KIND))


@short_jit
def _admit_forest(address: int, header: Any) -> bool:
    return admit_by_model(header_of(header), *load(address, _ADMISSION))


class ForestScorer(ModelScorer):
    """Scores of a `Forest`."""

    judge_at, admit_at = staticmethod(_forest_at), staticmethod(_admit_forest)
    kind, admission = _KIND, _ADMISSION
