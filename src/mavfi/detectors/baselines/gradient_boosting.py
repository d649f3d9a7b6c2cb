"""Regression of each code on all others (ALSO: Paulheim and Meusel, Machine Learning 100, 2015) by boosted trees.

The trees are LightGBM's (Ke et al., NeurIPS 2017).  Half of the training rows of a state fit the regressors of its
codes, the other half gives the quantile of each residual.  A publication scores the largest residual of its codes in
units of these quantiles: a value that alone is normal is judged by whether it agrees with the others.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from mavfi.detectors.baselines.forest import Branch, Forest, ForestScorer, Group, Tree, forest_of
from mavfi.detectors.baselines.library import LibraryDetector, columns_of
from mavfi.detectors.everything import Everything

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


def regressors(inputs: np.ndarray, slots: np.ndarray, columns: Sequence[np.ndarray]) -> Forest:
    """Regressors of all codes, by state.

    Args:
        inputs: Training rows, shape (m, w).
        slots: Their states. Shape (m,).
        columns: By state, the columns of its codes.
    """
    return forest_of(
        [
            [_fitted(inputs[slots == slot], int(column)) for column in own] if (slots == slot).sum() >= FEWEST else []
            for slot, own in enumerate(columns)
        ]
    )


def regressor(rows: np.ndarray, column: int) -> Any:  # noqa: ANN401 - of the library
    """LightGBM's regressor of a column on all others."""
    import lightgbm

    data = lightgbm.Dataset(np.delete(rows, column, axis=1), rows[:, column], params=dict(OPTIONS))
    return lightgbm.train(dict(OPTIONS), data, ROUNDS)


def _fitted(rows: np.ndarray, column: int) -> Group:
    """A regressor of a column, fitted to every other row."""
    trees = regressor(rows[::2], column)
    predicted = trees.predict(np.delete(rows[1::2], column, axis=1), num_threads=1)
    quantile = float(np.quantile(np.abs(rows[1::2, column] - predicted), QUANTILE))
    structures = [one["tree_structure"] for one in trees.dump_model()["tree_info"]]
    return Group([_tree(one, column) for one in structures], max(quantile, _SMALLEST), column=column)


def _tree(node: Mapping[str, Any], left_out: int) -> Tree:
    """A subtree; its inputs are all columns but one."""
    if "leaf_value" in node:
        return float(node["leaf_value"])
    column = int(node["split_feature"])
    low, high = (_tree(node[child], left_out) for child in ("left_child", "right_child"))
    return Branch(column + (column >= left_out), float(node["threshold"]), low, high)


class GradientBoostingDetector(LibraryDetector):
    """Residuals of gradient-boosted regressions."""

    model_kind, package, scorer_type = "gradient_boosting", "lightgbm", ForestScorer

    @classmethod
    def tables(cls, inputs: np.ndarray, slots: np.ndarray, everything: Everything) -> Forest:
        """See `LibraryDetector.tables`."""
        return regressors(inputs, slots, columns_of(everything))
