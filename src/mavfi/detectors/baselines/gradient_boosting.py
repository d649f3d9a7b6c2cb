"""Regression of each code on all others (ALSO: Paulheim and Meusel, Machine Learning 100, 2015) by boosted trees.

The trees are LightGBM's (Ke et al., NeurIPS 2017).  Half of the training rows of a state fit the regressors of its
codes, the other half gives the quantile of each residual.  A publication scores the largest residual of its codes in
units of these quantiles: a value that alone is normal is judged by whether it agrees with the others.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from mavfi.detectors.baselines.library import Judge, LibraryDetector, columns_of
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


class _Regressor(NamedTuple):
    """Predicts one code from the others.

    Attributes:
        column: The code, among all watched ones.
        trees: LightGBM's booster.
        quantile: Of the absolute residual, `QUANTILE`.
    """

    column: int
    trees: Any
    quantile: float

    def ratios(self, inputs: np.ndarray) -> np.ndarray:
        """Absolute residuals of rows, shape (m, n), in units of the quantile. Shape (m,)."""
        found: np.ndarray = _residuals(self.trees, inputs, self.column) / self.quantile
        return found


class Regressors:
    """Regressors of all codes, by state.

    Args:
        inputs: Training rows, see `Judge.scores`.
        slots: Their states.
        columns: By state, the columns of its codes.
    """

    def __init__(self, inputs: np.ndarray, slots: np.ndarray, columns: list[np.ndarray]) -> None:
        self._of_state = [
            [_fitted(inputs[slots == slot], int(column)) for column in own] if (slots == slot).sum() >= FEWEST else []
            for slot, own in enumerate(columns)
        ]

    def scores(self, inputs: np.ndarray, slots: np.ndarray) -> np.ndarray:
        """See `Judge.scores`."""
        found = np.zeros(len(slots))
        for slot in np.unique(slots):
            own = slots == slot
            for regressor in self._of_state[slot]:
                found[own] = np.maximum(found[own], regressor.ratios(inputs[own]))
        return found


def _fitted(rows: np.ndarray, column: int) -> _Regressor:
    """A regressor of a column, fitted to every other row."""
    import lightgbm

    data = lightgbm.Dataset(np.delete(rows[::2], column, axis=1), rows[::2, column], params=dict(OPTIONS))
    trees = lightgbm.train(dict(OPTIONS), data, ROUNDS)
    quantile = float(np.quantile(_residuals(trees, rows[1::2], column), QUANTILE))
    return _Regressor(column, trees, max(quantile, _SMALLEST))


def _residuals(trees: Any, rows: np.ndarray, column: int) -> np.ndarray:  # noqa: ANN401 - of the library
    found: np.ndarray = np.abs(rows[:, column] - trees.predict(np.delete(rows, column, axis=1), num_threads=1))
    return found


class GradientBoostingDetector(LibraryDetector):
    """Residuals of gradient-boosted regressions."""

    model_kind = "gradient_boosting"
    package = "lightgbm"

    @classmethod
    def judge(cls, inputs: np.ndarray, slots: np.ndarray, everything: Everything) -> Judge:
        """See `LibraryDetector.judge`."""
        return Regressors(inputs, slots, columns_of(everything))
