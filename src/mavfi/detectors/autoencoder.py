"""AAD: one autoencoder for all stages (MAVFI section IV-D), with two recovery policies."""

import math
from typing import NamedTuple

import numpy as np

from mavfi.detectors import features
from mavfi.detectors.detector import Alarm
from mavfi.detectors.features import Watch
from mavfi.detectors.model import Model
from mavfi.detectors.preprocess import Preprocessor
from mavfi.errors import BadInputError
from mavfi.numerics.jit import kernel_jit
from mavfi.states import State

SOURCE = "autoencoder"
POLICIES = ("paper", "keyed")
INPUT_LIMIT = 10.0
"""Inputs are clamped to this many training peaks: a huge one would spill through the decoder into all outputs."""
NOT_FINITE = 1e9
"""Score of a value that is not finite: an alarm whatever was learned."""


class Network(NamedTuple):
    """A trained multi-layer perceptron with tanh in the hidden layers and a linear output.

    Attributes:
        scale: Training peak of each delta. Shape (n,).
        sizes: Neurons per layer, the input counted; n, ..., n. Shape (layers,), int64.
        weights: Of each layer in turn the coefficients, (neurons before, neurons) in C order, then the intercepts.
        work: Room for two layers and the scaled inputs. Shape (3, largest layer).
    """

    scale: np.ndarray
    sizes: np.ndarray
    weights: np.ndarray
    work: np.ndarray


@kernel_jit
def reconstruct(inputs: np.ndarray, network: Network) -> None:
    """Run the network; its output is then in the first row of `work`.

    Args:
        inputs: Shape (n,).
        network: The network.
    """
    sizes, weights = network.sizes, network.weights
    now, after = network.work[0], network.work[1]
    now[: sizes[0]] = inputs
    start = 0
    for layer in range(1, len(sizes)):
        before, neurons = sizes[layer - 1], sizes[layer]
        intercepts = start + before * neurons
        for neuron in range(neurons):
            total = 0.0
            for source in range(before):
                total += now[source] * weights[start + source * neurons + neuron]
            total += weights[intercepts + neuron]
            after[neuron] = total if layer == len(sizes) - 1 else math.tanh(total)
        start = intercepts + neurons
        now[:neurons] = after[:neurons]


@kernel_jit
def residuals(vector: np.ndarray, network: Network, errors: np.ndarray) -> None:
    """Absolute reconstruction error of a vector of deltas.

    Args:
        vector: Deltas. Shape (n,), int16.
        network: The network.
        errors: Filled in, in units of the network's scale. Shape (n,).
    """
    inputs = network.work[2, : len(vector)]
    for index in range(len(vector)):
        inputs[index] = min(max(vector[index] / network.scale[index], -INPUT_LIMIT), INPUT_LIMIT)
    reconstruct(inputs, network)
    for index in range(len(vector)):
        errors[index] = abs(inputs[index] - network.work[0, index])


@kernel_jit
def excess(errors: np.ndarray, regime: int, limit: np.ndarray, first: int, last: int) -> float:
    """Score of residuals in units of what is allowed; > 1 is an alarm.

    The mean is over all outputs, as in the paper.  Limits per output judge the renewed ones only: a delta that was let
    pass would otherwise raise the same alarm again with every publication until it is renewed.

    Args:
        errors: Residuals. Shape (n,).
        regime: Regime of the publication.
        limit: Largest mean squared error, shape (1, 1); or largest error of each output and regime, shape (n, 3).
        first: First output that the publication renews.
        last: One past the last.
    """
    worst = 0.0
    if len(limit) == 1:
        for error in errors:
            worst += error * error
        return float(worst / len(errors) / limit[0, 0])
    for index in range(first, last):
        worst = max(worst, errors[index] / limit[index, regime])
    return worst


@kernel_jit
def judge(
    content: np.ndarray, slot: int, watch: Watch, network: Network, limit: np.ndarray,
    vector: np.ndarray, errors: np.ndarray,
) -> float:  # fmt: skip
    """Score of all last deltas, of which this publication renews its own.

    Args:
        content: As of `features.measure`.
        slot: As of `features.measure`.
        watch: As of `features.measure`.
        network: The network.
        limit: As of `excess`.
        vector: Last deltas; those of this publication are filled in. Shape (n,), int16.
        errors: Filled in: residuals. Shape (n,).

    Returns:
        Score; > 1 is an alarm.
    """
    regime = features.measure(content, slot, watch, vector)
    residuals(vector, network, errors)
    if regime < 0:
        return NOT_FINITE
    first, last = watch.places[slot, features.FIRST], watch.places[slot, features.LAST]
    return excess(errors, regime, limit, first, last)


class AutoencoderDetector:
    """AAD in either profile and policy.

    Profile `paper`: mean squared error against its upper bound on error-free flights.  `tuned`: each output's residual
    against its largest in training, per regime.  Policy `paper`: the control stage is recomputed and a struck way-point
    is abandoned for the next; where the way-point published last was anomalous as well, alarms persist: stop and plan
    anew.  Policy `keyed`: the stage with the largest residual, relative to its largest in training, is recomputed.

    Every delta is judged once: one that is published in spite of an alarm is not held for the vectors that follow.
    """

    model_kind = SOURCE

    def __init__(self, model: Model, policy: str | None = None, preprocessor: Preprocessor | None = None) -> None:
        """Take over what was trained.

        Args:
            model: A model of kind "autoencoder".
            policy: "paper" or "keyed"; default: "paper" for profile `paper`, "keyed" for `tuned`.
            preprocessor: Of the fields that the model was trained on, if they are no monitored set.

        Raises:
            BadInputError: The policy is not known.
        """
        self._policy = policy or {"paper": "paper"}.get(model.profile, "keyed")
        if self._policy not in POLICIES:
            raise BadInputError(f"recovery policy {policy!r}: not known; allowed: {', '.join(POLICIES)}")
        parameters = model.parameters
        self._features = preprocessor or Preprocessor(model.monitored, model.profile, model.prediction)
        sizes = np.array(parameters["sizes"], np.int64)
        scale, weights = np.array(parameters["scale"], np.float64), np.array(parameters["weights"], np.float64)
        self._network = Network(scale, sizes, weights, np.zeros((3, int(sizes.max()))))
        self._limit = np.array(parameters["limit"], np.float64)
        self._key = np.array(parameters["key"], np.float64)
        size = len(self._features.fields)
        self._held = np.zeros(size, np.int16)
        self._vector = np.zeros(size, np.int16)
        self._errors = np.zeros(size)
        self._anomalous_waypoint = False

    def start(self) -> None:
        """Forget the last flight."""
        self._features.start()
        self._held[:] = 0
        self._anomalous_waypoint = False

    def check(self, state: State, time_us: int) -> Alarm | None:
        """Judge a publication."""
        slot = self._features.slots.get(state.spec.name)
        if slot is None:
            return None
        content = state.header.view(np.uint8)
        score = self._judge(content, slot)
        return None if score <= 1.0 else self._alarm(slot, score, content)

    def accept(self, state: State, time_us: int) -> None:
        """Take note of a value that was published."""
        known = self._features
        slot = known.slots.get(state.spec.name)
        if slot is None:
            known.note(state)
            return
        content = state.header.view(np.uint8)
        normal = self._judge(content, slot) <= 1.0
        first, last = known.range_of(slot)
        self._held[first:last] = self._vector[first:last] if normal else 0
        if known.is_waypoint(slot):
            self._anomalous_waypoint = not normal
        features.commit(content, slot, known.watch)

    def _judge(self, content: np.ndarray, slot: int) -> float:
        self._vector[:] = self._held
        watch = self._features.watch
        return judge(content, slot, watch, self._network, self._limit, self._vector, self._errors)

    def _alarm(self, slot: int, score: float, content: np.ndarray) -> Alarm:
        worst = int(np.argmax(self._errors / self._key))
        if score == NOT_FINITE:
            first, last = self._features.range_of(slot)
            worst = first + int(np.argmax(features.not_finite(content, self._features.watch.table[first:last])))
        fields = (self._features.fields[worst],)
        if self._policy == "keyed":
            return Alarm(SOURCE, self._features.stage(worst), score=float(score), fields=fields)
        waypoint = self._features.is_waypoint(slot)
        return Alarm(SOURCE, "control", waypoint, waypoint and self._anomalous_waypoint, float(score), fields)
