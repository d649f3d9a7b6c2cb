"""Common base of library adapters: training rows, scores of publications, score limits by state and regime."""

import functools
from abc import abstractmethod
from collections.abc import Callable, Hashable, Mapping
from importlib.util import find_spec
from typing import Any, Protocol

import numpy as np

from mavfi.detectors.all_fields import AllFieldsDetector
from mavfi.detectors.autoencoder import INPUT_LIMIT, representative
from mavfi.detectors.code_scorer import CodeScorer
from mavfi.detectors.everything import Everything
from mavfi.detectors.model import Model
from mavfi.detectors.one_score import StateScorer, state_peaks
from mavfi.detectors.parts import Verdict
from mavfi.detectors.samples import Sample, regime_limits
from mavfi.errors import NotInstalledError

_BATCH = 20_000
_FITTED = 16
"""Judges that a process keeps."""


class Judge(Hashable, Protocol):
    """A fitted model of a library."""

    def scores(self, inputs: np.ndarray, slots: np.ndarray) -> np.ndarray:
        """Anomaly scores of publications, any real numbers.

        Args:
            inputs: Codes of all watched fields / their largest in training. Shape (m, n).
            slots: Index of the published state. Shape (m,).

        Returns:
            Shape (m,), float64.
        """


@functools.lru_cache(1 << 15)
def score_once(judge: Judge, slot: int, content: bytes) -> float:
    """Score of a publication, computed once per input: most publications repeat an earlier one.

    Args:
        judge: The model.
        slot: Index of the published state.
        content: Bytes of its inputs, float64.
    """
    return float(judge.scores(np.frombuffer(content).copy()[None], np.array([slot]))[0])


class Own:
    """A judge as that of one detector: detectors of one model share what was fitted, but not `score_once`."""

    def __init__(self, judge: Judge) -> None:
        self.scores = judge.scores


def require(package: str) -> None:
    """Check that a package of the extra `bench` is installed; `NotInstalledError` if not."""
    if find_spec(package) is None:
        raise NotInstalledError(f"package {package!r}: not installed; install it with: pip install 'mavfi[bench]'")


class LibraryScorer(StateScorer):
    """Scores of a fitted model, from the latest codes of all states.

    Args:
        everything: Computes the codes.
        judge: The model.
        scale: Largest code in training. Shape (n,).
        floor: Smallest score in training, subtracted from all scores.
    """

    adapts = True

    def __init__(self, everything: Everything, judge: Judge, scale: np.ndarray, floor: float) -> None:
        super().__init__(everything)
        self._held = np.zeros_like(self._codes)
        self.kept = {**self.kept, "held": self._held}
        self._judge, self._scale, self._floor = judge, scale, floor
        self._watched = everything.quanta > 0.0

    def score_of(self, slot: int, regime: int) -> float:
        """See `StateScorer.score_of`."""
        own, vector = slice(*self.everything.range_of(slot)), self._held.copy()
        vector[own] = self._codes[own]
        inputs = scaled(vector[None], self._scale)[:, self._watched]
        return max(0.0, score_once(self._judge, slot, inputs.tobytes()) - self._floor)

    def learn(self, slot: int, verdict: Verdict | None) -> None:
        """Hold the codes of a normal publication; 0 for an anomalous one."""
        own = slice(*self.everything.range_of(slot))
        self._held[own] = self._codes[own] if verdict is not None and verdict.score <= 1.0 else 0


def scaled(vectors: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """Codes, shape (m, n), scaled and clamped as inputs of a model."""
    found: np.ndarray = np.clip(vectors / scale, -INPUT_LIMIT, INPUT_LIMIT)
    return found


def columns_of(everything: Everything) -> list[np.ndarray]:
    """By state, the columns of its fields among all watched fields."""
    place = np.cumsum(everything.quanta > 0.0) - 1
    spans = [np.arange(*everything.range_of(slot)) for slot in range(len(everything.slots))]
    return [place[own[everything.quanta[own] > 0.0]] for own in spans]


class LibraryDetector(AllFieldsDetector):
    """A detector from a library.

    Attributes:
        package: Package that must be installed.
    """

    package: str
    extra = "bench"

    @classmethod
    def scorer_of(cls, model: Model, everything: Everything) -> CodeScorer:
        """Scores of the library's model, refitted to the rows stored in `model`."""
        count, given = len(everything.fields), model.parameters.get("rows")
        rows = model.numbers("rows", len(given) if isinstance(given, list) else 0, count)
        slots = model.numbers("slots", len(rows), least=0.0).astype(np.int64)
        scale = model.numbers("scale", count, least=1.0)
        judge = _refitted(cls.learned, model.provenance["stack"], rows.tobytes(), slots.tobytes(), scale.tobytes())
        return LibraryScorer(everything, Own(judge), scale, float(model.numbers("floor")))

    @classmethod
    def check_installed(cls) -> None:
        """Check that the library is installed; the `NotInstalledError` names the extra to install."""
        require(cls.package)

    @classmethod
    @abstractmethod
    def judge(cls, inputs: np.ndarray, slots: np.ndarray, everything: Everything) -> Judge:
        """Fit a model of the library to normal publications; arguments as for `Judge.scores`."""

    @classmethod
    def learned(cls, rows: np.ndarray, slots: np.ndarray, scale: np.ndarray, everything: Everything) -> Judge:
        """Fit the library's model to codes, dithered uniformly by half a code so that no field is constant."""
        cls.check_installed()
        generator = np.random.Generator(np.random.PCG64(0))
        dithered = rows + generator.uniform(-0.5, 0.5, rows.shape)
        return cls.judge(scaled(dithered, scale)[:, everything.quanta > 0.0], slots, everything)

    @classmethod
    def fit(cls, sample: Sample, everything: Everything, figures: Mapping[str, Any]) -> dict[str, Any]:
        """Parameters of a model.

        Args:
            sample: Error-free flights.
            everything: Codes from which the sample was made.
            figures: `largest_class`, training publications per state and regime; `calibrated`, publications per state
                and regime from which limits are derived; `margin` and `smallest_regime`, see `regime_limits`.
        """
        scale = np.maximum(1.0, np.abs(sample.vectors.astype(np.float64)).max(axis=0))
        rows = representative(sample, int(figures["largest_class"]))
        judge = cls.learned(sample.vectors[rows].astype(np.float64), sample.slots[rows], scale, everything)
        chosen = representative(sample, int(figures["calibrated"]))
        part = Sample(*(getattr(sample, name)[chosen] for name in Sample.__annotations__))
        scores = np.concatenate(
            [
                judge.scores(
                    scaled(part.vectors[start : start + _BATCH], scale)[:, everything.quanta > 0.0],
                    part.slots[start : start + _BATCH],
                )
                for start in range(0, len(chosen), _BATCH)
            ]
        )
        floor = float(scores.min())
        peaks, counts = state_peaks(scores - floor, part, len(everything.slots))
        limit = regime_limits(peaks, counts, float(figures["margin"]), int(figures["smallest_regime"]))
        return {
            "rows": sample.vectors[rows].tolist(), "slots": sample.slots[rows].tolist(), "scale": scale.tolist(),
            "floor": floor, "limit": limit,
        }  # fmt: skip


@functools.lru_cache(_FITTED)
def _refitted(learned: Callable[..., Judge], autopilot: str, rows: bytes, slots: bytes, scale: bytes) -> Judge:
    """The judge of a model, fitted once per process to what the model stores: a campaign has a detector per mission."""
    everything, states = Everything(autopilot), np.frombuffer(slots, np.int64)
    return learned(np.frombuffer(rows).reshape(len(states), -1), states, np.frombuffer(scale), everything)
