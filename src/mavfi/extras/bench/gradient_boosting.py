"""Regression of each code on all others (ALSO: Paulheim and Meusel, Machine Learning 100, 2015) by boosted trees.

The trees are LightGBM's (Ke et al., NeurIPS 2017).  Half of the training rows of a state fit the regressors of its
codes, the other half gives the quantile of each residual.  A publication scores the largest residual of its codes in
units of these quantiles: a value that alone is normal is judged by whether it agrees with the others.
"""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from mavfi.extras.bench.field_codes import FieldCodes
from mavfi.extras.bench.forest import Branch, Tree, limit_of, spans_of
from mavfi.extras.bench.library import RATES, Inputs, LibraryDetector, columns_of, input_of
from mavfi.numerics.jit import kernel_jit

ROUNDS = 40
OPTIONS: Mapping[str, Any] = {
    "objective": "regression", "num_leaves": 15, "learning_rate": 0.1, "min_data_in_leaf": 10, "seed": 0,
    "deterministic": True, "force_row_wise": True, "num_threads": 1, "verbosity": -1,
}  # fmt: skip
"""Of every regressor: one thread, since sums of several change their order, and threads do not survive a fork."""
QUANTILE = 0.99
"""Share of residuals below the unit of the score."""
FEWEST = 8
"""Rows of a state below which its codes have no regressors, and it scores 0."""
_SMALLEST = 1e-6
_ALL = (1 << 16) - 1
"""All leaves of a tree, one bit each."""
_PRIME = 19
"""2^k modulo 19 differs for k < 18: the remainder of a bit is a place for its leaf."""


class Regressors(NamedTuple):
    """Regressors of the codes of each state, evaluated by bits (QuickScorer: Lucchese et al., SIGIR 2015).

    A tree has a bit for each leaf, those of the child to which the code 0 goes before those of the other.  A branch
    from which a code goes to the other child removes the leaves of the first; the lowest bit that remains is the leaf
    that is reached.  The branches of all trees of a state that compare the same code are sorted by how far from 0 it is
    then: most codes are near 0, and few branches are looked at.

    Attributes:
        spans: First and one past the last regressor of each state. Shape (slots, 2), int64.
        trees: First and one past the last tree of each regressor. Shape (g, 2), int64.
        column: Input that each predicts. Shape (g,), int64.
        unit: Quantile of each residual. Shape (g,).
        starts: First and one past the last branch, by state, input, and whether the code is below 0.
            Shape (slots, w, 2, 2), int64.
        branches: Largest magnitude of a code that goes to the first child, tree within the state (16 bits), leaves that
            stay otherwise (16). Shape (k,), int64.
        leaves: Values, each at the remainder of its bit. Shape (t, 19).
        left: Leaves that remain in each tree of a state, work. Int64.
        inputs: The inputs of the library's model.
    """

    spans: np.ndarray
    trees: np.ndarray
    column: np.ndarray
    unit: np.ndarray
    starts: np.ndarray
    branches: np.ndarray
    leaves: np.ndarray
    left: np.ndarray
    inputs: Inputs


@kernel_jit
def drop_leaves(codes: np.ndarray, slot: int, trees: int, model: Regressors) -> None:
    """Remove the leaves that codes, shape (n,), do not reach from `left`, for all trees of a state."""
    model.left[:trees] = _ALL
    for place in range(len(model.inputs.columns)):
        code = np.int64(codes[model.inputs.columns[place]])
        starts = model.starts[slot, place, int(code < 0)]
        for index in range(starts[0], starts[1]):
            word = model.branches[index]
            if word >> 32 >= abs(code):
                break
            model.left[(word >> 16) & _ALL] &= word & _ALL


@kernel_jit
def rate_by_regressors(codes: np.ndarray, slot: int, model: Regressors) -> float:
    """See `library.rate`: the largest |input - prediction| / unit of a state's regressors; 0 without any."""
    worst = 0.0
    first, last = model.spans[slot]
    if first == last:
        return 0.0
    base = model.trees[first, 0]
    drop_leaves(codes, slot, model.trees[last - 1, 1] - base, model)
    for index in range(first, last):
        predicted = 0.0
        for tree in range(model.trees[index, 0], model.trees[index, 1]):
            lowest = model.left[tree - base] & -model.left[tree - base]
            predicted += model.leaves[tree, lowest % _PRIME]
        worst = max(worst, abs(input_of(codes, model.column[index], model.inputs) - predicted) / model.unit[index])
    return worst


RATES[Regressors] = rate_by_regressors


class Regressor(NamedTuple):
    """Trees that predict a column, and the quantile of its residual."""

    trees: Sequence[Tree]
    column: int
    unit: float


def regressors(rows: np.ndarray, slots: np.ndarray, columns: Sequence[np.ndarray], inputs: Inputs) -> Regressors:
    """Regressors of all codes, by state.

    Args:
        rows: Training rows, shape (m, w).
        slots: Their states. Shape (m,).
        columns: By state, the columns of its codes.
        inputs: What the columns are.
    """
    states = [
        [_fitted(rows[slots == slot], int(column)) for column in own] if (slots == slot).sum() >= FEWEST else []
        for slot, own in enumerate(columns)
    ]
    return tables_of(states, inputs)


def tables_of(states: Sequence[Sequence[Regressor]], inputs: Inputs) -> Regressors:
    """The tables of the regressors of each state."""
    every = [one for own in states for one in own]
    trees = [tree for one in every for tree in one.trees]
    leaves = np.zeros((len(trees), _PRIME))
    starts, first = np.zeros((len(states), len(inputs.columns), 2, 2), np.int64), 0
    branches: list[int] = []
    for slot, own in enumerate(states):
        found = _Branches(inputs)
        for number, tree in enumerate(tree for one in own for tree in one.trees):
            values = found.add(tree, number)
            leaves[first + number, [(1 << bit) % _PRIME for bit in range(len(values))]] = values
        first += found.trees
        for (place, below), words in found.words.items():
            starts[slot, place, int(below)] = len(branches), len(branches) + len(words)
            branches += sorted(words)
    counts = np.array([len(one.trees) for one in every], np.int64)
    return Regressors(
        spans_of([len(own) for own in states]), spans_of(counts), np.array([one.column for one in every], np.int64),
        np.array([one.unit for one in every], np.float64), starts, np.array(branches, np.int64), leaves,
        np.zeros(max((sum(len(one.trees) for one in own) for own in states), default=0), np.int64), inputs,
    )  # fmt: skip


class _Branches:
    """Branches of the trees of a state, see `Regressors`.

    Attributes:
        trees: Number of trees.
        words: Branches by input, and whether a code below 0 goes to the other child.
    """

    def __init__(self, inputs: Inputs) -> None:
        self.trees, self.words = 0, defaultdict[tuple[int, bool], list[int]](list)
        self._inputs = inputs

    def add(self, tree: Tree, number: int) -> list[float]:
        """Add a tree; returns the values of its leaves."""
        self.trees += 1
        return self._leaves(tree, number, 0)

    def _leaves(self, tree: Tree, number: int, first: int) -> list[float]:
        """Values of the leaves of a subtree of tree `number`; its first leaf has bit `first`."""
        if not isinstance(tree, Branch):
            return [tree]
        limit = limit_of(tree, self._inputs)
        below = limit < 0  # 0 goes to the upper child
        values = self._leaves(tree.high if below else tree.low, number, first)
        stay = _ALL & ~(((1 << len(values)) - 1) << first)
        magnitude = -1 - limit if below else limit
        self.words[tree.column, below].append((magnitude << 32) + (number << 16) + stay)
        return values + self._leaves(tree.low if below else tree.high, number, first + len(values))


def regressor(rows: np.ndarray, column: int) -> Any:  # noqa: ANN401 - of the library
    """LightGBM's regressor of a column on all others."""
    import lightgbm

    data = lightgbm.Dataset(np.delete(rows, column, axis=1), rows[:, column], params=dict(OPTIONS))
    return lightgbm.train(dict(OPTIONS), data, ROUNDS)


def _fitted(rows: np.ndarray, column: int) -> Regressor:
    """A regressor of a column, fitted to every other row."""
    trees = regressor(rows[::2], column)
    predicted = trees.predict(np.delete(rows[1::2], column, axis=1), num_threads=1)
    quantile = float(np.quantile(np.abs(rows[1::2, column] - predicted), QUANTILE))
    structures = [one["tree_structure"] for one in trees.dump_model()["tree_info"]]
    return Regressor([_tree(one, column) for one in structures], column, max(quantile, _SMALLEST))


def _tree(node: Mapping[str, Any], left_out: int) -> Tree:
    """A subtree; its inputs are all columns but one."""
    if "leaf_value" in node:
        return float(node["leaf_value"])
    column = int(node["split_feature"])
    low, high = (_tree(node[child], left_out) for child in ("left_child", "right_child"))
    return Branch(column + (column >= left_out), float(node["threshold"]), low, high)


class GradientBoostingDetector(LibraryDetector):
    """Residuals of gradient-boosted regressions."""

    model_kind, package = "gradient_boosting", "lightgbm"

    @classmethod
    def tables(cls, rows: np.ndarray, slots: np.ndarray, field_codes: FieldCodes, inputs: Inputs) -> Regressors:
        """See `LibraryDetector.tables`."""
        return regressors(rows, slots, columns_of(field_codes), inputs)
