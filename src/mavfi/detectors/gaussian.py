"""GAD: one Gaussian detector per watched field, an alarm for the field's stage (MAVFI section IV-C)."""

from typing import NamedTuple

import numpy as np

from mavfi.detectors import features
from mavfi.detectors.detector import Alarm
from mavfi.detectors.features import Watch
from mavfi.detectors.model import Model
from mavfi.detectors.preprocess import Preprocessor
from mavfi.numerics import welford
from mavfi.numerics.jit import kernel_jit
from mavfi.states import State

SOURCE = "gaussian"
SIGMA_FLOOR = 0.5
"""Smallest standard deviation, in codes: deltas are integers, and some never change in training."""
NOT_FINITE = 1e9
"""Score of a value that is not finite: an alarm whatever was learned."""


class Online(NamedTuple):
    """What the `paper` profile judges by.

    Attributes:
        statistics: k, M, S of each field. Shape (n, 3).
        sigmas: The paper's n.
        min_count: Samples before a field is judged.
    """

    statistics: np.ndarray
    sigmas: float
    min_count: float


class Frozen(NamedTuple):
    """What the `tuned` profile judges by.

    Attributes:
        centre: Mean of each field and regime. Shape (n, 3).
        limit: Largest distance from it that is no alarm, > 0. Shape (n, 3).
    """

    centre: np.ndarray
    limit: np.ndarray


@kernel_jit
def judge_online(
    content: np.ndarray, slot: int, watch: Watch, rule: Online, deltas: np.ndarray, scores: np.ndarray
) -> float:
    """Distance from the running mean in units of n standard deviations.

    Args:
        content: As of `features.measure`.
        slot: As of `features.measure`.
        watch: As of `features.measure`.
        rule: What to judge by.
        deltas: Filled in for the fields of this state. Shape (n,), int16.
        scores: Filled in likewise; > 1 is an alarm. Shape (n,).

    Returns:
        The largest score.
    """
    regime = features.measure(content, slot, watch, deltas)
    worst = 0.0
    for index in range(watch.places[slot, features.FIRST], watch.places[slot, features.LAST]):
        count, mean, squares = rule.statistics[index]
        scores[index] = 0.0
        if count >= rule.min_count:
            sigma = max(welford.deviation(count, squares), SIGMA_FLOOR)
            scores[index] = abs(deltas[index] - mean) / (rule.sigmas * sigma)
        worst = max(worst, scores[index])
    return worst if regime >= 0 else NOT_FINITE


@kernel_jit
def learn_online(
    content: np.ndarray, slot: int, watch: Watch, rule: Online, deltas: np.ndarray, scores: np.ndarray
) -> None:
    """Update the statistics with a published value, except where it would have raised an alarm, and remember it.

    Arguments as of `judge_online`; `rule.statistics` and `watch` change.
    """
    worst = judge_online(content, slot, watch, rule, deltas, scores)
    if worst < NOT_FINITE and watch.memory[slot, features.SEEN] != 0.0:
        for index in range(watch.places[slot, features.FIRST], watch.places[slot, features.LAST]):
            if scores[index] <= 1.0:
                count, mean, squares = rule.statistics[index]
                rule.statistics[index] = welford.update(count, mean, squares, float(deltas[index]))
    features.commit(content, slot, watch)


@kernel_jit
def judge_frozen(
    content: np.ndarray, slot: int, watch: Watch, rule: Frozen, deltas: np.ndarray, scores: np.ndarray
) -> float:
    """Distance from the trained mean of the regime in units of its trained limit; arguments as of `judge_online`."""
    regime = features.measure(content, slot, watch, deltas)
    if regime < 0:
        return NOT_FINITE
    worst = 0.0
    for index in range(watch.places[slot, features.FIRST], watch.places[slot, features.LAST]):
        scores[index] = abs(deltas[index] - rule.centre[index, regime]) / rule.limit[index, regime]
        worst = max(worst, scores[index])
    return worst


class GaussianDetector:
    """GAD in either profile.

    `paper`: one n for all fields; mean and deviation go on online from the trained ones, a value is tested before
    they are updated, and they are never updated with one that raised an alarm.  `tuned`:
    limits per field and regime, frozen.
    """

    model_kind = SOURCE

    def __init__(self, model: Model, sigmas: float | None = None, preprocessor: Preprocessor | None = None) -> None:
        """Take over what was trained.

        Args:
            model: A model of kind "gaussian".
            sigmas: The paper's n instead of the model's; `paper` only.
            preprocessor: Of the fields that the model was trained on, if they are no monitored set.
        """
        self._features = preprocessor or Preprocessor(model.monitored, model.profile, model.prediction)
        size = len(self._features.fields)
        self._deltas = np.zeros(size, np.int16)
        self._scores = np.zeros(size)
        self._trained = np.zeros((0, 3))
        self._rule = self._online(model, sigmas) if model.profile == "paper" else _frozen(model)

    def _online(self, model: Model, sigmas: float | None) -> Online:
        parameters = model.parameters
        self._trained = np.array(parameters["statistics"], np.float64)
        chosen = parameters["sigmas"] if sigmas is None else sigmas
        return Online(self._trained.copy(), float(chosen), float(parameters["min_count"]))

    def start(self) -> None:
        """Forget the last flight."""
        self._features.start()
        if isinstance(self._rule, Online):
            self._rule.statistics[:] = self._trained

    def check(self, state: State, time_us: int) -> Alarm | None:
        """Judge a publication."""
        slot = self._features.slots.get(state.spec.name)
        if slot is None:
            return None
        content, watch = state.header.view(np.uint8), self._features.watch
        if isinstance(self._rule, Online):
            score = judge_online(content, slot, watch, self._rule, self._deltas, self._scores)
        else:
            score = judge_frozen(content, slot, watch, self._rule, self._deltas, self._scores)
        return None if score <= 1.0 else self._alarm(slot, score, content)

    def accept(self, state: State, time_us: int) -> None:
        """Take note of a value that was published."""
        slot = self._features.slots.get(state.spec.name)
        if slot is None:
            self._features.note(state)
            return
        content, watch = state.header.view(np.uint8), self._features.watch
        if isinstance(self._rule, Online):
            learn_online(content, slot, watch, self._rule, self._deltas, self._scores)
        else:
            features.commit(content, slot, watch)

    def _alarm(self, slot: int, score: float, content: np.ndarray) -> Alarm:
        first, last = self._features.range_of(slot)
        if score == NOT_FINITE:
            found = features.not_finite(content, self._features.watch.table[first:last])
        else:
            found = self._scores[first:last] > 1.0
        names = tuple(self._features.fields[first + index] for index in np.flatnonzero(found))
        return Alarm(SOURCE, self._features.stage(first), score=float(score), fields=names)


def _frozen(model: Model) -> Frozen:
    parameters = model.parameters
    return Frozen(np.array(parameters["centre"], np.float64), np.array(parameters["limit"], np.float64))
