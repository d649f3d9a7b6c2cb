"""Half-space trees (Tan, Ting and Liu, IJCAI 2011) from river: one forest for the fields of each state."""

from typing import Any

import numpy as np

from mavfi.detectors.autoencoder import INPUT_LIMIT
from mavfi.detectors.baselines.library import Judge, LibraryDetector, columns_of
from mavfi.detectors.everything import Everything

_TREES, _HEIGHT, _WINDOW = 25, 8, 100


class Forests:
    """Forests by state, fitted in the order of the rows; they do not learn in flight.

    Args:
        inputs: Training rows, see `Judge.scores`.
        slots: Their states.
        columns: By state, the columns of its codes; a state without codes scores 0.
    """

    def __init__(self, inputs: np.ndarray, slots: np.ndarray, columns: list[np.ndarray]) -> None:
        self._columns = columns
        self._forests = [self._forest(inputs[slots == slot][:, own]) for slot, own in enumerate(columns)]

    @staticmethod
    def _forest(rows: np.ndarray) -> Any:  # noqa: ANN401 - of the library
        from river.anomaly import HalfSpaceTrees

        make: Any = HalfSpaceTrees  # its types are those of dictionaries with any key
        limits = dict.fromkeys(range(rows.shape[1]), (-INPUT_LIMIT, INPUT_LIMIT))
        window = max(1, min(_WINDOW, len(rows)))
        forest = make(n_trees=_TREES, height=_HEIGHT, window_size=window, limits=limits, seed=0)
        for row in rows if limits else ():  # without codes there is nothing to learn
            forest.learn_one(dict(enumerate(row.tolist())))
        return forest

    def scores(self, inputs: np.ndarray, slots: np.ndarray) -> np.ndarray:
        """See `Judge.scores`."""
        return np.array(
            [
                self._forests[slot].score_one(dict(enumerate(row[self._columns[slot]].tolist())))
                for row, slot in zip(inputs, slots, strict=True)
            ]
        )


class HalfSpaceTreesDetector(LibraryDetector):
    """Half-space trees of every state."""

    model_kind = "half_space_trees"
    package = "river"

    @classmethod
    def judge(cls, inputs: np.ndarray, slots: np.ndarray, everything: Everything) -> Judge:
        """See `LibraryDetector.judge`."""
        return Forests(inputs, slots, columns_of(everything))
