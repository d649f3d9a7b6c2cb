"""Detectors of all fields (`everything`): limits per residual, and an autoencoder; both learned from golden runs."""

from abc import abstractmethod
from collections.abc import Callable, Mapping
from typing import Any, ClassVar

import numpy as np

from mavfi.detectors.autoencoder import Network, fit_autoencoder, network_of, residuals
from mavfi.detectors.everything import COMPILED, Everything
from mavfi.detectors.features import REGIMES
from mavfi.detectors.model import SMALLEST_LIMIT, Model
from mavfi.detectors.parts import Reading, Scorer, ScoringDetector, Threshold, Verdict, find_policy, score_of
from mavfi.detectors.samples import Sample, regime_limits
from mavfi.numerics.jit import kernel_jit
from mavfi.states import State


class CodeScorer(Scorer):
    """A scorer of the codes of all fields.

    Args:
        everything: Computes the codes.

    Attributes:
        own: Compiled functions that it calls beside those of `everything` and of the threshold, by name.
        functions: All functions that it calls, by name; those in `compiled`, or instrumented ones.
    """

    own: ClassVar[Mapping[str, Callable[..., Any]]] = {}

    def __init__(self, everything: Everything) -> None:
        self.everything, self.kept = everything, {"known": everything.known}
        self.functions = everything.functions
        self.functions.update(self.own)
        self.fields, self.stages = everything.fields, everything.stages
        size = len(self.fields)
        self._codes = np.zeros(size, np.int16)
        self._distance, self._unit = np.zeros(size), np.ones(size)

    @abstractmethod
    def measure(self, slot: int, regime: int) -> None:
        """Fill in `_distance` for a publication of a state, whose `_codes` are up to date."""

    @property
    def compiled(self) -> dict[str, Callable[..., Any]]:
        """See `Scorer.compiled`."""
        return {**COMPILED, "score_of": score_of, **self.own}

    def instrument(self, made: Mapping[str, Callable[..., Any]]) -> None:
        """See `Scorer.instrument`."""
        self.functions.update({**self.compiled, **made})
        self.threshold.score_of = self.functions["score_of"]

    def span(self, slot: int) -> tuple[int, int]:
        """First and one past the last index of the distances that a publication of a state updates."""
        return self.everything.range_of(slot)

    def read(self, state: State) -> Reading | None:
        """Measure a publication."""
        slot = self.everything.slots.get(state.spec.name)
        if slot is None:
            return None
        regime = self.everything.measure(state, slot, self._codes)
        if regime >= 0:
            self.measure(slot, regime)
        return Reading(self._distance, self._unit, *self.span(slot), regime)

    def accept(self, state: State, verdict: Verdict | None) -> None:
        """Record a published value."""
        slot = self.everything.slots.get(state.spec.name)
        if slot is None:
            self.everything.note(state)
            return
        self.everything.measure(state, slot, self._codes, keep=True)
        self.learn(slot, verdict)

    def learn(self, slot: int, verdict: Verdict | None) -> None:  # noqa: B027 - few learn
        """Adapt to a publication, whose `_codes` are up to date."""

    def not_finite(self, state: State) -> np.ndarray:
        """Indices of the watched fields of a publication that are not finite."""
        return self.everything.not_finite(state)


@kernel_jit
def from_centre(codes: np.ndarray, centre: np.ndarray, regime: int, distance: np.ndarray) -> None:
    """Distances of codes, shape (n,), from the centre for their regime, shape (n, regimes)."""
    for index in range(len(codes)):
        distance[index] = abs(codes[index] - centre[index, regime])


class LimitScorer(CodeScorer):
    """Distances from the centre of each field and regime, shape (n, regimes)."""

    own: ClassVar = {"from_centre": from_centre}

    def __init__(self, everything: Everything, centre: np.ndarray) -> None:
        super().__init__(everything)
        self._centre = centre

    def measure(self, slot: int, regime: int) -> None:
        """See `CodeScorer.measure`."""
        own = slice(*self.everything.range_of(slot))
        self.functions["from_centre"](self._codes[own], self._centre[own], regime, self._distance[own])


class HoldingScorer(CodeScorer):
    """A scorer of the latest normal codes of all states; anomalous codes are replaced by 0."""

    adapts = True

    def __init__(self, everything: Everything) -> None:
        super().__init__(everything)
        self._held = np.zeros_like(self._codes)
        self.kept = {**self.kept, "held": self._held}

    def vector(self, slot: int) -> np.ndarray:
        """Codes of all states, with the current ones of one state. Shape (n,)."""
        own, vector = slice(*self.everything.range_of(slot)), self._held.copy()
        vector[own] = self._codes[own]
        return vector

    def learn(self, slot: int, verdict: Verdict | None) -> None:
        """Hold the codes of a normal publication; 0 for an anomalous one."""
        own = slice(*self.everything.range_of(slot))
        self._held[own] = self._codes[own] if verdict is not None and verdict.score <= 1.0 else 0


class ReconstructionScorer(HoldingScorer):
    """Reconstruction errors of the latest codes; each code is judged once, see `AutoencoderScorer`."""

    own: ClassVar = {"residuals": residuals}

    def __init__(self, everything: Everything, network: Network) -> None:
        super().__init__(everything)
        self._network = network

    def measure(self, slot: int, regime: int) -> None:
        """See `CodeScorer.measure`."""
        self.functions["residuals"](self.vector(slot), self._network, self._distance)


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
