"""CUSUM (Page, Biometrika 41, 1954): accumulates small persistent deviations, two-sided, for each field."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from mavfi.detectors.all_fields import AllFieldsDetector, centre_and_peaks
from mavfi.detectors.code_scorer import CodeScorer, Judged, conclude
from mavfi.detectors.features import REGIMES
from mavfi.detectors.field_codes import FieldCodes
from mavfi.detectors.model import Model
from mavfi.detectors.residual_state import LEARNED, NEVER, REGIME, SLOT, ResidualState
from mavfi.detectors.samples import Sample, regime_limits
from mavfi.numerics.jit import kernel_jit

_FLOOR = 0.5
"""Smallest standard deviation, in codes: codes are integers, and some are constant in training."""


@kernel_jit
def add(
    codes: np.ndarray, centre: np.ndarray, deviation: np.ndarray, regime: int, slack: float, sums: np.ndarray,
    after: np.ndarray,
) -> None:  # fmt: skip
    """Cumulative sums after a publication.

    Args:
        codes: Codes of the published fields. Shape (n,), int16.
        centre: Mean of each code and regime. Shape (n, regimes).
        deviation: Standard deviation. Shape (n, regimes).
        regime: Column of `centre` and `deviation`.
        slack: Deviation that adds nothing, in standard deviations (Page's k).
        sums: Upper and lower sums before the publication. Shape (n, 2).
        after: Output: upper and lower sums after it. Shape (n, 2).
    """
    for index in range(len(codes)):
        scaled = (codes[index] - centre[index, regime]) / deviation[index, regime]
        after[index, 0] = max(0.0, sums[index, 0] + scaled - slack)
        after[index, 1] = max(0.0, sums[index, 1] - scaled - slack)


@kernel_jit
def largest_sums(
    vectors: np.ndarray, slots: np.ndarray, regimes: np.ndarray, first: np.ndarray, spans: np.ndarray,
    centre: np.ndarray, deviation: np.ndarray, slack: float,
) -> np.ndarray:  # fmt: skip
    """Largest sum of each field and regime in recorded flights.

    Args:
        vectors: See `Sample`, also for slots, regimes and first.
        slots: State of each publication. Shape (m,).
        regimes: Shape (m,).
        first: Whether it is the first of its state in a flight. Shape (m,).
        spans: First and one past the last field of each state. Shape (slots, 2), int64.
        centre: See `add`.
        deviation: See `add`.
        slack: See `add`.

    Returns:
        Shape (n, regimes).
    """
    sums, peaks = np.zeros((len(centre), 2)), np.zeros(centre.shape)
    for row in range(len(slots)):
        start, end = spans[slots[row]]
        if first[row]:
            sums[start:end] = 0.0
        own, regime = sums[start:end], regimes[row]
        add(vectors[row, start:end], centre[start:end], deviation[start:end], regime, slack, own, own)
        for index in range(start, end):
            peaks[index, regime] = max(peaks[index, regime], max(sums[index, 0], sums[index, 1]))
    return peaks


class Sums(NamedTuple):
    """Upper and lower cumulative sums of each field.

    Attributes:
        before: Of the publications so far. Shape (n, 2).
        after: With the publication judged last, in its fields. Shape (n, 2).
    """

    before: np.ndarray
    after: np.ndarray


@kernel_jit
def learn(
    measured: ResidualState, judged: Judged, limit: np.ndarray, centre: np.ndarray, deviation: np.ndarray,
    slack: float, sums: Sums,
) -> None:  # fmt: skip
    """Store the sums of an accepted publication; an alarm resets them."""
    if measured.place[LEARNED] == NEVER:
        return
    first, last = measured.spans[measured.place[LEARNED]]
    for index in range(first, last):
        for side in range(2):
            sums.before[index, side] = sums.after[index, side] if judged.score[0] <= 1.0 else 0.0
    measured.place[LEARNED] = NEVER


@kernel_jit
def judge_sums(
    measured: ResidualState, judged: Judged, limit: np.ndarray, centre: np.ndarray, deviation: np.ndarray,
    slack: float, sums: Sums,
) -> float:  # fmt: skip
    """Score of the sums after a publication; arguments as for `add`."""
    learn(measured, judged, limit, centre, deviation, slack, sums)
    first, last = measured.spans[measured.place[SLOT]]
    regime = measured.place[REGIME]
    if regime >= 0:
        after = sums.after[first:last]
        add(
            measured.codes[first:last], centre[first:last], deviation[first:last], regime, slack,
            sums.before[first:last], after,
        )  # fmt: skip
        for index in range(len(after)):
            judged.distance[first + index] = max(after[index, 0], after[index, 1])
    return conclude(first, last, measured, judged, limit)


class SumScorer(CodeScorer):
    """Cumulative sums; an alarm resets those of its state."""

    judge, learns = staticmethod(judge_sums), staticmethod(learn)

    def __init__(self, field_codes: FieldCodes, centre: np.ndarray, deviation: np.ndarray, slack: float) -> None:
        sums = Sums(*np.zeros((2, len(field_codes.fields), 2)))
        super().__init__(field_codes, centre, deviation, slack, sums)
        self.kept = {**self.kept, "sums": sums.before}


class CusumDetector(AllFieldsDetector):
    """CUSUM of all fields."""

    model_kind = "cusum"

    @classmethod
    def scorer_of(cls, model: Model, field_codes: FieldCodes) -> CodeScorer:
        """Scorer of cumulative sums."""
        shape = len(field_codes.fields), REGIMES
        deviation = model.numbers("deviation", *shape, least=_FLOOR)
        slack = float(model.numbers("slack", least=0.0))
        return SumScorer(field_codes, model.numbers("centre", *shape), deviation, slack)

    @classmethod
    def fit(cls, sample: Sample, features: FieldCodes, figures: Mapping[str, Any]) -> dict[str, Any]:
        """See `fit_cusum`."""
        return fit_cusum(sample, features, **figures)


def fit_cusum(
    sample: Sample, field_codes: FieldCodes, slack: float, margin: float, smallest_regime: int
) -> dict[str, Any]:  # fmt: skip
    """Centre, deviation and limit of each field and regime.

    Args:
        sample: Error-free flights.
        field_codes: Codes from which the sample was made.
        slack: See `add`.
        margin: Limit / largest sum in training.
        smallest_regime: A regime with fewer samples takes the largest limit among the regimes of its field.
    """
    centre, _, counts = centre_and_peaks(sample, field_codes)
    deviation = np.full(centre.shape, _FLOOR)
    for slot in range(len(field_codes.slots)):
        own = slice(*field_codes.range_of(slot))
        for regime in range(REGIMES):
            values = sample.vectors[(sample.slots == slot) & (sample.regimes == regime), own]
            if len(values):
                deviation[own, regime] = np.maximum(_FLOOR, values.std(axis=0, dtype=np.float64))
    spans = np.array([field_codes.range_of(slot) for slot in range(len(field_codes.slots))])
    peaks = largest_sums(
        sample.vectors, sample.slots, sample.regimes, sample.first, spans, centre, deviation, slack
    )  # fmt: skip
    limit = regime_limits(np.maximum(1.0, peaks), counts, margin, smallest_regime)
    return {"centre": centre.tolist(), "deviation": deviation.tolist(), "slack": slack, "limit": limit}
