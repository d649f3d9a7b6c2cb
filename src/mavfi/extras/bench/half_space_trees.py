"""Half-space trees (Tan, Ting and Liu, IJCAI 2011) from river: one forest for the fields of each state."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from mavfi.detectors.autoencoder import INPUT_LIMIT
from mavfi.extras.bench.field_codes import FieldCodes
from mavfi.extras.bench.forest import Branch, Forest, Tree, Trees, forest_of
from mavfi.extras.bench.library import Inputs, LibraryDetector, columns_of

_TREES, _HEIGHT, _WINDOW = 25, 8, 100
_LEAST = 0.1
"""Mass of a node / window below which the path ends (the paper's SizeLimit)."""


def half_spaces(rows: np.ndarray, slots: np.ndarray, columns: Sequence[np.ndarray], inputs: Inputs) -> Forest:
    """Forests by state, fitted in the order of the rows; they do not learn in flight.

    Args:
        rows: Training rows, shape (m, w).
        slots: Their states. Shape (m,).
        columns: By state, the columns of its codes; a state without codes or rows scores 0.
        inputs: What the columns are.
    """
    states = [_trees(rows[slots == slot], own) for slot, own in enumerate(columns)]
    return forest_of(states, inputs, sign=-1.0, shift=1.0)


def fitted(rows: np.ndarray) -> Any:  # noqa: ANN401 - of the library
    """River's forest of rows of one state, shape (m, w), m and w > 0."""
    from river.anomaly import HalfSpaceTrees

    make: Any = HalfSpaceTrees  # its types are those of dictionaries with any key
    limits = dict.fromkeys(range(rows.shape[1]), (-INPUT_LIMIT, INPUT_LIMIT))
    forest = make(n_trees=_TREES, height=_HEIGHT, window_size=min(_WINDOW, len(rows)), limits=limits, seed=0)
    for row in rows:
        forest.learn_one(dict(enumerate(row.tolist())))
    return forest


def _trees(rows: np.ndarray, own: np.ndarray) -> Trees:
    if not len(own) or not len(rows):
        return Trees([], 1.0)
    forest = fitted(rows[:, own])
    trees = [_tree(tree, own, 0, 0.0, _LEAST * forest.window_size) for tree in forest.trees]
    most = float(_TREES * forest.window_size * (2 ** (_HEIGHT + 1) - 1))
    return Trees(trees, most)


def _tree(node: Any, own: np.ndarray, depth: int, above: float, least: float) -> Tree:  # noqa: ANN401
    """A subtree; the value of a leaf is the sum of mass * 2^depth on the path to it."""
    total = above + float(node.r_mass) * 2.0**depth
    if depth == _HEIGHT or node.r_mass < least:
        return total
    low, high = (_tree(child, own, depth + 1, total, least) for child in node.children)
    return Branch(int(own[node.feature]), math.nextafter(float(node.threshold), -math.inf), low, high)


class HalfSpaceTreesDetector(LibraryDetector):
    """Half-space trees of every state."""

    model_kind, package = "half_space_trees", "river"

    @classmethod
    def tables(cls, rows: np.ndarray, slots: np.ndarray, field_codes: FieldCodes, inputs: Inputs) -> Forest:
        """See `LibraryDetector.tables`."""
        return half_spaces(rows, slots, columns_of(field_codes), inputs)
