"""Outlier detectors of PyOD (Zhao, Nasrullah and Li, JMLR 20, 2019): one model for the codes of all states."""

import math
from abc import abstractmethod
from collections.abc import Mapping
from importlib import import_module
from typing import Any, ClassVar, NamedTuple

import numpy as np

from mavfi.extras.bench.field_codes import FieldCodes
from mavfi.extras.bench.library import RATES, Inputs, LibraryDetector, input_of
from mavfi.extras.bench.trees import Branch, Tree, Trees, forest_of
from mavfi.numerics.elementary import log
from mavfi.numerics.jit import kernel_jit


class Components(NamedTuple):
    """Principal components; the score is the sum of the distances from them, each divided by its eigenvalue's share.

    Attributes:
        inputs: The inputs.
        mean: Of each input in training. Shape (w,).
        deviation: Of each input in training. Shape (w,).
        components: Shape (w, c).
        weights: Share of each component in the variance. Shape (c,).
        squares: Squared distances, work. Shape (c,).
    """

    inputs: Inputs
    mean: np.ndarray
    deviation: np.ndarray
    components: np.ndarray
    weights: np.ndarray
    squares: np.ndarray


@kernel_jit
def rate_by_components(codes: np.ndarray, slot: int, model: Components) -> float:
    """See `library.rate`."""
    model.squares[:] = 0.0
    for index in range(len(model.mean)):
        value = (input_of(codes, index, model.inputs) - model.mean[index]) / model.deviation[index]
        for component in range(len(model.squares)):
            away = value - model.components[index, component]
            model.squares[component] += away * away
    total = 0.0
    for component in range(len(model.squares)):
        total += np.sqrt(model.squares[component]) / model.weights[component]
    return total


class Ellipsoid(NamedTuple):
    """A centre and a precision matrix; the score is the squared Mahalanobis distance.

    Attributes:
        inputs: The inputs.
        centre: Shape (w,).
        precision: Shape (w, w).
        product: Precision times difference, work. Shape (w,).
    """

    inputs: Inputs
    centre: np.ndarray
    precision: np.ndarray
    product: np.ndarray


@kernel_jit
def rate_by_ellipsoid(codes: np.ndarray, slot: int, model: Ellipsoid) -> float:
    """See `library.rate`."""
    model.product[:] = 0.0
    for index in range(len(model.centre)):
        away = input_of(codes, index, model.inputs) - model.centre[index]
        for other in range(len(model.centre)):
            model.product[other] += away * model.precision[index, other]
    total = 0.0
    for index in range(len(model.centre)):
        total += (input_of(codes, index, model.inputs) - model.centre[index]) * model.product[index]
    return total


RATES[Components], RATES[Ellipsoid] = rate_by_components, rate_by_ellipsoid


class _OutlierDetector(LibraryDetector):
    """Base: a PyOD class with its options."""

    package = "pyod"
    model: ClassVar[str]
    """Module and class of the model."""
    options: ClassVar[Mapping[str, Any]]

    @classmethod
    def make(cls) -> Any:  # noqa: ANN401 - the library has no types
        """The model before fitting."""
        module, _, name = cls.model.partition(":")
        return getattr(import_module(module), name)(**cls.options)

    @classmethod
    def tables(cls, rows: np.ndarray, slots: np.ndarray, field_codes: FieldCodes, inputs: Inputs) -> Any:  # noqa: ANN401
        """See `LibraryDetector.tables`."""
        from threadpoolctl import threadpool_limits

        with threadpool_limits(1):
            return cls.tables_of(cls.make().fit(rows), inputs, len(field_codes.slots))

    @classmethod
    @abstractmethod
    def tables_of(cls, fitted: Any, inputs: Inputs, states: int) -> Any:  # noqa: ANN401
        """The tables of a fitted model of these inputs, for this number of states."""


class IsolationForestDetector(_OutlierDetector):
    """Isolation forest (Liu, Ting and Zhou, ICDM 2008): 100 trees of 256 rows."""

    model_kind = "isolation_forest"
    model, options = "pyod.models.iforest:IForest", {"n_estimators": 100, "random_state": 0, "n_jobs": 1}

    @classmethod
    def tables_of(cls, fitted: Any, inputs: Inputs, states: int) -> Any:  # noqa: ANN401
        """See the base class."""
        forest = fitted.detector_
        trees = [_isolation_tree(one.tree_, 0, 0) for one in forest.estimators_]
        unit = len(trees) * path_length(forest.max_samples_) / log(2.0)
        found = forest_of([Trees(trees, unit)], inputs, decays=True, shift=float(forest.offset_))
        return found._replace(spans=np.tile(found.spans, (states, 1)), unit=np.full(states, unit))


def path_length(rows: int) -> float:
    """Mean path length of an unsuccessful search in a binary tree of `rows` rows, c(n) of the paper's equation 1."""
    if rows <= 2:
        return float(max(rows, 1) - 1)
    return 2.0 * (log(rows - 1.0) + float(np.euler_gamma)) - 2.0 * (rows - 1.0) / rows


def _isolation_tree(tree: Any, node: int, depth: int) -> Tree:  # noqa: ANN401 - of the library
    """A subtree; the value of a leaf is its path length."""
    low, high = int(tree.children_left[node]), int(tree.children_right[node])
    if low < 0:
        return depth + path_length(int(tree.n_node_samples[node]))
    below, above = (_isolation_tree(tree, child, depth + 1) for child in (low, high))
    return Branch(int(tree.feature[node]), single_limit(float(tree.threshold[node])), below, above)


def single_limit(threshold: float) -> float:
    """Largest double that is at most the threshold once it is rounded to single precision, as the library does."""
    single = np.float32(threshold)
    below = single if single <= threshold else np.nextafter(single, np.float32(-np.inf))
    middle = (float(below) + float(np.nextafter(below, np.float32(np.inf)))) / 2.0
    return middle if np.float32(middle) == below else math.nextafter(middle, -math.inf)


class PcaDetector(_OutlierDetector):
    """Weighted distances along the principal components (Shyu et al., ICDM Workshop 2003)."""

    model_kind = "pca"
    model, options = "pyod.models.pca:PCA", {"random_state": 0, "svd_solver": "full"}

    @classmethod
    def tables_of(cls, fitted: Any, inputs: Inputs, states: int) -> Any:  # noqa: ANN401
        """See the base class."""
        components = np.ascontiguousarray(fitted.selected_components_.T)
        weights = np.ascontiguousarray(fitted.selected_w_components_)
        mean, deviation = fitted.scaler_.mean_, fitted.scaler_.scale_
        return Components(inputs, mean, deviation, components, weights, np.zeros(len(weights)))


class MahalanobisDetector(_OutlierDetector):
    """Mahalanobis distance with the minimum covariance determinant (Rousseeuw and Van Driessen, Technometrics 1999)."""

    model_kind = "mahalanobis"
    model, options = "pyod.models.mcd:MCD", {"random_state": 0}

    @classmethod
    def tables_of(cls, fitted: Any, inputs: Inputs, states: int) -> Any:  # noqa: ANN401
        """See the base class."""
        centre = fitted.detector_.location_
        return Ellipsoid(inputs, centre, np.ascontiguousarray(fitted.detector_.get_precision()), np.zeros(len(centre)))
