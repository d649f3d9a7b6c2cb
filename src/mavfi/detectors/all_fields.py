"""Detectors of all fields (`everything`): limits per residual, and an autoencoder; both learned from golden runs."""

from abc import abstractmethod
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from mavfi.detectors import book
from mavfi.detectors.autoencoder import (
    INPUT_LIMIT,
    NETWORK,
    Network,
    Recent,
    fit_autoencoder,
    network_of,
    no_recent,
    recall,
    row_of,
)
from mavfi.detectors.book import Book
from mavfi.detectors.code_scorer import CodeScorer, Judged, conclude, kind_with
from mavfi.detectors.everything import Everything
from mavfi.detectors.features import REGIMES
from mavfi.detectors.model import SMALLEST_LIMIT, Model
from mavfi.detectors.parts import ScoringDetector, Threshold, find_policy
from mavfi.detectors.samples import Sample, regime_limits
from mavfi.numerics.elementary import quick_tanh
from mavfi.numerics.jit import kernel_jit, short_jit
from mavfi.numerics.lent import header_of
from mavfi.numerics.stored import load


@kernel_jit
def from_centre(codes: np.ndarray, centre: np.ndarray, regime: int, distance: np.ndarray) -> None:
    """Distances of codes, shape (n,), from the centre for their regime, shape (n, regimes)."""
    for index in range(len(codes)):
        distance[index] = abs(codes[index] - centre[index, regime])


@kernel_jit
def judge_limits(own: Book, judged: Judged, limit: np.ndarray, centre: np.ndarray) -> float:
    """Score of the distances from the centre of each field and regime, shape (n, regimes)."""
    first, last = own.spans[own.place[book.SLOT]]
    regime = own.place[book.REGIME]
    if regime >= 0:
        from_centre(own.codes[first:last], centre[first:last], regime, judged.distance[first:last])
    return conclude(first, last, own, judged, limit)


_LIMITS = kind_with(np.zeros((1, 1)))


@kernel_jit
def _limits_at(address: int) -> float:
    own, judged, limit, centre = load(address, _LIMITS)
    return judge_limits(own, judged, limit, centre)


@short_jit
def _admit_limits(address: int, header: Any) -> bool:
    own, judged, limit, centre = load(address, _LIMITS)
    book.measure(header_of(header), own)
    return book.accept_unless_alarm(judge_limits(own, judged, limit, centre), own)


class LimitScorer(CodeScorer):
    """Distances from the centre of each field and regime, shape (n, regimes), passed as its table."""

    judge, judge_at, kind = staticmethod(judge_limits), staticmethod(_limits_at), _LIMITS
    admit_at = staticmethod(_admit_limits)


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
def hold(own: Book, judged: Judged, limit: np.ndarray, network: Network, holding: Holding) -> None:
    """Hold the codes of a normal publication; 0 for an anomalous one."""
    if own.place[book.LEARNED] == book.NEVER:
        return
    first, last = own.spans[own.place[book.LEARNED]]
    for index in range(first, last):
        holding.held[index] = holding.vector[index] if judged.score[0] <= 1.0 else 0
    own.place[book.LEARNED] = book.NEVER


@kernel_jit
def judge_reconstruction(
    own: Book, judged: Judged, limit: np.ndarray, network: Network, holding: Holding
) -> float:  # fmt: skip
    """Score of the reconstruction errors of the latest codes; see `hold`."""
    hold(own, judged, limit, network, holding)
    first, last = own.spans[own.place[book.SLOT]]
    holding.vector[:] = holding.held
    holding.vector[first:last] = own.codes[first:last]
    if own.place[book.REGIME] >= 0:
        residuals_of_part(holding.vector, network, first, last, judged.distance)
    return conclude(first, last, own, judged, limit)


_RECONSTRUCTION = kind_with(NETWORK, Holding(*np.zeros((2, 1), np.int16)))


@kernel_jit
def _reconstruction_at(address: int) -> float:
    own, judged, limit, network, holding = load(address, _RECONSTRUCTION)
    return judge_reconstruction(own, judged, limit, network, holding)


_REMEMBERED = 16
"""Vectors of each state whose errors are remembered."""
_ADMISSION = kind_with(NETWORK, Holding(*np.zeros((2, 1), np.int16)), no_recent(1, 1))


@kernel_jit
def _judge_again(
    own: Book, judged: Judged, limit: np.ndarray, network: Network, holding: Holding, recent: Recent
) -> float:  # fmt: skip
    """`judge_reconstruction`, which is not built of this function, since faults are drawn in its instructions.

    More than half of the publications have the codes of their predecessor, and so have the other states.
    """
    hold(own, judged, limit, network, holding)
    slot = own.place[book.SLOT]
    first, last = own.spans[slot]
    holding.vector[:] = holding.held
    holding.vector[first:last] = own.codes[first:last]
    if own.place[book.REGIME] >= 0:
        row = slot * _REMEMBERED + row_of(holding.vector, _REMEMBERED)
        if not recall(holding.vector, recent, row):
            residuals_of_part(holding.vector, network, first, last, recent.errors[row])
        judged.distance[first:last] = recent.errors[row, first:last]
    return conclude(first, last, own, judged, limit)


@short_jit
def _admit_reconstruction(address: int, header: Any) -> bool:
    own, judged, limit, network, holding, recent = load(address, _ADMISSION)
    book.measure(header_of(header), own)
    return book.accept_unless_alarm(_judge_again(own, judged, limit, network, holding, recent), own)


class ReconstructionScorer(CodeScorer):
    """Reconstruction errors of the latest codes; each code is judged once, see `AutoencoderScorer`."""

    judge, judge_at, learns = staticmethod(judge_reconstruction), staticmethod(_reconstruction_at), staticmethod(hold)
    admit_at, kind, admission = staticmethod(_admit_reconstruction), _RECONSTRUCTION, _ADMISSION

    def __init__(self, everything: Everything, network: Network) -> None:
        holding = Holding(*np.zeros((2, len(everything.fields)), np.int16))
        recent = no_recent(_REMEMBERED * len(everything.slots), len(everything.fields))
        super().__init__(everything, network, holding, recent=recent)
        self.kept = {**self.kept, "held": holding.held}


class AllFieldsDetector(ScoringDetector):
    """A learned detector of all fields, with a limit for each distance and regime.

    Args:
        model: A model of the detector's kind.
        policy: "paper" or "keyed", see `parts.POLICIES`.
    """

    model_kind: str
    watches_all = True

    def __init__(self, model: Model, policy: str = "keyed") -> None:
        scorer = self.scorer_of(model, Everything(model.provenance["stack"]))
        limit = model.numbers("limit", len(scorer.fields), REGIMES, least=SMALLEST_LIMIT)
        super().__init__(self.model_kind, scorer, Threshold(limit, len(limit)), find_policy(policy))

    @classmethod
    @abstractmethod
    def scorer_of(cls, model: Model, everything: Everything) -> CodeScorer:
        """The scorer with the parameters of a model."""

    @classmethod
    @abstractmethod
    def fit(cls, sample: Sample, everything: Everything, figures: Mapping[str, Any]) -> dict[str, Any]:
        """Parameters of a model, from error-free flights and the settings in configs/detectors."""


class LimitsDetector(AllFieldsDetector):
    """A learned limit for each field and regime."""

    model_kind = "limits"

    @classmethod
    def scorer_of(cls, model: Model, everything: Everything) -> CodeScorer:
        """Scorer of distances from the centres."""
        return LimitScorer(everything, model.numbers("centre", len(everything.fields), REGIMES))

    @classmethod
    def fit(cls, sample: Sample, everything: Everything, figures: Mapping[str, Any]) -> dict[str, Any]:
        """See `fit_limits`."""
        return fit_limits(sample, everything, **figures)


class AutoencoderAllDetector(AllFieldsDetector):
    """An autoencoder of all fields, with a limit for each output and regime."""

    model_kind = "autoencoder_all"

    @classmethod
    def scorer_of(cls, model: Model, everything: Everything) -> CodeScorer:
        """Scorer of reconstruction errors."""
        return ReconstructionScorer(everything, network_of(model, len(everything.fields)))

    @classmethod
    def fit(cls, sample: Sample, everything: Everything, figures: Mapping[str, Any]) -> dict[str, Any]:
        """See `fit_autoencoder`."""
        return fit_autoencoder(sample, **figures)


def fit_limits(sample: Sample, everything: Everything, margin: float, smallest_regime: int) -> dict[str, Any]:
    """Centre and limit of each field and regime; a distance of one code never raises an alarm.

    Args:
        sample: Error-free flights.
        everything: Codes from which the sample was made.
        margin: Limit / largest distance in training.
        smallest_regime: A regime with fewer samples takes the largest limit among the regimes of its field.
    """
    centre, peaks, counts = centre_and_peaks(sample, everything)
    return {"centre": centre.tolist(), "limit": regime_limits(peaks, counts, margin, smallest_regime)}


def centre_and_peaks(sample: Sample, everything: Everything) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Centre, largest distance (at least 1) and number of samples of each field and regime. Shapes (n, regimes)."""
    shape = len(everything.fields), REGIMES
    centre, peaks, counts = np.zeros(shape), np.ones(shape), np.zeros(shape, np.int64)
    for slot in range(len(everything.slots)):
        own = slice(*everything.range_of(slot))
        for regime in range(REGIMES):
            values = sample.vectors[(sample.slots == slot) & (sample.regimes == regime), own].astype(np.float64)
            counts[own, regime] = len(values)
            if len(values):
                centre[own, regime] = values.mean(axis=0)
                peaks[own, regime] = np.maximum(1.0, np.abs(values - centre[own, regime]).max(axis=0))
    return centre, peaks, counts
