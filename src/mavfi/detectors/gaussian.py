"""GAD: one Gaussian detector per watched field, with alarms for the field's stage (MAVFI section IV-C)."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from mavfi.detectors import features
from mavfi.detectors.features import LastJudgement, WatchedFields
from mavfi.detectors.model import SMALLEST_LIMIT, Model
from mavfi.detectors.preprocess import DeltaScorer, Preprocessor, conclude
from mavfi.detectors.scoring import NOT_FINITE, ScoringDetector, Threshold, find_policy
from mavfi.detectors.training import Sample, TrainedDetector, regime_limits
from mavfi.numerics import welford
from mavfi.numerics.jit import kernel_jit
from mavfi.numerics.stored import load

SOURCE = "gaussian"
"""Name in its alarms, and kind of its models."""
SIGMA_FLOOR = 0.5
"""Smallest standard deviation, in codes: deltas are integers, and some are constant in training."""


@kernel_jit
def deviations(
    content: np.ndarray,
    slot: int,
    watch: WatchedFields,
    statistics: np.ndarray,
    min_count: float,
    deltas: np.ndarray,
    distance: np.ndarray,
    unit: np.ndarray,
) -> int:
    """`features.measure`, then the distance of each delta from its running mean, and its standard deviation.

    `statistics`: k, M, S of each field, shape (n, 3); `unit` is 0 for fields with fewer than `min_count` samples.
    """
    regime = features.measure(content, slot, watch, deltas)
    for index in range(watch.places[slot, features.FIRST], watch.places[slot, features.LAST]):
        count, mean, squares = statistics[index]
        distance[index] = abs(deltas[index] - mean)
        unit[index] = max(welford.deviation(count, squares), SIGMA_FLOOR) if count >= min_count else 0.0
    return regime


@kernel_jit
def update(statistics: np.ndarray, deltas: np.ndarray, ratios: np.ndarray, first: int, last: int) -> None:
    """Update the statistics of the fields [first, last) with their deltas, skipping deltas beyond their limits."""
    for index in range(first, last):
        if ratios[index] <= 1.0:
            count, mean, squares = statistics[index]
            statistics[index] = welford.update(count, mean, squares, float(deltas[index]))


@kernel_jit
def distances(
    content: np.ndarray, slot: int, watch: WatchedFields, centre: np.ndarray, deltas: np.ndarray, distance: np.ndarray
) -> int:
    """Distance of each delta from the centre of its regime, shape (n, regimes); otherwise as `deviations`."""
    regime = features.measure(content, slot, watch, deltas)
    if regime >= 0:
        for index in range(watch.places[slot, features.FIRST], watch.places[slot, features.LAST]):
            distance[index] = abs(deltas[index] - centre[index, regime])
    return regime


@kernel_jit
def settle_online(
    watch: WatchedFields, scratch: LastJudgement, limit: np.ndarray, statistics: np.ndarray, min_count: float
) -> None:
    """Commit the publication judged last; learn its deltas if normal and not those of a first publication."""
    slot = scratch.status[features.SLOT]
    if scratch.score[0] < NOT_FINITE and watch.memory[slot, features.SEEN] != 0.0:
        first, last = watch.places[slot, features.FIRST], watch.places[slot, features.LAST]
        update(statistics, scratch.deltas, scratch.ratios, first, last)
    features.settle(scratch, watch)


@kernel_jit
def judge_online(
    content: np.ndarray,
    slot: int,
    watch: WatchedFields,
    scratch: LastJudgement,
    limit: np.ndarray,
    statistics: np.ndarray,
    min_count: float,
) -> float:
    """Score of a publication, see `preprocess.DeltaScorer`; statistics and count as for `deviations`."""
    if scratch.status[features.ACCEPTED] != 0:
        settle_online(watch, scratch, limit, statistics, min_count)
    features.propose(content, slot, scratch)
    regime = deviations(content, slot, watch, statistics, min_count, scratch.deltas, scratch.distance, scratch.unit)
    return conclude(regime, watch.places[slot], scratch, limit)


_ONLINE = features.kind_with(np.zeros((1, 3)), 0.0)
"""Types of the compiled functions' arguments with statistics that learn in flight."""


@kernel_jit
def _online_at(content: np.ndarray, slot: int, address: int) -> float:
    watch, scratch, limit, statistics, min_count = load(address, _ONLINE)
    return judge_online(content, slot, watch, scratch, limit, statistics, min_count)


@kernel_jit
def settle_frozen(watch: WatchedFields, scratch: LastJudgement, limit: np.ndarray, centre: np.ndarray) -> None:
    """Commit the publication judged last."""
    features.settle(scratch, watch)


@kernel_jit
def judge_frozen(
    content: np.ndarray, slot: int, watch: WatchedFields, scratch: LastJudgement, limit: np.ndarray, centre: np.ndarray
) -> float:
    """Score of a publication, see `preprocess.DeltaScorer`; centre as for `distances`."""
    if scratch.status[features.ACCEPTED] != 0:
        features.settle(scratch, watch)
    features.propose(content, slot, scratch)
    regime = distances(content, slot, watch, centre, scratch.deltas, scratch.distance)
    return conclude(regime, watch.places[slot], scratch, limit)


_FROZEN = features.kind_with(np.zeros((1, 1)))
"""The same with statistics of training."""


@kernel_jit
def _frozen_at(content: np.ndarray, slot: int, address: int) -> float:
    watch, scratch, limit, centre = load(address, _FROZEN)
    return judge_frozen(content, slot, watch, scratch, limit, centre)


class OnlineScorer(DeltaScorer):
    """Distances from running means that start from the trained ones; a value is judged before it is learned.

    Args:
        preprocessor: Deltas of the watched fields.
        statistics: Trained statistics, see `deviations`.
        min_count: Samples required before a field is judged.
    """

    judge = staticmethod(judge_online)
    settle = staticmethod(settle_online)
    judge_at = staticmethod(_online_at)
    kind = _ONLINE

    def __init__(self, preprocessor: Preprocessor, statistics: np.ndarray, min_count: float) -> None:
        self._initial_statistics = statistics
        self._statistics = statistics.copy()
        super().__init__(preprocessor, self._statistics, min_count)
        self.memory_arrays = {**self.memory_arrays, "statistics": self._statistics}

    def start(self) -> None:
        """Reset the memory at the start of a flight."""
        super().start()
        self._statistics[:] = self._initial_statistics


class FrozenScorer(DeltaScorer):
    """Distances from a trained centre of each field and regime, shape (n, regimes), passed as its table."""

    judge = staticmethod(judge_frozen)
    settle = staticmethod(settle_frozen)
    judge_at = staticmethod(_frozen_at)
    kind = _FROZEN


class GaussianDetector(ScoringDetector, TrainedDetector):
    """GAD: a model of the paper's codes learns online with one n for all fields; one of predictions has fixed limits.

    Args:
        model: A model of kind "gaussian".
        policy: Name of a recovery policy, see `scoring.POLICIES`.
        preprocessor: For the fields that the model was trained on, unless these are a monitored set.
    """

    model_kind = SOURCE

    def __init__(self, model: Model, policy: str = "keyed", preprocessor: Preprocessor | None = None) -> None:
        deltas = preprocessor or Preprocessor(model.monitored, model.profile, model.prediction)
        size = len(deltas.fields)
        if "statistics" in model.parameters:
            statistics = model.numbers("statistics", size, 3)
            scorer: DeltaScorer = OnlineScorer(deltas, statistics, float(model.numbers("min_count", least=0.0)))
            limit = np.full((size, features.REGIMES), float(model.numbers("sigmas", least=SMALLEST_LIMIT)))
        else:
            scorer = FrozenScorer(deltas, model.numbers("centre", size, features.REGIMES))
            limit = model.numbers("limit", size, features.REGIMES, least=SMALLEST_LIMIT)
        super().__init__(SOURCE, scorer, Threshold(limit, size), find_policy(policy))

    @classmethod
    def fit(cls, sample: Sample, features: Preprocessor, figures: Mapping[str, Any]) -> dict[str, Any]:
        """Parameters of a model, online if the figures contain `sigmas`; see `fit_online` and `fit_frozen`."""
        if "sigmas" in figures:
            return fit_online(sample, features, **figures)
        return fit_frozen(sample, features, **figures)


def fit_online(sample: Sample, preprocessor: Preprocessor, sigmas: float, min_count: float) -> dict[str, Any]:
    """Initial statistics of the `paper` GAD: k, M, S of each field in error-free flights.

    `sigmas` is the paper's n, `min_count` the number of samples required before a field is judged.
    """
    statistics = []
    for index in range(len(preprocessor.fields)):
        values = sample.vectors[(sample.slots == preprocessor.slot_of(index)) & ~sample.first, index]
        statistics.append([float(number) for number in welford.accumulate(values.astype(np.float64))])
    return {"statistics": statistics, "sigmas": float(sigmas), "min_count": float(min_count)}


def fit_frozen(sample: Sample, preprocessor: Preprocessor, margin: float, smallest_regime: int) -> dict[str, Any]:
    """Centre and limit of the `tuned` GAD by field and regime; a distance of one code never raises an alarm.

    `margin` and `smallest_regime` as for `regime_limits`.
    """
    shape = len(preprocessor.fields), features.REGIMES
    centre = np.zeros(shape)
    limit = np.ones(shape)
    counts = np.zeros(shape, np.int64)
    for index in range(shape[0]):
        has_delta = (sample.slots == preprocessor.slot_of(index)) & ~sample.first
        for regime in range(features.REGIMES):
            values = sample.vectors[has_delta & (sample.regimes == regime), index].astype(np.float64)
            counts[index, regime] = len(values)
            if len(values):
                centre[index, regime] = values.mean()
                limit[index, regime] = max(1.0, float(np.abs(values - values.mean()).max()))
    return {"centre": centre.tolist(), "limit": regime_limits(limit, counts, margin, smallest_regime)}
