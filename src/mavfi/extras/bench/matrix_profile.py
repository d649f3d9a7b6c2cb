"""Matrix profile (Yeh et al., ICDM 2016) by stumpy: distance of a state's recent values from all training values.

The series of a state is the largest scaled code of each publication.  A new publication scores the smallest distance,
not normalized, between the subsequence that it completes and all training subsequences (an AB-join, identical to
`stumpi` fed value by value); the only memory is the subsequence itself.  stumpy computes the limits; in flight compiled
code computes the same distance.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from mavfi.detectors.autoencoder import INPUT_LIMIT
from mavfi.detectors.features import REGIMES
from mavfi.detectors.model import Model
from mavfi.detectors.training import Sample
from mavfi.extras.bench.all_fields import AllFieldsDetector, CodeScorer, JudgedPublication, StateScorer, conclude
from mavfi.extras.bench.field_codes import FieldCodes
from mavfi.extras.bench.library import LibraryDetector, require, scaled
from mavfi.extras.bench.residual_state import LEARNED, NEVER, REGIME, SLOT, ResidualState
from mavfi.numerics.jit import kernel_jit

LENGTH = 8
"""Publications per subsequence."""
BLOCK = 64
"""Subsequences compared at a time."""
_ROUNDING = 1e-9
"""More than sums of LENGTH inputs can be wrong by."""
_NO_LIMIT = 1e17
"""Limit for states without a training subsequence: no distance exceeds it."""
_SMALLEST_LIMIT = 1e-3


class Series(NamedTuple):
    """Values in training and in flight.

    Attributes:
        history: Different subsequences of the training series of each state, see `nearest`. Shape (slots, LENGTH, k).
        sums: Their sums. Shape (slots, k).
        counts: Number of each. Shape (slots,), int64.
        scale: Largest code of each field in training. Shape (n,).
        recent: The latest values of each state. Shape (slots, LENGTH - 1).
        published: Number of values of each state. Shape (slots,).
        stretch: Subsequence of the publication judged last. Shape (LENGTH,).
        squares: Work. Shape (BLOCK,).
    """

    history: np.ndarray
    sums: np.ndarray
    counts: np.ndarray
    scale: np.ndarray
    recent: np.ndarray
    published: np.ndarray
    stretch: np.ndarray
    squares: np.ndarray


@kernel_jit
def largest_code(codes: np.ndarray, scale: np.ndarray) -> float:
    """The value of a publication: its largest scaled code. Shapes (n,)."""
    worst = 0.0
    for index in range(len(codes)):
        worst = max(worst, min(abs(codes[index]) / scale[index], INPUT_LIMIT))
    return worst


@kernel_jit
def least_square(stretch: np.ndarray, history: np.ndarray, first: int, last: int, squares: np.ndarray) -> float:
    """Smallest squared distance of a subsequence from the columns [first, last), at most BLOCK."""
    count = last - first
    squares[:count] = 0.0
    for position in range(LENGTH):  # all columns side by side: several per machine instruction
        value, row = stretch[position], history[position, first:last]
        for index in range(count):
            away = value - row[index]
            squares[index] += away * away
    best = np.inf
    for index in range(count):
        best = min(best, squares[index])
    return best


@kernel_jit
def nearest(stretch: np.ndarray, history: np.ndarray, sums: np.ndarray, squares: np.ndarray) -> float:
    """Smallest Euclidean distance of a subsequence from those in the columns of a history.

    It is at least the difference of their sums / sqrt(LENGTH) (Cauchy and Schwarz): columns are compared from the
    nearest sum on, until no other can be nearer.

    Args:
        stretch: The subsequence. Shape (LENGTH,).
        history: Columns, by their sums. Shape (LENGTH, k).
        sums: Their sums. Shape (k,).
        squares: Work. Shape (BLOCK,).

    Returns:
        The distance; 0 if k is 0.
    """
    count = len(sums)
    if count == 0:
        return 0.0
    total = stretch.sum()
    low = high = np.searchsorted(sums, total)
    best = np.inf
    while low > 0 or high < count:
        below = total - sums[low - 1] if low > 0 else np.inf
        above = sums[high] - total if high < count else np.inf
        apart = max(min(below, above) - _ROUNDING, 0.0)
        if apart * apart > LENGTH * best:
            break
        if high == count or (low > 0 and below <= above):
            start = max(low - BLOCK, 0)
            best = min(best, least_square(stretch, history, start, low, squares))
            low = start
        else:
            end = min(high + BLOCK, count)
            best = min(best, least_square(stretch, history, high, end, squares))
            high = end
    return float(np.sqrt(best))


@kernel_jit
def learn(measured: ResidualState, judged: JudgedPublication, limit: np.ndarray, series: Series) -> None:
    """Store a value that consumers received, normal or not, as in training.

    After an anomaly that was left out, the subsequence ended before it, and any next value was an anomaly as well.
    """
    if measured.status[LEARNED] == NEVER:
        return
    recent = series.recent[measured.status[LEARNED]]
    for position in range(LENGTH - 1):
        recent[position] = series.stretch[position + 1]
    series.published[measured.status[LEARNED]] += 1.0
    measured.status[LEARNED] = NEVER


@kernel_jit
def extend(measured: ResidualState, series: Series) -> bool:
    """Subsequence that ends with the publication measured last; whether it is complete."""
    slot = measured.status[SLOT]
    first, last = measured.spans[slot]
    for position in range(LENGTH - 1):
        series.stretch[position] = series.recent[slot, position]
    series.stretch[LENGTH - 1] = largest_code(measured.codes[first:last], series.scale[first:last])
    return bool(series.published[slot] >= LENGTH - 1)


@kernel_jit
def distance_of(slot: int, series: Series) -> float:
    """Distance of the subsequence judged last from the training series of its state."""
    count = series.counts[slot]
    return nearest(series.stretch, series.history[slot], series.sums[slot, :count], series.squares)


@kernel_jit
def judge_stretch(measured: ResidualState, judged: JudgedPublication, limit: np.ndarray, series: Series) -> float:
    """Score of the subsequence that a publication completes; 0 until the first is complete."""
    learn(measured, judged, limit, series)
    slot, complete = measured.status[SLOT], extend(measured, series)
    if measured.status[REGIME] >= 0:
        judged.distance[slot] = distance_of(slot, series) if complete else 0.0
    return conclude(slot, slot + 1, measured, judged, limit)


def subsequences(series: np.ndarray) -> np.ndarray:
    """The different subsequences of a series, shape (k,), in columns, by their sums; often half of them are equal."""
    if len(series) < LENGTH:
        return np.zeros((LENGTH, 0))
    columns = np.unique(np.lib.stride_tricks.sliding_window_view(series, LENGTH), axis=0).T
    return columns[:, np.argsort(columns.sum(axis=0), kind="stable")]


class StretchScorer(StateScorer):
    """Distances of the latest subsequences.

    Args:
        field_codes: Computes the codes.
        histories: Training series, by state.
        scale: Largest code of each field in training. Shape (n,).
    """

    judge = staticmethod(judge_stretch)
    learns = staticmethod(learn)

    def __init__(self, field_codes: FieldCodes, histories: list[np.ndarray], scale: np.ndarray) -> None:
        slots = len(field_codes.slots)
        columns_of_slot = [subsequences(history) for history in histories]
        counts = np.array([columns.shape[1] for columns in columns_of_slot], np.int64)
        series = Series(
            history=np.zeros((slots, LENGTH, max(counts))),
            sums=np.zeros((slots, max(counts))),
            counts=counts,
            scale=scale,
            recent=np.zeros((slots, LENGTH - 1)),
            published=np.zeros(slots),
            stretch=np.zeros(LENGTH),
            squares=np.zeros(BLOCK),
        )
        for slot, columns in enumerate(columns_of_slot):
            series.history[slot, :, : counts[slot]] = columns
            series.sums[slot, : counts[slot]] = columns.sum(axis=0)
        super().__init__(field_codes, series)
        self.memory_arrays = {**self.memory_arrays, "recent": series.recent, "published": series.published}


class MatrixProfileDetector(AllFieldsDetector):
    """Matrix profile of every state."""

    model_kind = "matrix_profile"
    extra = LibraryDetector.extra

    @classmethod
    def scorer_of(cls, model: Model, field_codes: FieldCodes) -> CodeScorer:
        """Scorer of the distance between the newest subsequence of each state and those of training."""
        cls.check_installed()
        states = len(field_codes.slots)
        stored = model.parameters.get("history")
        rows: list[list[float]] = [[]] * states
        if isinstance(stored, list) and len(stored) == states:
            rows = stored
        histories = [_with_row(model, row).numbers("row", len(row)) for row in rows]
        return StretchScorer(field_codes, histories, model.numbers("scale", len(field_codes.fields), least=1.0))

    @classmethod
    def check_installed(cls) -> None:
        """See `LibraryDetector`."""
        require(cls.model_kind, "stumpy")

    @classmethod
    def fit(cls, sample: Sample, features: FieldCodes, figures: Mapping[str, Any]) -> dict[str, Any]:
        """Parameters of a model.

        Args:
            sample: Error-free flights.
            features: Codes from which the sample was made.
            figures: `history`, stored values per state, from the first half of its series; `calibrated`, subsequences
                of the second half from which limits are derived; `margin`, limit / largest distance.
        """
        cls.check_installed()
        from stumpy.core import mass_absolute

        scale = np.maximum(1.0, np.abs(sample.vectors.astype(np.float64)).max(axis=0))
        histories = []
        limit = np.full((len(features.slots), REGIMES), _NO_LIMIT)
        for slot in range(len(limit)):
            # 1. The series of a state: its first half is stored.
            fields = slice(*features.range_of(slot))
            series = np.abs(scaled(sample.vectors[sample.slots == slot, fields], scale[fields])).max(axis=1)
            half = len(series) // 2
            history = series[: min(half, int(figures["history"]))]
            rest = series[half:]
            histories.append(history.tolist())

            # 2. Its limit: the largest distance of the second half from it, times the margin.
            if len(history) >= LENGTH:
                ends = range(LENGTH, min(len(rest), LENGTH + int(figures["calibrated"])))
                distances = [float(mass_absolute(rest[end - LENGTH : end], history).min()) for end in ends]
                if distances:
                    limit[slot] = max(float(figures["margin"]) * max(distances), _SMALLEST_LIMIT)
        return {"history": histories, "scale": scale.tolist(), "limit": limit.tolist()}


def _with_row(model: Model, row: list[float]) -> Model:
    """A model with a row of another one as its only parameter, so that it is checked in the same way."""
    return Model(model.kind, model.profile, model.monitored, model.prediction, {"row": row}, model.provenance)
