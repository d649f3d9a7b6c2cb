"""Detectors whose models libraries fit: training rows, scores of publications, score limits by state and regime.

A library fits its model; its numbers become tables, from which compiled code computes the library's score: a call from
Python takes longer than the kernels of the publication.
"""

import functools
from abc import abstractmethod
from collections.abc import Callable, Mapping
from importlib import import_module
from importlib.util import find_spec
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numba.extending import overload

from mavfi.detectors.autoencoder import INPUT_LIMIT, representative
from mavfi.detectors.model import Model
from mavfi.detectors.training import Sample, regime_limits
from mavfi.errors import not_installed
from mavfi.extras.bench.all_fields import (
    AllFieldsDetector,
    CodeScorer,
    Holding,
    JudgedPublication,
    StateScorer,
    conclude,
    hold,
    state_peaks,
)
from mavfi.extras.bench.field_codes import FieldCodes
from mavfi.extras.bench.residual_state import REGIME, SLOT, ResidualState
from mavfi.numerics.jit import kernel_jit

_CACHED_MODELS = 16
"""Fitted models that a process keeps."""
RATES: dict[type, Callable[..., float]] = {}
"""Score functions, by the type of a model's tables, see `rate`."""


def require(detector: str, package: str) -> None:
    """Check that the package of a detector of the extra `bench` is installed; `NotInstalledError` if not."""
    if find_spec(package) is None:
        raise not_installed(f"detector {detector!r}", package, "bench")


class Inputs(NamedTuple):
    """Inputs of a library's model: the codes of the watched fields / their largest in training, clamped.

    Attributes:
        columns: Indices of the watched fields. Shape (w,), int64.
        scale: Largest code of each in training. Shape (w,).
    """

    columns: np.ndarray
    scale: np.ndarray


@kernel_jit
def input_of(codes: np.ndarray, column: int, inputs: Inputs) -> float:
    """The input of a column in [0, w), from codes of shape (n,)."""
    return float(min(max(codes[inputs.columns[column]] / inputs.scale[column], -INPUT_LIMIT), INPUT_LIMIT))


def rate(codes: np.ndarray, slot: int, model: Any) -> float:  # noqa: ANN401 - a type in `RATES`
    """Anomaly score of a publication, any real number.

    Args:
        codes: The latest codes of all fields. Shape (n,), int16.
        slot: Index of the published state.
        model: Tables of a fitted model.
    """
    return RATES[type(model)](codes, slot, model)


@overload(rate)
def _rate(codes, slot, model):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202 - Numba compares the signatures
    function = RATES[model.instance_class]
    return lambda codes, slot, model: function(codes, slot, model)


@kernel_jit
def rates(codes: np.ndarray, slots: np.ndarray, model: Any) -> np.ndarray:  # noqa: ANN401
    """Scores of publications of states `slots`, shape (m,), see `rate`; codes have shape (m, n)."""
    scores = np.zeros(len(codes))
    for index in range(len(codes)):
        scores[index] = rate(codes[index], slots[index], model)
    return scores


@kernel_jit
def learn(
    measured: ResidualState,
    judged: JudgedPublication,
    limit: np.ndarray,
    model: Any,
    holding: Holding,
    floor: float,  # noqa: ANN401
) -> None:
    """Hold the codes of a normal publication; 0 for an anomalous one."""
    hold(measured, judged, limit, model, holding)


@kernel_jit
def update(measured: ResidualState, holding: Holding) -> None:
    """The latest codes of all states: those held, and those of the publication measured last."""
    first, last = measured.spans[measured.status[SLOT]]
    holding.vector[:] = holding.held
    holding.vector[first:last] = measured.codes[first:last]


@kernel_jit
def judge_model(
    measured: ResidualState,
    judged: JudgedPublication,
    limit: np.ndarray,
    model: Any,
    holding: Holding,
    floor: float,  # noqa: ANN401
) -> float:
    """Score of the latest codes by a model, in units of the limit of their state and regime."""
    learn(measured, judged, limit, model, holding, floor)
    update(measured, holding)
    slot = measured.status[SLOT]
    if measured.status[REGIME] >= 0:
        judged.distance[slot] = max(0.0, rate(holding.vector, slot, model) - floor)
    return conclude(slot, slot + 1, measured, judged, limit)


class ModelScorer(StateScorer):
    """Scores of a fitted model, from the latest codes of all states.

    Args:
        field_codes: Computes the codes.
        model: Tables of the fitted model.
        floor: Smallest score in training, subtracted from all scores.
    """

    judge = staticmethod(judge_model)
    learns = staticmethod(learn)

    def __init__(self, field_codes: FieldCodes, model: Any, floor: float) -> None:  # noqa: ANN401
        holding = Holding(*np.zeros((2, len(field_codes.fields)), np.int16))
        super().__init__(field_codes, model, holding, floor)
        self.memory_arrays = {**self.memory_arrays, "held": holding.held}


def scaled(vectors: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """Codes, shape (m, n), scaled and clamped as inputs of a model."""
    inputs: np.ndarray = np.clip(vectors / scale, -INPUT_LIMIT, INPUT_LIMIT)
    return inputs


def columns_of(field_codes: FieldCodes) -> list[np.ndarray]:
    """By state, the columns of its fields among all watched fields."""
    watched = field_codes.quanta > 0.0
    column_of_field = np.cumsum(watched) - 1
    columns = []
    for slot in range(len(field_codes.slots)):
        fields = np.arange(*field_codes.range_of(slot))
        columns.append(column_of_field[fields[watched[fields]]])
    return columns


class LibraryDetector(AllFieldsDetector):
    """A detector whose model a library fits.

    Attributes:
        package: Package that must be installed.
    """

    package: ClassVar[str]
    extra = "bench"

    @classmethod
    def scorer_of(cls, model: Model, field_codes: FieldCodes) -> CodeScorer:
        """Scores of the library's model, refitted to the rows stored in `model`."""
        count = len(field_codes.fields)
        stored = model.parameters.get("rows")
        row_count = len(stored) if isinstance(stored, list) else 0
        rows = model.numbers("rows", row_count, count)
        slots = model.numbers("slots", len(rows), least=0.0).astype(np.int64)
        scale = model.numbers("scale", count, least=1.0)
        if "stack" in model.provenance:
            tables = _refitted(cls.learned, model.provenance["stack"], rows.tobytes(), slots.tobytes(), scale.tobytes())
        else:
            tables = cls.learned(rows, slots, scale, field_codes)  # of messages
        return ModelScorer(field_codes, tables, float(model.numbers("floor")))

    @classmethod
    def check_installed(cls) -> None:
        """Check that the library is installed; the `NotInstalledError` names the extra to install."""
        require(cls.model_kind, cls.package)

    @classmethod
    @abstractmethod
    def tables(cls, rows: np.ndarray, slots: np.ndarray, field_codes: FieldCodes, inputs: Inputs) -> Any:  # noqa: ANN401
        """Tables of a model that the library fits to normal publications.

        Args:
            rows: Their inputs. Shape (m, w).
            slots: Their states. Shape (m,).
            field_codes: Codes from which they were made.
            inputs: How.
        """

    @classmethod
    def learned(cls, rows: np.ndarray, slots: np.ndarray, scale: np.ndarray, field_codes: FieldCodes) -> Any:  # noqa: ANN401
        """Fit the library's model to codes, dithered uniformly by half a code so that no field is constant."""
        cls.check_installed()
        generator = np.random.Generator(np.random.PCG64(0))
        dithered = rows + generator.uniform(-0.5, 0.5, rows.shape)
        columns = np.flatnonzero(field_codes.quanta > 0.0)
        return cls.tables(scaled(dithered, scale)[:, columns], slots, field_codes, Inputs(columns, scale[columns]))

    @classmethod
    def fit(cls, sample: Sample, features: FieldCodes, figures: Mapping[str, Any]) -> dict[str, Any]:
        """Parameters of a model.

        Args:
            sample: Error-free flights.
            features: Codes from which the sample was made.
            figures: `largest_class`, training publications per state and regime; `calibrated`, publications per state
                and regime from which limits are derived; `margin` and `smallest_regime`, see `regime_limits`.
        """
        # 1. Fit the model to some publications of each state and regime.
        scale = np.maximum(1.0, np.abs(sample.vectors.astype(np.float64)).max(axis=0))
        rows = representative(sample, int(figures["largest_class"]))
        model = cls.learned(sample.vectors[rows].astype(np.float64), sample.slots[rows], scale, features)

        # 2. Derive limits from its scores of others.
        chosen = representative(sample, int(figures["calibrated"]))
        part = Sample(*(getattr(sample, name)[chosen] for name in Sample.__annotations__))
        scores = rates(part.vectors, part.slots, model)
        floor = float(scores.min())
        peaks, counts = state_peaks(scores - floor, part, len(features.slots))
        limit = regime_limits(peaks, counts, float(figures["margin"]), int(figures["smallest_regime"]))

        # 3. What is stored: the rows, to which the model is fitted again.
        return {
            "rows": sample.vectors[rows].tolist(),
            "slots": sample.slots[rows].tolist(),
            "scale": scale.tolist(),
            "floor": floor,
            "limit": limit,
        }


@functools.lru_cache(_CACHED_MODELS)
def _refitted(learned: Callable[..., Any], autopilot: str, rows: bytes, slots: bytes, scale: bytes) -> Any:  # noqa: ANN401
    """Tables of a model, fitted once per process to what the model stores: a campaign has a detector per mission."""
    field_codes = FieldCodes(autopilot)
    states = np.frombuffer(slots, np.int64)
    return learned(np.frombuffer(rows).reshape(len(states), -1), states, np.frombuffer(scale), field_codes)


# ---- PyOD (Zhao, Nasrullah and Li, JMLR 20, 2019): one model for the codes of all states ----------------------------


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


RATES[Components] = rate_by_components
RATES[Ellipsoid] = rate_by_ellipsoid


class OutlierDetector(LibraryDetector):
    """A PyOD class with its options."""

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


class PcaDetector(OutlierDetector):
    """Weighted distances along the principal components (Shyu et al., ICDM Workshop 2003)."""

    model_kind = "pca"
    model = "pyod.models.pca:PCA"
    options = {"random_state": 0, "svd_solver": "full"}

    @classmethod
    def tables_of(cls, fitted: Any, inputs: Inputs, states: int) -> Any:  # noqa: ANN401
        """See the base class."""
        components = np.ascontiguousarray(fitted.selected_components_.T)
        weights = np.ascontiguousarray(fitted.selected_w_components_)
        mean = fitted.scaler_.mean_
        deviation = fitted.scaler_.scale_
        return Components(inputs, mean, deviation, components, weights, np.zeros(len(weights)))


class MahalanobisDetector(OutlierDetector):
    """Mahalanobis distance with the minimum covariance determinant (Rousseeuw and Van Driessen, Technometrics 1999)."""

    model_kind = "mahalanobis"
    model = "pyod.models.mcd:MCD"
    options = {"random_state": 0}

    @classmethod
    def tables_of(cls, fitted: Any, inputs: Inputs, states: int) -> Any:  # noqa: ANN401
        """See the base class."""
        centre = fitted.detector_.location_
        return Ellipsoid(inputs, centre, np.ascontiguousarray(fitted.detector_.get_precision()), np.zeros(len(centre)))
