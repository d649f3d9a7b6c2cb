"""Detectors of all fields (`field_codes`), learned from golden runs: limits per residual, and an autoencoder.

Their scorers, and those of detectors from libraries, judge codes in compiled code.
"""

from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar, NamedTuple

import numpy as np

from mavfi.detectors.autoencoder import INPUT_LIMIT, Network, fit_autoencoder, network_of
from mavfi.detectors.detector import Detector
from mavfi.detectors.features import REGIMES
from mavfi.detectors.model import SMALLEST_LIMIT, Model
from mavfi.detectors.scoring import Reading, Scorer, ScoringDetector, Threshold, score_of
from mavfi.detectors.training import Sample, TrainedDetector, regime_limits
from mavfi.extras.bench.field_codes import ALL_FIELDS, COMPILED, MONITORED, FieldCodes
from mavfi.extras.bench.message_codes import MessageCodes
from mavfi.extras.bench.residual_state import LEARNED, NEVER, REGIME, SLOT, ResidualState
from mavfi.numerics.elementary import quick_tanh
from mavfi.numerics.jit import entry, kernel_jit
from mavfi.states import State, StateSpec


class JudgedPublication(NamedTuple):
    """Score of the publication judged last.

    Attributes:
        distance: See `scoring.Reading`. Shape (n,).
        unit: See `scoring.Reading`. Shape (n,).
        ratios: See `scoring.Threshold`. Shape (n,).
        score: Shape (1,).
    """

    distance: np.ndarray
    unit: np.ndarray
    ratios: np.ndarray
    score: np.ndarray


@kernel_jit
def conclude(first: int, last: int, measured: ResidualState, judged: JudgedPublication, limit: np.ndarray) -> float:
    """Score of the distances [first, last), also stored."""
    reading = Reading(judged.distance, judged.unit, first, last, measured.status[REGIME])
    judged.score[0] = score_of(reading, limit, judged.ratios)
    return float(judged.score[0])


class CodeScorer(Scorer):
    """A scorer of the codes of all fields: a publication costs one call for its codes and one for its score.

    Each call commits what the publication before it left, if that was accepted.

    Args:
        field_codes: Computes the codes.
        tables: Further tables and memory of the compiled functions.

    Attributes:
        judge: Compiled: residual state, `JudgedPublication`, limits of the threshold, then the tables; returns the
            score of the publication measured last.
        learns: Compiled: adapts to an accepted publication; same arguments as `judge`. None: nothing is learned.
    """

    judge: ClassVar[Callable[..., float]]
    learns: ClassVar[Callable[..., None] | None] = None

    def __init__(self, field_codes: FieldCodes, *tables: Any) -> None:  # noqa: ANN401 - arrays, tuples of them, numbers
        self.field_codes = field_codes
        self.memory_arrays = {"known": field_codes.measured.known}
        self.fields = field_codes.fields
        self.stages = field_codes.stages
        self.states = field_codes.states
        self._distance = np.zeros(len(self.fields))
        self._unit = np.ones(len(self.fields))
        self._tables: tuple[Any, ...] = tables
        self._slots = field_codes.slots

    def span(self, slot: int) -> tuple[int, int]:
        """First and one past the last index of the distances that a publication of a state updates."""
        return self.field_codes.range_of(slot)

    def use(self, threshold: Threshold) -> None:
        """Set the threshold; called before the first flight."""
        super().use(threshold)
        judged = JudgedPublication(self._distance, self._unit, threshold.ratios, np.zeros(1))
        self._judged_last = judged
        self._tables = (self.field_codes.measured, judged, threshold.limit, *self._tables)
        self.instrument({})

    @property
    def compiled(self) -> Mapping[str, Callable[..., Any]]:
        """See `Scorer.compiled`."""
        return {**COMPILED, "judge": self.judge}

    def instrument(self, made: Mapping[str, Callable[..., Any]]) -> None:
        """See `Scorer.instrument`."""
        self.field_codes.instrument(made)
        self._judge: Callable[..., float] = entry(made.get("judge", self.judge), *self._tables)

    def __getstate__(self) -> dict[str, Any]:
        """Pickle without machine code and addresses, which are valid in one process only."""
        return {name: value for name, value in self.__dict__.items() if name != "_judge"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Inverse of `__getstate__`."""
        self.__dict__.update(state)
        self.instrument({})

    def start(self) -> None:
        """Reset the memory at the start of a flight."""
        super().start()
        self.field_codes.forget()
        self.candidate = None

    def score(self, state: State) -> float | None:
        """Score of a publication."""
        slot = self._slots.get(state.spec.name)
        if slot is None:
            return None
        self.candidate = state
        self.field_codes.read(state, slot)
        return float(self._judge(*self._tables))

    def last_reading(self) -> Reading:
        """Reading of the publication scored last."""
        judged = self._judged_last
        status = self.field_codes.measured.status
        first, last = self.span(int(status[SLOT]))
        return Reading(judged.distance, judged.unit, first, last, int(status[REGIME]))

    def accept(self, state: State) -> None:
        """Record a published value."""
        if state is not self.candidate:
            if state.spec.name not in self._slots:
                self.field_codes.note(state)
                return
            self.score(state)
        self.field_codes.accept()

    def _settle(self) -> None:
        self.field_codes.settle()
        if self.learns is not None:
            self.learns(*self._tables)

    def memory(self) -> tuple[bytes, ...]:
        """Memory between publications."""
        self._settle()
        return super().memory()

    def arrays(self) -> dict[str, np.ndarray]:
        """Memory between publications by name: the arrays themselves, not copies."""
        self._settle()
        self.candidate = None
        return super().arrays()

    def restore(self, memory: tuple[bytes, ...]) -> None:
        """Inverse of `memory`."""
        super().restore(memory)
        self.field_codes.forget()
        self.candidate = None

    def not_finite(self, state: State) -> np.ndarray:
        """Indices of the watched fields of a publication that are not finite."""
        return self.field_codes.not_finite(state)


class StateScorer(CodeScorer):
    """A scorer with one distance per state instead of one per field: its fields are the states.

    Args:
        field_codes: See `CodeScorer`.
        tables: See `CodeScorer`.
    """

    def __init__(self, field_codes: FieldCodes, *tables: Any) -> None:  # noqa: ANN401 - see `CodeScorer`
        super().__init__(field_codes, *tables)
        self.fields = tuple(field_codes.slots)
        self.stages = tuple(field_codes.stages[field_codes.range_of(slot)[0]] for slot in field_codes.slots.values())
        self._distance = np.zeros(len(self.fields))
        self._unit = np.ones(len(self.fields))

    def span(self, slot: int) -> tuple[int, int]:
        """See `CodeScorer.span`."""
        return slot, slot + 1

    def not_finite(self, state: State) -> np.ndarray:
        """The state itself."""
        return np.array([self.field_codes.slots[state.spec.name]])


def state_peaks(scores: np.ndarray, sample: Sample, slots: int) -> tuple[np.ndarray, np.ndarray]:
    """Largest score in training and number of samples, by state and regime. Shapes (slots, regimes).

    Args:
        scores: Score of each publication of a sample, >= 0. Shape (m,).
        sample: The publications.
        slots: Number of states.
    """
    group = sample.slots * REGIMES + sample.regimes
    peaks = np.full(slots * REGIMES, 1e-9)  # limits, by which scores are divided, must not be 0
    np.maximum.at(peaks, group, scores)
    counts = np.bincount(group, minlength=slots * REGIMES)
    return peaks.reshape(slots, REGIMES), counts.reshape(slots, REGIMES)


# ---- detectors ------------------------------------------------------------------------------------------------------


@kernel_jit
def from_centre(codes: np.ndarray, centre: np.ndarray, regime: int, distance: np.ndarray) -> None:
    """Distances of codes, shape (n,), from the centre for their regime, shape (n, regimes)."""
    for index in range(len(codes)):
        distance[index] = abs(codes[index] - centre[index, regime])


@kernel_jit
def judge_limits(measured: ResidualState, judged: JudgedPublication, limit: np.ndarray, centre: np.ndarray) -> float:
    """Score of the distances from the centre of each field and regime, shape (n, regimes)."""
    first, last = measured.spans[measured.status[SLOT]]
    regime = measured.status[REGIME]
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
    function, since faults are drawn in its instructions.  So they are here: other names of arrays change their order.
    """
    sizes, weights = network.sizes, network.weights
    now, after = network.work[0], network.work[1]
    now[: sizes[0]] = inputs
    start = 0
    for layer in range(1, len(sizes)):
        before, neurons = sizes[layer - 1], sizes[layer]
        hidden, intercepts = layer < len(sizes) - 1, start + before * neurons
        low, high = (0, neurons) if hidden else (first, last)  # hidden layers are computed as a whole
        # weighted sums of the layer before, source by source: rows are contiguous
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
def residuals_of_part(vector: np.ndarray, network: Network, first: int, last: int, errors: np.ndarray) -> None:
    """Absolute reconstruction errors of the codes [first, last) of a vector, into `errors`; see `residuals`."""
    inputs = network.work[2, : len(vector)]
    for index in range(len(vector)):
        inputs[index] = min(max(vector[index] / network.scale[index], -INPUT_LIMIT), INPUT_LIMIT)
    reconstruct_part(inputs, network, first, last)
    for index in range(first, last):
        errors[index] = abs(inputs[index] - network.work[0, index])


@kernel_jit
def hold(
    measured: ResidualState, judged: JudgedPublication, limit: np.ndarray, network: Network, holding: Holding
) -> None:
    """Hold the codes of a normal publication; 0 for an anomalous one."""
    if measured.status[LEARNED] == NEVER:
        return
    first, last = measured.spans[measured.status[LEARNED]]
    for index in range(first, last):
        holding.held[index] = holding.vector[index] if judged.score[0] <= 1.0 else 0
    measured.status[LEARNED] = NEVER


@kernel_jit
def judge_reconstruction(
    measured: ResidualState, judged: JudgedPublication, limit: np.ndarray, network: Network, holding: Holding
) -> float:
    """Score of the reconstruction errors of the latest codes; see `hold`."""
    hold(measured, judged, limit, network, holding)
    first, last = measured.spans[measured.status[SLOT]]
    holding.vector[:] = holding.held
    holding.vector[first:last] = measured.codes[first:last]
    if measured.status[REGIME] >= 0:
        residuals_of_part(holding.vector, network, first, last, judged.distance)
    return conclude(first, last, measured, judged, limit)


class ReconstructionScorer(CodeScorer):
    """Reconstruction errors of the latest codes; each code is judged once, see `AutoencoderScorer`."""

    judge = staticmethod(judge_reconstruction)
    learns = staticmethod(hold)

    def __init__(self, field_codes: FieldCodes, network: Network) -> None:
        holding = Holding(*np.zeros((2, len(field_codes.fields)), np.int16))
        super().__init__(field_codes, network, holding)
        self.memory_arrays = {**self.memory_arrays, "held": holding.held}


class AllFieldsDetector(ScoringDetector, TrainedDetector):
    """A learned detector of all fields, with a limit for each distance and regime.

    Args:
        model: A model of the detector's kind.
        field_codes: Codes that the model was trained on, unless these are those of missions.
    """

    training = ALL_FIELDS

    def __init__(self, model: Model, field_codes: FieldCodes | None = None) -> None:
        scorer = self.scorer_of(model, field_codes or FieldCodes(model.provenance["stack"]))
        limit = model.numbers("limit", len(scorer.fields), REGIMES, least=SMALLEST_LIMIT)
        super().__init__(self.model_kind, scorer, Threshold(limit, len(limit)))

    @classmethod
    @abstractmethod
    def scorer_of(cls, model: Model, field_codes: FieldCodes) -> CodeScorer:
        """The scorer with the parameters of a model."""

    @classmethod
    def of_messages(
        cls, recordings: Sequence[Sequence[State]], specs: Mapping[str, StateSpec], figures: Mapping[str, Any]
    ) -> Detector:
        """See `TrainedDetector`."""
        cls.check_installed()
        codes = MessageCodes(specs, recordings)
        parameters = cls.fit(codes.samples(recordings), codes, figures)
        return cls(Model(cls.model_kind, "tuned", MONITORED, "", parameters, {}), codes)


class LimitsDetector(AllFieldsDetector):
    """A learned limit for each field and regime."""

    model_kind = "limits"

    @classmethod
    def scorer_of(cls, model: Model, field_codes: FieldCodes) -> CodeScorer:
        """Scorer of distances from the centres."""
        return LimitScorer(field_codes, model.numbers("centre", len(field_codes.fields), REGIMES))

    @classmethod
    def fit(cls, sample: Sample, features: FieldCodes, figures: Mapping[str, Any]) -> dict[str, Any]:
        """Centre and limit of each field and regime; a distance of one code never raises an alarm.

        Args:
            sample: Error-free flights.
            features: Codes from which the sample was made.
            figures: `margin`, limit / largest distance in training; `smallest_regime`: a regime with fewer samples
                takes the largest limit among the regimes of its field.
        """
        shape = len(features.fields), REGIMES
        centre = np.zeros(shape)
        peaks = np.ones(shape)
        counts = np.zeros(shape, np.int64)
        for slot in range(len(features.slots)):
            fields = slice(*features.range_of(slot))
            for regime in range(REGIMES):
                rows = (sample.slots == slot) & (sample.regimes == regime)
                values = sample.vectors[rows, fields].astype(np.float64)
                counts[fields, regime] = len(values)
                if len(values):
                    centre[fields, regime] = values.mean(axis=0)
                    peaks[fields, regime] = np.maximum(1.0, np.abs(values - centre[fields, regime]).max(axis=0))
        return {
            "centre": centre.tolist(),
            "limit": regime_limits(peaks, counts, figures["margin"], figures["smallest_regime"]),
        }


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
