"""What scorers share that measure deltas of watched fields: the features, and the memory of them."""

from abc import abstractmethod

import numpy as np

from mavfi.detectors import features
from mavfi.detectors.parts import Reading, Scorer, Verdict
from mavfi.detectors.preprocess import Preprocessor
from mavfi.states import State


class DeltaScorer(Scorer):
    """A scorer of the deltas of a preprocessor; see `parts.Scorer`.

    Args:
        preprocessor: Of the fields that the model was trained on.
    """

    def __init__(self, preprocessor: Preprocessor) -> None:
        self.features, self.kept = preprocessor, preprocessor.kept
        self.fields, self.stages = preprocessor.fields, preprocessor.stages
        size = len(self.fields)
        self._deltas = np.zeros(size, np.int16)
        self._distance, self._unit = np.zeros(size), np.ones(size)

    @abstractmethod
    def measure(self, content: np.ndarray, slot: int) -> int:
        """Fill in `_deltas`, `_distance` and, where they are no plain numbers, `_unit`; see `features.measure`."""

    def read(self, state: State) -> Reading | None:
        """Measure a publication."""
        slot = self.features.slots.get(state.spec.name)
        if slot is None:
            return None
        regime = self.measure(state.header.view(np.uint8), slot)
        return Reading(self._distance, self._unit, *self.features.range_of(slot), regime)

    def accept(self, state: State, verdict: Verdict | None) -> None:
        """Take note of a value that was published."""
        slot = self.features.slots.get(state.spec.name)
        if slot is None:
            self.features.note(state)
            return
        content = state.header.view(np.uint8)
        if verdict is not None and self.adapts:
            self.learn(content, slot, verdict)
        features.commit(content, slot, self.features.watch)

    def learn(self, content: np.ndarray, slot: int, verdict: Verdict) -> None:  # noqa: B027 - few learn
        """Adapt to a value that was published, before it becomes the last one; `_deltas` are its own."""

    def not_finite(self, state: State) -> np.ndarray:
        """Indices of the watched fields of a publication that are not finite."""
        first, last = self.features.range_of(self.features.slots[state.spec.name])
        found = features.not_finite(state.header.view(np.uint8), self.features.watch.table[first:last])
        return first + np.flatnonzero(found)
