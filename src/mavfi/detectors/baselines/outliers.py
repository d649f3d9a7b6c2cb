"""Outlier detectors of PyOD (Zhao, Nasrullah and Li, JMLR 20, 2019): one model for the codes of all states."""

from typing import Any

import numpy as np

from mavfi.detectors.baselines.library import Judge, LibraryDetector
from mavfi.detectors.everything import Everything
from mavfi.numerics.elementary import exp, log

_LN_2 = 0.6931471805599453


class _Outliers:
    """A fitted PyOD model."""

    def __init__(self, model: Any) -> None:  # noqa: ANN401 - the library has no types
        self._model = model

    def scores(self, inputs: np.ndarray, slots: np.ndarray) -> np.ndarray:
        """See `Judge.scores`."""
        return np.asarray(self._model.decision_function(inputs), np.float64)


class Forest:
    """Scores of a fitted isolation forest, from its trees: for one row, the library spends 11 ms on calls of them.

    Args:
        model: PyOD's `IForest`, fitted; its `decision_function` returns the same.
    """

    def __init__(self, model: Any) -> None:  # noqa: ANN401 - the library has no types
        forest = model.detector_
        self._trees = [tree.tree_ for tree in forest.estimators_]
        self._lengths = [_path_lengths(tree) for tree in self._trees]
        self._offset = float(forest.offset_)
        self._whole = len(self._trees) * float(_unsuccessful(np.array([forest.max_samples_]))[0])

    def scores(self, inputs: np.ndarray, slots: np.ndarray) -> np.ndarray:
        """See `Judge.scores`."""
        rows = np.ascontiguousarray(inputs, np.float32)
        lengths = np.zeros(len(rows))
        for tree, of_leaf in zip(self._trees, self._lengths, strict=True):
            lengths += of_leaf[tree.apply(rows)]
        return np.array([self._offset + exp(-_LN_2 * length / self._whole) for length in lengths])


def _unsuccessful(count: np.ndarray) -> np.ndarray:
    """Mean length of an unsuccessful search in a binary tree of `count` rows (Liu et al. 2008, equation 1)."""
    rest = np.maximum(count - 1.0, 1.0)
    several = 2.0 * (np.array([log(one) for one in rest]) + np.euler_gamma) - 2.0 * rest / (rest + 1.0)
    return np.where(count <= 1, 0.0, np.where(count == 2, 1.0, several))


def _path_lengths(tree: Any) -> np.ndarray:  # noqa: ANN401
    """Length of the path to each leaf of a tree, with the mean of the subtree that was not grown. Shape (nodes,)."""
    depth = np.zeros(tree.node_count)
    for node in range(tree.node_count):  # parents precede their children
        for child in (tree.children_left[node], tree.children_right[node]):
            if child >= 0:
                depth[child] = depth[node] + 1.0
    return np.asarray(depth + _unsuccessful(tree.n_node_samples), np.float64)


class _OutlierDetector(LibraryDetector):
    """Base: a PyOD class with its options."""

    package = "pyod"

    @classmethod
    def judge(cls, inputs: np.ndarray, slots: np.ndarray, everything: Everything) -> Judge:
        """See `LibraryDetector.judge`."""
        from threadpoolctl import threadpool_limits

        with threadpool_limits(1):
            return cls.scores_of(cls.make().fit(inputs))

    @classmethod
    def scores_of(cls, model: Any) -> Judge:  # noqa: ANN401
        """Scores of a fitted model."""
        return _Outliers(model)

    @classmethod
    def make(cls) -> Any:  # noqa: ANN401
        """The model before fitting."""
        raise NotImplementedError


class IsolationForestDetector(_OutlierDetector):
    """Isolation forest (Liu, Ting and Zhou, ICDM 2008): 100 trees of 256 rows."""

    model_kind = "isolation_forest"

    @classmethod
    def make(cls) -> Any:  # noqa: ANN401
        """See the base class."""
        from pyod.models.iforest import IForest

        return IForest(n_estimators=100, random_state=0, n_jobs=1)

    @classmethod
    def scores_of(cls, model: Any) -> Judge:  # noqa: ANN401
        """See the base class."""
        return Forest(model)


class PcaDetector(_OutlierDetector):
    """Weighted distances along the principal components (Shyu et al., ICDM Workshop 2003)."""

    model_kind = "pca"

    @classmethod
    def make(cls) -> Any:  # noqa: ANN401
        """See the base class."""
        from pyod.models.pca import PCA

        return PCA(random_state=0, svd_solver="full")


class MahalanobisDetector(_OutlierDetector):
    """Mahalanobis distance with the minimum covariance determinant (Rousseeuw and Van Driessen, Technometrics 1999)."""

    model_kind = "mahalanobis"

    @classmethod
    def make(cls) -> Any:  # noqa: ANN401
        """See the base class."""
        from pyod.models.mcd import MCD

        return MCD(random_state=0)
