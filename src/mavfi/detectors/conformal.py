"""Split-conformal limits (Vovk, Gammerman and Shafer 2005; Lei et al., JASA 113, 2018) for each state and regime.

For error-free flights drawn like those of training, at most a share `alpha` of a state's publications in a regime
exceeds its limit, whatever the distribution of the scores.  One half of the flights fits the scores, the other the
limits.
"""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from mavfi.detectors.all_fields import AllFieldsDetector, centre_and_peaks
from mavfi.detectors.code_scorer import CodeScorer, Judged, StateScorer, conclude
from mavfi.detectors.features import REGIMES
from mavfi.detectors.field_codes import FieldCodes
from mavfi.detectors.model import Model
from mavfi.detectors.residual_state import REGIME, SLOT, ResidualState
from mavfi.detectors.samples import Sample
from mavfi.numerics.jit import kernel_jit


def conformal_limit(scores: np.ndarray, alpha: float) -> float:
    """Limit that a further exchangeable score exceeds with a probability of at most `alpha`.

    Args:
        scores: Calibration scores. Shape (n,).
        alpha: In (0, 1).

    Returns:
        The ceil((1 - alpha) (n + 1))-th smallest score; infinity if n is too small for `alpha`.
    """
    rank = math.ceil((1.0 - alpha) * (len(scores) + 1))
    return float(np.partition(scores, rank - 1)[rank - 1]) if rank <= len(scores) else math.inf


@kernel_jit
def largest_of(codes: np.ndarray, centre: np.ndarray, scale: np.ndarray, regime: int) -> float:
    """Largest distance of codes, shape (n,), from their centres in units of their scales, shape (n, regimes)."""
    worst = 0.0
    for index in range(len(codes)):
        worst = max(worst, abs(codes[index] - centre[index, regime]) / scale[index, regime])
    return worst


@kernel_jit
def judge_largest(
    measured: ResidualState, judged: Judged, limit: np.ndarray, centre: np.ndarray, scale: np.ndarray
) -> float:
    """Score of the largest scaled distance among a publication's fields; tables as for `largest_of`."""
    slot, regime = measured.place[SLOT], measured.place[REGIME]
    first, last = measured.spans[slot]
    if regime >= 0:
        judged.distance[slot] = largest_of(measured.codes[first:last], centre[first:last], scale[first:last], regime)
    return conclude(slot, slot + 1, measured, judged, limit)


class LargestScorer(StateScorer):
    """The largest scaled distance among a publication's fields; its tables are centre and scale, (n, regimes)."""

    judge = staticmethod(judge_largest)


class ConformalDetector(AllFieldsDetector):
    """Split-conformal limits of all states."""

    model_kind = "conformal"

    @classmethod
    def scorer_of(cls, model: Model, field_codes: FieldCodes) -> CodeScorer:
        """Scorer of the largest scaled distances."""
        shape = len(field_codes.fields), REGIMES
        return LargestScorer(field_codes, model.numbers("centre", *shape), model.numbers("scale", *shape, least=1.0))

    @classmethod
    def fit(cls, sample: Sample, features: FieldCodes, figures: Mapping[str, Any]) -> dict[str, Any]:
        """See `fit_conformal`."""
        return fit_conformal(sample, features, **figures)


def fit_conformal(sample: Sample, field_codes: FieldCodes, alpha: float) -> dict[str, Any]:
    """Centre and scale of each field, and limit of each state, by regime.

    Args:
        sample: Error-free flights.
        field_codes: Codes from which the sample was made.
        alpha: Share of false alarms among publications; a state and regime with too few publications for it takes the
            largest score as its limit, and the share 1 / (number + 1).
    """
    flights = np.cumsum(_begins(sample))
    even = flights % 2 == 0
    centre, scale, _ = centre_and_peaks(_part(sample, even), field_codes)
    rest = _part(sample, ~even)
    limit = np.ones((len(field_codes.slots), REGIMES))
    for slot in range(len(limit)):
        own = slice(*field_codes.range_of(slot))
        for regime in range(REGIMES):
            vectors = rest.vectors[(rest.slots == slot) & (rest.regimes == regime), own].astype(np.float64)
            if len(vectors):
                scores = (np.abs(vectors - centre[own, regime]) / scale[own, regime]).max(axis=1)
                least = 1.0 / (len(scores) + 1)
                # a distance of one code never raises an alarm: codes are rounded
                limit[slot, regime] = max(conformal_limit(scores, max(alpha, least)), float((1.0 / scale[own]).max()))
    return {"centre": centre.tolist(), "scale": scale.tolist(), "limit": limit.tolist()}


def _begins(sample: Sample) -> np.ndarray:
    """Whether each publication is the first of a flight. Shape (m,), bool."""
    lead = sample.slots[0]
    found: np.ndarray = sample.first & (sample.slots == lead)
    return found


def _part(sample: Sample, rows: np.ndarray) -> Sample:
    return Sample(*(getattr(sample, name)[rows] for name in Sample.__annotations__))
