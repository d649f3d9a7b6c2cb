"""Trees of libraries as tables, and the sums of their leaves in compiled code.

Isolation forest and half-space trees are walked, several trees at a time.  Boosted trees are evaluated by bits:
nearly all codes are near 0, where few of their branches matter.

Regression of each code on all others (ALSO: Paulheim and Meusel, Machine Learning 100, 2015) by boosted trees.

The trees are LightGBM's (Ke et al., NeurIPS 2017).  Half of the training rows of a state fit the regressors of its
codes, the other half gives the quantile of each residual.  A publication scores the largest residual of its codes in
units of these quantiles: a value that alone is normal is judged by whether it agrees with the others.
"""

import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from mavfi.detectors.autoencoder import INPUT_LIMIT
from mavfi.extras.bench.field_codes import FieldCodes
from mavfi.extras.bench.library import RATES, Inputs, LibraryDetector, OutlierDetector, columns_of, input_of
from mavfi.numerics.elementary import exp, log
from mavfi.numerics.jit import kernel_jit


class Split(NamedTuple):
    """A node with children.

    Attributes:
        column: The input that it compares.
        threshold: The largest input that goes to `low`.
        low: The child of smaller inputs.
        high: The child of larger inputs.
    """

    column: int
    threshold: float
    low: "Tree"
    high: "Tree"


Tree = float | Split
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


class StateTrees(NamedTuple):
    """Trees of a state, and the unit of the sum of their leaves (> 0)."""

    trees: Sequence[Tree]
    unit: float


CODES_FROM = -(1 << 15) - 1
_CODES_TO = 1 << 15
"""All codes are between these: they have 16 bits."""


def limit_of(branch: Split, inputs: Inputs) -> int:
    """Largest code that goes to the lower child of a branch."""
    scale = float(inputs.scale[branch.column])
    if not -INPUT_LIMIT <= branch.threshold < INPUT_LIMIT:  # inputs are clamped to these: all codes, or none
        if branch.threshold < 0.0:
            return CODES_FROM
        return _CODES_TO - 1
    # The product is rounded: correct it by the division that computes inputs.
    limit = min(max(math.floor(branch.threshold * scale), CODES_FROM), _CODES_TO - 1)
    while limit < _CODES_TO - 1 and (limit + 1) / scale <= branch.threshold:
        limit += 1
    while limit > CODES_FROM and limit / scale > branch.threshold:
        limit -= 1
    return limit


def pack(limit: int, field: int, below: int) -> int:
    """A node in one word, since a walk is as fast as its loads.

    Args:
        limit: Largest code that goes to the lower child.
        field: Index of the code, < 256.
        below: Index of the lower child, which the upper one follows; a leaf names itself.
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
    """First and one past the last index of parts of these sizes that follow each other. Shape (k, 2), int64."""
    ends = np.cumsum(counts, dtype=np.int64)
    return np.stack([ends - counts, ends], axis=1).astype(np.int64)


def forest_of(
    states: Sequence[StateTrees], inputs: Inputs, *, decays: bool = False, sign: float = 1.0, shift: float = 0.0
) -> Forest:
    """The tables of a forest.

    Args:
        states: Trees of each state.
        inputs: The inputs that they compare.
        decays: See `Forest`.
        sign: See `Forest`.
        shift: See `Forest`.
    """
    # A split is packed into a word; a leaf has a word as well, and a value.
    words: list[int] = []
    values: list[float] = []
    roots: list[int] = []
    depths: list[int] = []

    def append_leaf() -> int:
        """Append a leaf; returns its index."""
        words.append(pack(_CODES_TO, 0, len(words)))
        values.append(0.0)
        return len(words) - 1

    def fill(node: int, tree: Tree) -> list[tuple[int, Tree]]:
        """Fill in a node; returns its children with their indices."""
        if not isinstance(tree, Split):
            values[node] = tree
            return []
        words[node] = pack(limit_of(tree, inputs), int(inputs.columns[tree.column]), len(words))
        return [(append_leaf(), tree.low), (append_leaf(), tree.high)]

    # Each tree is written level by level, so that the children of a node follow each other.
    for state in states:
        for tree in state.trees:
            roots.append(len(words))
            level = [(append_leaf(), tree)]
            depth = -1  # of a tree that is a leaf: 0
            while level:
                next_level = []
                for node, subtree in level:
                    next_level += fill(node, subtree)
                level = next_level
                depth += 1
            depths.append(depth)

    # Trees of a state follow each other, too.
    return Forest(
        spans_of([len(state.trees) for state in states]),
        np.array([state.unit for state in states], np.float64),
        decays,
        sign,
        shift,
        np.array(roots, np.int64),
        np.array(depths, np.int64),
        np.array(words, np.int64),
        np.array(values, np.float64),
    )


# ---- isolation forest -----------------------------------------------------------------------------------------------
class IsolationForestDetector(OutlierDetector):
    """Isolation forest (Liu, Ting and Zhou, ICDM 2008): 100 trees of 256 rows."""

    model_kind = "isolation_forest"
    model = "pyod.models.iforest:IForest"
    options = {"n_estimators": 100, "random_state": 0, "n_jobs": 1}

    @classmethod
    def tables_of(cls, fitted: Any, inputs: Inputs, states: int) -> Any:  # noqa: ANN401
        """See the base class."""
        forest = fitted.detector_
        trees = [_isolation_tree(estimator.tree_, 0, 0) for estimator in forest.estimators_]
        unit = len(trees) * path_length(forest.max_samples_) / log(2.0)
        # One forest judges the codes of all states.
        tables = forest_of([StateTrees(trees, unit)], inputs, decays=True, shift=float(forest.offset_))
        return tables._replace(spans=np.tile(tables.spans, (states, 1)), unit=np.full(states, unit))


def path_length(rows: int) -> float:
    """Mean path length of an unsuccessful search in a binary tree of `rows` rows, c(n) of the paper's equation 1."""
    if rows <= 2:
        return float(max(rows, 1) - 1)
    return 2.0 * (log(rows - 1.0) + float(np.euler_gamma)) - 2.0 * (rows - 1.0) / rows


def _isolation_tree(tree: Any, node: int, depth: int) -> Tree:  # noqa: ANN401 - of the library
    """A subtree; the value of a leaf is its path length."""
    low = int(tree.children_left[node])
    high = int(tree.children_right[node])
    if low < 0:
        return depth + path_length(int(tree.n_node_samples[node]))
    below, above = (_isolation_tree(tree, child, depth + 1) for child in (low, high))
    return Split(int(tree.feature[node]), single_limit(float(tree.threshold[node])), below, above)


def single_limit(threshold: float) -> float:
    """Largest double that is at most the threshold once it is rounded to single precision, as the library does."""
    single = np.float32(threshold)
    below = single
    if single > threshold:
        below = np.nextafter(single, np.float32(-np.inf))
    # Doubles up to the middle between two singles are rounded to the lower one, in the middle itself to the even one.
    middle = (float(below) + float(np.nextafter(below, np.float32(np.inf)))) / 2.0
    if np.float32(middle) == below:
        return middle
    return math.nextafter(middle, -math.inf)


# ---- half-space trees (Tan, Ting and Liu, IJCAI 2011) from river: one forest for the fields of each state -----------

_TREES = 25
_HEIGHT = 8
_WINDOW = 100
"""Rows from which the masses of the nodes are counted (the paper's window size)."""
_SIZE_LIMIT = 0.1
"""Mass of a node / window below which the path ends (the paper's SizeLimit)."""


def half_spaces(rows: np.ndarray, slots: np.ndarray, columns: Sequence[np.ndarray], inputs: Inputs) -> Forest:
    """Forests by state, fitted in the order of the rows; they do not learn in flight.

    Args:
        rows: Training rows, shape (m, w).
        slots: Their states. Shape (m,).
        columns: By state, the columns of its codes; a state without codes or rows scores 0.
        inputs: What the columns are.
    """
    states = [_half_space_trees(rows[slots == slot], of_state) for slot, of_state in enumerate(columns)]
    return forest_of(states, inputs, sign=-1.0, shift=1.0)


def fitted(rows: np.ndarray) -> Any:  # noqa: ANN401 - of the library
    """River's forest of rows of one state, shape (m, w), m and w > 0."""
    from river.anomaly import HalfSpaceTrees

    untyped: Any = HalfSpaceTrees  # its type annotations allow text as keys only
    limits = dict.fromkeys(range(rows.shape[1]), (-INPUT_LIMIT, INPUT_LIMIT))
    forest = untyped(n_trees=_TREES, height=_HEIGHT, window_size=min(_WINDOW, len(rows)), limits=limits, seed=0)
    for row in rows:
        forest.learn_one(dict(enumerate(row.tolist())))
    return forest


def _half_space_trees(rows: np.ndarray, columns: np.ndarray) -> StateTrees:
    """Trees fitted to these columns of the rows of a state, in units of the largest possible sum."""
    if not len(columns) or not len(rows):
        return StateTrees([], 1.0)
    forest = fitted(rows[:, columns])
    trees = [_half_space_tree(tree, columns, 0, 0.0, _SIZE_LIMIT * forest.window_size) for tree in forest.trees]
    largest_sum = float(_TREES * forest.window_size * (2 ** (_HEIGHT + 1) - 1))
    return StateTrees(trees, largest_sum)


def _half_space_tree(node: Any, columns: np.ndarray, depth: int, above: float, min_mass: float) -> Tree:  # noqa: ANN401
    """A subtree; the value of a leaf is the sum of mass * 2^depth on the path to it."""
    total = above + float(node.r_mass) * 2.0**depth
    if depth == _HEIGHT or node.r_mass < min_mass:
        return total
    low, high = (_half_space_tree(child, columns, depth + 1, total, min_mass) for child in node.children)
    # the library sends an input equal to the threshold to the upper child
    return Split(int(columns[node.feature]), math.nextafter(float(node.threshold), -math.inf), low, high)


class HalfSpaceTreesDetector(LibraryDetector):
    """Half-space trees of every state."""

    model_kind = "half_space_trees"
    package = "river"

    @classmethod
    def tables(cls, rows: np.ndarray, slots: np.ndarray, field_codes: FieldCodes, inputs: Inputs) -> Forest:
        """See `LibraryDetector.tables`."""
        return half_spaces(rows, slots, columns_of(field_codes), inputs)


# ---- regression of each code on all others by boosted trees ---------------------------------------------------------

ROUNDS = 40
OPTIONS: Mapping[str, Any] = {
    "objective": "regression",
    "num_leaves": 15,
    "learning_rate": 0.1,
    "min_data_in_leaf": 10,
    "seed": 0,
    "deterministic": True,
    "force_row_wise": True,
    "num_threads": 1,
    "verbosity": -1,
}
"""Of every regressor: one thread, since sums of several change their order, and threads do not survive a fork."""
QUANTILE = 0.99
"""Share of residuals below the unit of the score."""
MIN_ROWS = 8
"""Rows of a state below which its codes have no regressors, and it scores 0."""
_SMALLEST_UNIT = 1e-6
_ALL_LEAVES = (1 << 16) - 1
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
    model.left[:trees] = _ALL_LEAVES
    for column in range(len(model.inputs.columns)):
        code = np.int64(codes[model.inputs.columns[column]])
        starts = model.starts[slot, column, int(code < 0)]
        for index in range(starts[0], starts[1]):
            word = model.branches[index]
            if word >> 32 >= abs(code):
                break
            model.left[(word >> 16) & _ALL_LEAVES] &= word & _ALL_LEAVES


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
    states: list[list[Regressor]] = []
    for slot, of_state in enumerate(columns):
        rows_of_state = rows[slots == slot]
        if len(rows_of_state) >= MIN_ROWS:
            states.append([_fitted(rows_of_state, int(column)) for column in of_state])
        else:
            states.append([])
    return tables_of(states, inputs)


def tables_of(states: Sequence[Sequence[Regressor]], inputs: Inputs) -> Regressors:
    """The tables of the regressors of each state."""
    all_regressors = [regressor for of_state in states for regressor in of_state]
    tree_counts = np.array([len(regressor.trees) for regressor in all_regressors], np.int64)
    leaves = np.zeros((tree_counts.sum(), _PRIME))
    starts = np.zeros((len(states), len(inputs.columns), 2, 2), np.int64)
    branches: list[int] = []
    most_trees = 0
    first = 0  # index of the state's first tree
    for slot, of_state in enumerate(states):
        trees = [tree for regressor in of_state for tree in regressor.trees]

        # 1. Number the leaves of each tree, and collect its branches by the code that they compare.
        words = BranchWords(list)
        for number, tree in enumerate(trees):
            values = _leaves(tree, number, 0, inputs, words)
            leaves[first + number, [(1 << bit) % _PRIME for bit in range(len(values))]] = values
        first += len(trees)
        most_trees = max(most_trees, len(trees))

        # 2. Store the branches, sorted by the magnitude of the code.
        for (column, is_below), of_column in words.items():
            starts[slot, column, int(is_below)] = len(branches), len(branches) + len(of_column)
            branches += sorted(of_column)
    return Regressors(
        spans=spans_of([len(of_state) for of_state in states]),
        trees=spans_of(tree_counts),
        column=np.array([regressor.column for regressor in all_regressors], np.int64),
        unit=np.array([regressor.unit for regressor in all_regressors], np.float64),
        starts=starts,
        branches=np.array(branches, np.int64),
        leaves=leaves,
        left=np.zeros(most_trees, np.int64),
        inputs=inputs,
    )


BranchWords = defaultdict[tuple[int, bool], list[int]]
"""Branches by input, and whether a code below 0 goes to the other child, see `Regressors`."""


def _leaves(tree: Tree, number: int, first: int, inputs: Inputs, words: BranchWords) -> list[float]:
    """Values of the leaves of a subtree, those of the child to which the code 0 goes first.

    Args:
        tree: The subtree.
        number: Number of its tree within the state.
        first: Bit of its first leaf.
        inputs: What its columns are.
        words: Receives its branches.
    """
    if not isinstance(tree, Split):
        return [tree]
    limit = limit_of(tree, inputs)
    is_below = limit < 0  # 0 goes to the upper child, and some codes below 0 to the other one
    if is_below:
        near = tree.high
        far = tree.low
        magnitude = -1 - limit
    else:
        near = tree.low
        far = tree.high
        magnitude = limit
    values = _leaves(near, number, first, inputs, words)
    stay = _ALL_LEAVES & ~(((1 << len(values)) - 1) << first)
    words[tree.column, is_below].append((magnitude << 32) + (number << 16) + stay)
    return values + _leaves(far, number, first + len(values), inputs, words)


def regressor(rows: np.ndarray, column: int) -> Any:  # noqa: ANN401 - of the library
    """LightGBM's regressor of a column on all others."""
    import lightgbm

    data = lightgbm.Dataset(np.delete(rows, column, axis=1), rows[:, column], params=dict(OPTIONS))
    return lightgbm.train(dict(OPTIONS), data, ROUNDS)


def _fitted(rows: np.ndarray, column: int) -> Regressor:
    """A regressor of a column, fitted to every other row; the rows between give the quantile of its residual."""
    trees = regressor(rows[::2], column)
    predicted = trees.predict(np.delete(rows[1::2], column, axis=1), num_threads=1)
    quantile = float(np.quantile(np.abs(rows[1::2, column] - predicted), QUANTILE))
    structures = [info["tree_structure"] for info in trees.dump_model()["tree_info"]]
    converted = [_boosted_tree(structure, column) for structure in structures]
    return Regressor(converted, column, max(quantile, _SMALLEST_UNIT))


def _boosted_tree(node: Mapping[str, Any], left_out: int) -> Tree:
    """A subtree; its inputs are all columns but `left_out`."""
    if "leaf_value" in node:
        return float(node["leaf_value"])
    column = int(node["split_feature"])
    low, high = (_boosted_tree(node[child], left_out) for child in ("left_child", "right_child"))
    return Split(column + (column >= left_out), float(node["threshold"]), low, high)


class GradientBoostingDetector(LibraryDetector):
    """Residuals of gradient-boosted regressions."""

    model_kind = "gradient_boosting"
    package = "lightgbm"

    @classmethod
    def tables(cls, rows: np.ndarray, slots: np.ndarray, field_codes: FieldCodes, inputs: Inputs) -> Regressors:
        """See `LibraryDetector.tables`."""
        return regressors(rows, slots, columns_of(field_codes), inputs)
