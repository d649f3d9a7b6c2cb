"""Components of a detector: scorer, threshold and policy.

A scorer measures the distance of a publication from normal, a threshold turns it into a score, a policy selects the
recovery that an alarm requests.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from mavfi.detectors.detector import Alarm, Detector
from mavfi.errors import BadInputError, not_known
from mavfi.numerics.jit import kernel_jit
from mavfi.states import Stage, State

NOT_FINITE = 1e9
"""Score of a publication with a value that is not finite: always an alarm."""
_WAYPOINT = "planning.waypoint"
"""The state whose anomalies the paper's policy counts."""
_COMMAND = "control.command"
"""The state whose anomalies the policy of the authors' AAD counts as well."""
_NONE = np.zeros(0, np.int64)
"""No field."""


class Reading(NamedTuple):
    """Distance of a publication from normal, by field.

    Attributes:
        distance: Distance of each watched field from normal, >= 0. Shape (n,).
        unit: Unit of each distance, e.g. a standard deviation; 0 for fields not yet judged. Shape (n,).
        first: First field updated by the publication.
        last: One past the last.
        regime: Column of the limits; negative if a value is not finite.
    """

    distance: np.ndarray
    unit: np.ndarray
    first: int
    last: int
    regime: int


class Scorer(ABC):
    """Measures publications against its model of normal behaviour; independent of alarms and policies.

    Calls: `use` once; `start` before each flight; then, for each publication, `score`, and `accept` when the value is
    passed on to its readers. A value that recovery replaces is scored and never accepted. `score` may be called more
    than once for a publication, so it must not change the memory; what a scorer learns during a flight, it learns in
    `accept`.

    Attributes:
        fields: Watched fields, "state.field".
        stages: Stage of each.
        states: Names of the states that it reads; None = all.
        memory_arrays: Memory of a flight, as arrays by name; 0 at its start.
        candidate: The publication scored last; None = none yet, or the memory was read.
        threshold: Converts readings to scores.
    """

    fields: tuple[str, ...]
    stages: tuple[str, ...]
    states: frozenset[str] | None = None
    memory_arrays: Mapping[str, np.ndarray] = {}
    candidate: State | None = None
    threshold: "Threshold"

    def use(self, threshold: "Threshold") -> None:
        """Set the threshold; called before the first flight."""
        self.threshold = threshold

    @property
    def compiled(self) -> Mapping[str, Callable[..., Any]]:
        """See `Detector`."""
        return {}

    def instrument(self, instrumented: Mapping[str, Callable[..., Any]]) -> None:  # noqa: B027 - one in Python has none
        """See `Detector`."""

    @abstractmethod
    def score(self, state: State) -> float | None:
        """Score of a publication, None if it is not watched; does not change the memory."""

    @abstractmethod
    def last_reading(self) -> Reading:
        """Reading of the publication scored last; its arrays are valid until the next call."""

    @abstractmethod
    def accept(self, state: State) -> None:
        """Record a published value of any state."""

    def not_finite(self, state: State) -> np.ndarray:
        """Indices of the watched fields of a publication that are not finite, for readings of a negative regime."""
        return _NONE

    def start(self) -> None:
        """Reset the memory at the start of a flight."""
        for part in self.memory_arrays.values():
            part[...] = 0

    def memory(self) -> tuple[bytes, ...]:
        """Memory between publications."""
        return tuple(part.tobytes() for part in self.memory_arrays.values())

    def restore(self, memory: tuple[bytes, ...]) -> None:
        """Inverse of `memory`."""
        for part, content in zip(self.memory_arrays.values(), memory, strict=True):
            part[...] = np.frombuffer(content, part.dtype).reshape(part.shape)

    def arrays(self) -> dict[str, np.ndarray]:
        """Memory between publications by name: the arrays themselves, not copies."""
        return dict(self.memory_arrays)


@kernel_jit
def largest_ratio(reading: Reading, limit: np.ndarray, ratios: np.ndarray) -> float:
    """Largest distance of the updated fields in units of its limit.

    Other fields are not judged: an accepted anomalous delta would otherwise raise its alarm again with every
    publication until it is updated.

    Args:
        reading: Reading of a publication.
        limit: Largest distance without an alarm, by field and regime, in units of the reading. Shape (n, regimes).
        ratios: Output, for the updated fields. Shape (n,).
    """
    worst = 0.0
    for index in range(reading.first, reading.last):
        ratios[index] = 0.0
        if reading.unit[index] > 0.0:
            ratios[index] = reading.distance[index] / (limit[index, reading.regime] * reading.unit[index])
        worst = max(worst, ratios[index])
    return worst


@kernel_jit
def mean_square_ratio(reading: Reading, limit: np.ndarray, ratios: np.ndarray) -> float:
    """Mean squared distance of all fields, updated or not, in units of its limit, shape (1, 1); see `largest_ratio`."""
    total = 0.0
    for value in reading.distance:
        total += value * value
    score = float(total / len(reading.distance) / limit[0, 0])
    ratios[reading.first : reading.last] = score
    return score


@kernel_jit
def score_of(reading: Reading, limit: np.ndarray, ratios: np.ndarray) -> float:
    """Score of a reading: mean square ratio for a single limit, else the largest ratio."""
    if reading.regime < 0:
        return NOT_FINITE
    if limit.shape == (1, 1):
        return mean_square_ratio(reading, limit, ratios)
    return largest_ratio(reading, limit, ratios)


class Threshold:
    """Converts readings to scores.

    Attributes:
        limit: See `limit` below.
        ratios: Distance / limit of each field updated by the reading judged last. Shape (n,).

    Args:
        limit: By field and regime, shape (n, regimes); or for the mean squared distance, shape (1, 1).
        size: Number of watched fields.
        usual: Largest distance of each field in normal flights, shape (n,): an alarm names the field with the largest
            distance relative to it, updated or not.  None: an alarm names all fields beyond their limits.
    """

    def __init__(self, limit: np.ndarray, size: int, usual: np.ndarray | None = None) -> None:
        self.limit = limit
        self._usual = usual
        self.ratios = np.zeros(size)

    def fields_of_alarm(self, reading: Reading, not_finite: np.ndarray) -> np.ndarray:
        """Indices of the fields that an alarm names.

        Args:
            reading: The reading judged last.
            not_finite: Indices of fields that are not finite; if there are any, the alarm names these.
        """
        if self._usual is not None:
            if len(not_finite):
                return not_finite[:1]
            return np.array([np.argmax(reading.distance / self._usual)])
        if len(not_finite):
            return not_finite
        return reading.first + np.flatnonzero(self.ratios[reading.first : reading.last] > 1.0)


Policy = Callable[[Alarm, State, bool], Alarm]
"""Recovery that an alarm requests.  Arguments: an alarm for the stage of the anomalous field, the publication, and
whether the last published value of this state was anomalous as well, for the states of `_counted_states`."""


def keyed(alarm: Alarm, state: State, persists: bool) -> Alarm:
    """Recompute the stage of the anomalous field."""
    return alarm


def abandon_waypoint(alarm: Alarm, state: State, persists: bool) -> Alarm:
    """The paper's policy for the AAD: recompute control, and abandon an anomalous way-point for the next one.

    If the last published way-point was anomalous as well, alarms persist: stop and replan.
    """
    waypoint = state.spec.name == _WAYPOINT
    return replace(alarm, stage="control", abandon_waypoint=waypoint, stop=waypoint and persists)


def published_aad(alarm: Alarm, state: State, persists: bool) -> Alarm:
    """The policy of the authors' code for the AAD: an anomalous way-point or command costs the way-point in force.

    The value is withheld, and the next way-point requested; if the last published value of the state was anomalous as
    well, a stop and another plan.  After any other anomaly only the command is recomputed, which corrects nothing.
    """
    drops = state.spec.name in (_WAYPOINT, _COMMAND)
    stops = drops and persists
    return replace(alarm, stage="control", abandon_waypoint=drops, stop=stops, withhold=drops)


def published_gad(alarm: Alarm, state: State, persists: bool) -> Alarm:
    """The policy of the authors' code for the GAD, which differs by the stage of the anomalous value.

    Planning is recomputed.  A command is withheld, and the way-point in force dropped for the next one.  A value of
    perception is published regardless; only the command is recomputed, which corrects nothing.
    """
    if state.spec.stage is Stage.PLANNING:
        return alarm
    drops = state.spec.name == _COMMAND
    return replace(alarm, stage="control", abandon_waypoint=drops, withhold=drops)


POLICIES: dict[str, Policy] = {
    "paper": abandon_waypoint,
    "keyed": keyed,
    "published_aad": published_aad,
    "published_gad": published_gad,
}
"""Recovery policies by name."""


def _counted_states(policy: Policy) -> tuple[str, ...]:
    """Names of the states for which a policy needs to know whether the last published value was anomalous."""
    if policy in (keyed, published_gad):
        return ()
    if policy is published_aad:
        return (_WAYPOINT, _COMMAND)
    return (_WAYPOINT,)


def find_policy(name: str) -> Policy:
    """A recovery policy by name; `BadInputError` if unknown."""
    return POLICIES[checked_name(name, POLICIES, "recovery policy")]


def checked_name(name: str, allowed: Collection[str], what: str) -> str:
    """The name, or a `BadInputError` if it is not allowed."""
    if name not in allowed:
        raise BadInputError(f"{what} {not_known(name, allowed)}")
    return name


class ScoringDetector(Detector):
    """A detector composed of scorer, threshold and policy.

    Args:
        source: Name in alarms.
        scorer: Measures publications.
        threshold: Converts measurements to scores.
        policy: Recovery that an alarm requests, see `POLICIES`.
    """

    def __init__(self, source: str, scorer: Scorer, threshold: Threshold, policy: Policy = keyed) -> None:
        self.source = source
        self.scorer = scorer
        self.threshold = threshold
        self.policy = policy
        scorer.use(threshold)
        self.states = scorer.states
        self._counted = _counted_states(policy)
        self._persists = np.zeros(max(1, len(self._counted)), np.bool_)
        self._last_state: State | None = None
        self._last_score: float | None = None

    def start(self) -> None:
        """Reset the memory at the start of a flight."""
        self._last_state = None
        self._persists[:] = False
        self.scorer.start()

    def score(self, state: State, time_us: int) -> float | None:
        """Score of a publication, in units of the threshold: > 1 is an alarm; None if it is not watched."""
        if self._last_state is not state:
            self._last_score = self.scorer.score(state)
            self._last_state = state
        return self._last_score

    def check(self, state: State, time_us: int) -> Alarm | None:
        """Check a publication."""
        if self._last_state is not state:  # as `score`, without another call
            self._last_score = self.scorer.score(state)
            self._last_state = state
        score = self._last_score
        if score is None or score <= 1.0:
            return None
        return self._alarm(state, score)

    def _alarm(self, state: State, score: float) -> Alarm:
        """The alarm on the publication scored last, with the recovery that the policy requests."""
        reading = self.scorer.last_reading()
        not_finite = _NONE
        if reading.regime < 0:
            not_finite = self.scorer.not_finite(state)
        indices = self.threshold.fields_of_alarm(reading, not_finite)
        names = tuple(self.scorer.fields[index] for index in indices)
        alarm = Alarm(self.source, self.scorer.stages[indices[0]], score=float(score), fields=names)
        persists = False
        if state.spec.name in self._counted:
            persists = bool(self._persists[self._counted.index(state.spec.name)])
        return self.policy(alarm, state, persists)

    def accept(self, state: State, time_us: int) -> None:
        """Record a published value."""
        if state.spec.name in self._counted:
            score = self.score(state, time_us)
            if score is not None:
                self._persists[self._counted.index(state.spec.name)] = not score <= 1.0
        self._last_state = None
        self.scorer.accept(state)

    @property
    def compiled(self) -> Mapping[str, Callable[..., Any]]:
        """See `Detector`."""
        return self.scorer.compiled

    def instrument(self, instrumented: Mapping[str, Callable[..., Any]]) -> None:
        """See `Detector`."""
        self.scorer.instrument(instrumented)

    def memory(self) -> tuple[tuple[bytes, ...], bytes]:
        """Memory between publications, see `Detector`."""
        return self.scorer.memory(), self._persists.tobytes()

    def restore(self, memory: tuple[tuple[bytes, ...], bytes]) -> None:
        """Inverse of `memory`."""
        self._last_state = None
        content, persists = memory
        self._persists[:] = np.frombuffer(persists, np.bool_)
        self.scorer.restore(content)

    def arrays(self) -> dict[str, np.ndarray]:
        """Memory between publications by name, see `Detector`."""
        self._last_state = None
        return {**self.scorer.arrays(), "persists": self._persists}
