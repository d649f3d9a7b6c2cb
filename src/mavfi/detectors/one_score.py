"""Detectors with one score per publication instead of one per field; their fields are the states."""

from typing import Any

import numpy as np

from mavfi.detectors.code_scorer import CodeScorer
from mavfi.detectors.everything import Everything
from mavfi.detectors.features import REGIMES
from mavfi.detectors.samples import Sample
from mavfi.states import STATES, State


class OfStates(CodeScorer):
    """One distance per state: an alarm names the published state."""

    def __init__(self, everything: Everything, *tables: Any, **given: Any) -> None:  # noqa: ANN401 - see `CodeScorer`
        super().__init__(everything, *tables, **given)
        self.fields = tuple(everything.slots)
        self.stages = tuple(STATES[name].stage.value for name in self.fields)
        self._distance, self._unit = np.zeros(len(self.fields)), np.ones(len(self.fields))

    def span(self, slot: int) -> tuple[int, int]:
        """See `CodeScorer.span`."""
        return slot, slot + 1

    def not_finite(self, state: State) -> np.ndarray:
        """The state itself."""
        return np.array([self.everything.slots[state.spec.name]])


def state_peaks(scores: np.ndarray, sample: Sample, slots: int) -> tuple[np.ndarray, np.ndarray]:
    """Largest score in training and number of samples, by state and regime. Shapes (slots, regimes).

    Args:
        scores: Score of each publication of a sample, >= 0. Shape (m,).
        sample: The publications.
        slots: Number of states.
    """
    place = sample.slots * REGIMES + sample.regimes
    peaks = np.full(slots * REGIMES, 1e-9)
    np.maximum.at(peaks, place, scores)
    counts = np.bincount(place, minlength=slots * REGIMES)
    return peaks.reshape(slots, REGIMES), counts.reshape(slots, REGIMES)
