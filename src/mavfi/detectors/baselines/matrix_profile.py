"""Matrix profile (Yeh et al., ICDM 2016) by stumpy: distance of a state's recent values from all training values.

The series of a state is the largest scaled code of each publication.  A new publication scores the smallest distance,
not normalized, between the subsequence that it completes and all training subsequences (an AB-join, identical to
`stumpi` fed value by value); the only memory is the subsequence itself.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from mavfi.detectors.all_fields import AllFieldsDetector
from mavfi.detectors.baselines.library import LibraryDetector, require, scaled, score_once
from mavfi.detectors.code_scorer import CodeScorer
from mavfi.detectors.everything import Everything
from mavfi.detectors.features import REGIMES
from mavfi.detectors.model import Model
from mavfi.detectors.one_score import StateScorer
from mavfi.detectors.parts import Verdict
from mavfi.detectors.samples import Sample

LENGTH = 8
"""Publications per subsequence."""
_NEVER = 1e17
"""Limit for states without a training subsequence."""


def nearest(stretch: np.ndarray, history: np.ndarray) -> float:
    """Smallest Euclidean distance of a subsequence, shape (LENGTH,), from a history, shape (k,); 0 if too short."""
    if len(history) < LENGTH:
        return 0.0
    from stumpy.core import mass_absolute

    return float(mass_absolute(stretch, history).min())


class Histories:
    """Distances from the training series of each state; their inputs are subsequences, see `Judge.scores`."""

    def __init__(self, series: list[np.ndarray]) -> None:
        self._series = series

    def scores(self, inputs: np.ndarray, slots: np.ndarray) -> np.ndarray:
        """Distances of subsequences, shape (m, LENGTH), of states, shape (m,). Shape (m,)."""
        return np.array([nearest(row, self._series[slot]) for row, slot in zip(inputs, slots, strict=True)])


class StretchScorer(StateScorer):
    """Distances of the latest subsequences.

    Args:
        everything: Computes the codes.
        history: Training series, by state; shorter ones end with NaN. Shape (slots, k).
        scale: Largest code in training. Shape (n,).
    """

    def __init__(self, everything: Everything, history: list[np.ndarray], scale: np.ndarray) -> None:
        super().__init__(everything)
        self._judge, self._scale = Histories(history), scale
        self._last = np.zeros((len(everything.slots), LENGTH - 1))
        self._published = np.zeros(len(everything.slots))
        self._new = 0.0
        self.kept = {**self.kept, "last": self._last, "published": self._published}

    def value(self, slot: int) -> float:
        """The newest value of a state's series."""
        own = slice(*self.everything.range_of(slot))
        return float(np.abs(scaled(self._codes[own], self._scale[own])).max())

    def score_of(self, slot: int, regime: int) -> float:
        """See `StateScorer.score_of`; 0 until the first subsequence is complete."""
        self._new = self.value(slot)
        if self._published[slot] < LENGTH - 1:
            return 0.0
        return score_once(self._judge, slot, np.append(self._last[slot], self._new).tobytes())

    def learn(self, slot: int, verdict: Verdict | None) -> None:
        """Store a value that consumers received, normal or not, as in training.

        After an anomaly that was left out, the subsequence ended before it, and any next value was an anomaly as well.
        """
        self._last[slot, :-1] = self._last[slot, 1:]
        self._last[slot, -1] = self.value(slot)
        self._published[slot] += 1.0


class MatrixProfileDetector(AllFieldsDetector):
    """Matrix profile of every state."""

    model_kind = "matrix_profile"
    extra = LibraryDetector.extra

    @classmethod
    def scorer_of(cls, model: Model, everything: Everything) -> CodeScorer:
        """Scorer of the distance between the newest subsequence of each state and those of training."""
        cls.check_installed()
        states = len(everything.slots)
        given = model.parameters.get("history")
        rows = given if isinstance(given, list) and len(given) == states else [[]] * states
        history = [Model.numbers(_of(model, row), "row", len(row)) for row in rows]
        return StretchScorer(everything, history, model.numbers("scale", len(everything.fields), least=1.0))

    @classmethod
    def check_installed(cls) -> None:
        """See `LibraryDetector`."""
        require("stumpy")

    @classmethod
    def fit(cls, sample: Sample, everything: Everything, figures: Mapping[str, Any]) -> dict[str, Any]:
        """Parameters of a model.

        Args:
            sample: Error-free flights.
            everything: Codes from which the sample was made.
            figures: `history`, stored values per state, from the first half of its series; `calibrated`, subsequences
                of the second half from which limits are derived; `margin`, limit / largest distance.
        """
        cls.check_installed()
        scale = np.maximum(1.0, np.abs(sample.vectors.astype(np.float64)).max(axis=0))
        histories, limit = [], np.full((len(everything.slots), REGIMES), _NEVER)
        for slot in range(len(limit)):
            own = slice(*everything.range_of(slot))
            series = np.abs(scaled(sample.vectors[sample.slots == slot, own], scale[own])).max(axis=1)
            half = len(series) // 2
            history, rest = series[: min(half, int(figures["history"]))], series[half:]
            histories.append(history.tolist())
            ends = range(LENGTH, min(len(rest), LENGTH + int(figures["calibrated"])))
            found = [nearest(rest[end - LENGTH : end], history) for end in ends]
            if found and len(history) >= LENGTH:
                limit[slot] = max(float(figures["margin"]) * max(found), 1e-3)
        return {"history": histories, "scale": scale.tolist(), "limit": limit.tolist()}


def _of(model: Model, row: list[float]) -> Model:
    return Model(model.kind, model.profile, model.monitored, model.prediction, {"row": row}, model.provenance)
