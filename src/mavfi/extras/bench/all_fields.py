"""Detectors of all fields (`field_codes`): limits per residual, and an autoencoder; both learned from golden runs."""

from abc import abstractmethod
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from mavfi.detectors.autoencoder import INPUT_LIMIT, Network, fit_autoencoder, network_of
from mavfi.detectors.features import REGIMES
from mavfi.detectors.model import SMALLEST_LIMIT, Model
from mavfi.detectors.scoring import ScoringDetector, Threshold
from mavfi.detectors.training import Sample, TrainedDetector, regime_limits
from mavfi.extras.bench.code_scorer import CodeScorer, Judged, conclude
from mavfi.extras.bench.field_codes import ALL_FIELDS, FieldCodes
from mavfi.extras.bench.residual_state import LEARNED, NEVER, REGIME, SLOT, ResidualState
from mavfi.numerics.elementary import quick_tanh
from mavfi.numerics.jit import kernel_jit


@kernel_jit
def from_centre(codes: np.ndarray, centre: np.ndarray, regime: int, distance: np.ndarray) -> None:
    """Distances of codes, shape (n,), from the centre for their regime, shape (n, regimes)."""
    for index in range(len(codes)):
        distance[index] = abs(codes[index] - centre[index, regime])


@kernel_jit
def judge_limits(measured: ResidualState, judged: Judged, limit: np.ndarray, centre: np.ndarray) -> float:
    """Score of the distances from the centre of each field and regime, shape (n, regimes)."""
    first, last = measured.spans[measured.place[SLOT]]
    regime = measured.place[REGIME]
    if regime >= 0:
        from_centre(measured.codes[first:last], centre[first:last], regime, judged.distance[first:last])
    return conclude(first, last, measured, judged, limit)


class LimitScorer(CodeScorer):
    """Distances from the centre of each field and regime, shape (n, regimes), passed as its table."""

    judge = staticmethod(judge_limits)


class Holding(NamedTuple):
    """The latest normal codes of all states.

    Attributes:
        held: Codes; 0 after an anomalous publication of their state. Shape (n,), int16.
        vector: The same with the codes of the publication judged last. Shape (n,), int16.
    """

    held: np.ndarray
    vector: np.ndarray


@kernel_jit
def reconstruct_part(inputs: np.ndarray, network: Network, first: int, last: int) -> None:
    """Outputs [first, last) of the network, into the first row of `work`; see `autoencoder.reconstruct`.

    A publication is judged by its own fields: the last layer computes no others.  `reconstruct` is not built of this
    function, since faults are drawn in its instructions.
    """
    sizes, weights = network.sizes, network.weights
    now, after = network.work[0], network.work[1]
    now[: sizes[0]] = inputs
    start = 0
    for layer in range(1, len(sizes)):
        before, neurons = sizes[layer - 1], sizes[layer]
        hidden, intercepts = layer < len(sizes) - 1, start + before * neurons
        low, high = (0, neurons) if hidden else (first, last)
        total = after[low:high]
        total[:] = 0.0
        for source in range(before):
            value, row = now[source], weights[start + source * neurons + low : start + source * neurons + high]
            for neuron in range(high - low):
                total[neuron] += value * row[neuron]
        for neuron in range(high - low):
            total[neuron] += weights[intercepts + low + neuron]
        if hidden:
            for neuron in range(high - low):
                total[neuron] = quick_tanh(total[neuron])
        start = intercepts + neurons
        now[low:high] = total


@kernel_jit
def residuals_of_part(
    vector: np.ndarray, network: Network, first: int, last: int, errors: np.ndarray
) -> None:  # fmt: skip
    """Absolute reconstruction errors of the codes [first, last) of a vector, into `errors`; see `residuals`."""
    inputs = network.work[2, : len(vector)]
    for index in range(len(vector)):
        inputs[index] = min(max(vector[index] / network.scale[index], -INPUT_LIMIT), INPUT_LIMIT)
    reconstruct_part(inputs, network, first, last)
    for index in range(first, last):
        errors[index] = abs(inputs[index] - network.work[0, index])


@kernel_jit
def hold(measured: ResidualState, judged: Judged, limit: np.ndarray, network: Network, holding: Holding) -> None:
    """Hold the codes of a normal publication; 0 for an anomalous one."""
    if measured.place[LEARNED] == NEVER:
        return
    first, last = measured.spans[measured.place[LEARNED]]
    for index in range(first, last):
        holding.held[index] = holding.vector[index] if judged.score[0] <= 1.0 else 0
    measured.place[LEARNED] = NEVER


@kernel_jit
def judge_reconstruction(
    measured: ResidualState, judged: Judged, limit: np.ndarray, network: Network, holding: Holding
) -> float:  # fmt: skip
    """Score of the reconstruction errors of the latest codes; see `hold`."""
    hold(measured, judged, limit, network, holding)
    first, last = measured.spans[measured.place[SLOT]]
    holding.vector[:] = holding.held
    holding.vector[first:last] = measured.codes[first:last]
    if measured.place[REGIME] >= 0:
        residuals_of_part(holding.vector, network, first, last, judged.distance)
    return conclude(first, last, measured, judged, limit)


class ReconstructionScorer(CodeScorer):
    """Reconstruction errors of the latest codes; each code is judged once, see `AutoencoderScorer`."""

    judge, learns = staticmethod(judge_reconstruction), staticmethod(hold)

    def __init__(self, field_codes: FieldCodes, network: Network) -> None:
        holding = Holding(*np.zeros((2, len(field_codes.fields)), np.int16))
        super().__init__(field_codes, network, holding)
        self.kept = {**self.kept, "held": holding.held}


class AllFieldsDetector(ScoringDetector, TrainedDetector):
    """A learned detector of all fields, with a limit for each distance and regime.

    Args:
        model: A model of the detector's kind.
    """

    training = ALL_FIELDS

    def __init__(self, model: Model) -> None:
        scorer = self.scorer_of(model, FieldCodes(model.provenance["stack"]))
        limit = model.numbers("limit", len(scorer.fields), REGIMES, least=SMALLEST_LIMIT)
        super().__init__(self.model_kind, scorer, Threshold(limit, len(limit)))

    @classmethod
    @abstractmethod
    def scorer_of(cls, model: Model, field_codes: FieldCodes) -> CodeScorer:
        """The scorer with the parameters of a model."""


class LimitsDetector(AllFieldsDetector):
    """A learned limit for each field and regime."""

    model_kind = "limits"

    @classmethod
    def scorer_of(cls, model: Model, field_codes: FieldCodes) -> CodeScorer:
        """Scorer of distances from the centres."""
        return LimitScorer(field_codes, model.numbers("centre", len(field_codes.fields), REGIMES))

    @classmethod
    def fit(cls, sample: Sample, features: FieldCodes, figures: Mapping[str, Any]) -> dict[str, Any]:
        """See `fit_limits`."""
        return fit_limits(sample, features, **figures)


class AutoencoderAllDetector(AllFieldsDetector):
    """An autoencoder of all fields, with a limit for each output and regime."""

    model_kind = "autoencoder_all"

    @classmethod
    def scorer_of(cls, model: Model, field_codes: FieldCodes) -> CodeScorer:
        """Scorer of reconstruction errors."""
        return ReconstructionScorer(field_codes, network_of(model, len(field_codes.fields)))

    @classmethod
    def fit(cls, sample: Sample, features: FieldCodes, figures: Mapping[str, Any]) -> dict[str, Any]:
        """See `fit_autoencoder`."""
        return fit_autoencoder(sample, **figures)


def fit_limits(sample: Sample, field_codes: FieldCodes, margin: float, smallest_regime: int) -> dict[str, Any]:
    """Centre and limit of each field and regime; a distance of one code never raises an alarm.

    Args:
        sample: Error-free flights.
        field_codes: Codes from which the sample was made.
        margin: Limit / largest distance in training.
        smallest_regime: A regime with fewer samples takes the largest limit among the regimes of its field.
    """
    centre, peaks, counts = centre_and_peaks(sample, field_codes)
    return {"centre": centre.tolist(), "limit": regime_limits(peaks, counts, margin, smallest_regime)}


def centre_and_peaks(sample: Sample, field_codes: FieldCodes) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Centre, largest distance (at least 1) and number of samples of each field and regime. Shapes (n, regimes)."""
    shape = len(field_codes.fields), REGIMES
    centre, peaks, counts = np.zeros(shape), np.ones(shape), np.zeros(shape, np.int64)
    for slot in range(len(field_codes.slots)):
        own = slice(*field_codes.range_of(slot))
        for regime in range(REGIMES):
            values = sample.vectors[(sample.slots == slot) & (sample.regimes == regime), own].astype(np.float64)
            counts[own, regime] = len(values)
            if len(values):
                centre[own, regime] = values.mean(axis=0)
                peaks[own, regime] = np.maximum(1.0, np.abs(values - centre[own, regime]).max(axis=0))
    return centre, peaks, counts
