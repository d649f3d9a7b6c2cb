"""The detector `limits`: a learned limit for each residual of all fields (`field_codes`), by regime.

A publication is judged in compiled code: a call from Python takes longer than the kernels of the publication.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from mavfi.detectors.detector import Detector
from mavfi.detectors.features import REGIMES
from mavfi.detectors.model import SMALLEST_LIMIT, Model
from mavfi.detectors.scoring import Reading, Scorer, ScoringDetector, Threshold, score_of
from mavfi.detectors.training import Sample, TrainedDetector, regime_limits
from mavfi.extras.bench.field_codes import ALL_FIELDS, COMPILED, MONITORED, FieldCodes
from mavfi.extras.bench.message_codes import MessageCodes
from mavfi.extras.bench.residual_state import REGIME, SLOT, ResidualState
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


class LimitScorer(Scorer):
    """Distances of codes from their centres: a publication costs one call for its codes and one for its score.

    Each call commits what the publication before it left, if that was accepted.

    Args:
        field_codes: Computes the codes.
        centre: Centre of each field and regime. Shape (n, regimes).
    """

    def __init__(self, field_codes: FieldCodes, centre: np.ndarray) -> None:
        self.field_codes = field_codes
        self.memory_arrays = {"known": field_codes.measured.known}
        self.fields = field_codes.fields
        self.stages = field_codes.stages
        self.states = field_codes.states
        self._slots = field_codes.slots
        self._centre = centre

    def use(self, threshold: Threshold) -> None:
        """Set the threshold; called before the first flight."""
        super().use(threshold)
        size = len(self.fields)
        self._judged_last = JudgedPublication(np.zeros(size), np.ones(size), threshold.ratios, np.zeros(1))
        self._arguments = (self.field_codes.measured, self._judged_last, threshold.limit, self._centre)
        self.instrument({})

    @property
    def compiled(self) -> Mapping[str, Callable[..., Any]]:
        """See `Scorer.compiled`."""
        return {**COMPILED, "judge": judge_limits}

    def instrument(self, made: Mapping[str, Callable[..., Any]]) -> None:
        """See `Scorer.instrument`."""
        self.field_codes.instrument(made)
        self._judge: Callable[..., float] = entry(made.get("judge", judge_limits), *self._arguments)

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
        return float(self._judge(*self._arguments))

    def last_reading(self) -> Reading:
        """Reading of the publication scored last."""
        judged = self._judged_last
        status = self.field_codes.measured.status
        first, last = self.field_codes.range_of(int(status[SLOT]))
        return Reading(judged.distance, judged.unit, first, last, int(status[REGIME]))

    def accept(self, state: State) -> None:
        """Record a published value."""
        if state is not self.candidate:
            if state.spec.name not in self._slots:
                self.field_codes.note(state)
                return
            self.score(state)
        self.field_codes.accept()

    def memory(self) -> tuple[bytes, ...]:
        """Memory between publications."""
        self.field_codes.settle()
        return super().memory()

    def arrays(self) -> dict[str, np.ndarray]:
        """Memory between publications by name: the arrays themselves, not copies."""
        self.field_codes.settle()
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


class LimitsDetector(ScoringDetector, TrainedDetector):
    """A learned limit for each field and regime.

    Args:
        model: A model of this kind.
        field_codes: Codes that the model was trained on, unless these are those of missions.
    """

    model_kind = "limits"
    training = ALL_FIELDS

    def __init__(self, model: Model, field_codes: FieldCodes | None = None) -> None:
        codes = field_codes or FieldCodes(model.provenance["stack"])
        size = len(codes.fields)
        scorer = LimitScorer(codes, model.numbers("centre", size, REGIMES))
        limit = model.numbers("limit", size, REGIMES, least=SMALLEST_LIMIT)
        super().__init__(self.model_kind, scorer, Threshold(limit, size))

    @classmethod
    def of_messages(
        cls, recordings: Sequence[Sequence[State]], specs: Mapping[str, StateSpec], figures: Mapping[str, Any]
    ) -> Detector:
        """See `TrainedDetector`."""
        codes = MessageCodes(specs, recordings)
        parameters = cls.fit(codes.samples(recordings), codes, figures)
        return cls(Model(cls.model_kind, "tuned", MONITORED, "", parameters, {}), codes)

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
