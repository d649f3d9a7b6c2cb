"""Outlier detectors of PyOD (Zhao, Nasrullah and Li, JMLR 20, 2019): one model for the codes of all states."""

from typing import Any

import numpy as np

from mavfi.detectors.baselines.library import Judge, LibraryDetector
from mavfi.detectors.everything import Everything


class _Outliers:
    """A fitted PyOD model."""

    def __init__(self, model: Any) -> None:  # noqa: ANN401 - the library has no types
        self._model = model

    def scores(self, inputs: np.ndarray, slots: np.ndarray) -> np.ndarray:
        """See `Judge.scores`."""
        return np.asarray(self._model.decision_function(inputs), np.float64)


class _OutlierDetector(LibraryDetector):
    """Base: a PyOD class with its options."""

    package = "pyod"

    @classmethod
    def judge(cls, inputs: np.ndarray, slots: np.ndarray, everything: Everything) -> Judge:
        """See `LibraryDetector.judge`."""
        from threadpoolctl import threadpool_limits

        with threadpool_limits(1):
            return _Outliers(cls.make().fit(inputs))

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
