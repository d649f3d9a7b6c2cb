"""AAD: one autoencoder for all stages (MAVFI section IV-D).  Only training needs scikit-learn."""

import warnings
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from mavfi.detectors import features
from mavfi.detectors.features import LastJudgement, WatchedFields
from mavfi.detectors.model import SMALLEST_LIMIT, Model
from mavfi.detectors.preprocess import DeltaScorer, Preprocessor, conclude
from mavfi.detectors.scoring import ScoringDetector, Threshold, find_policy
from mavfi.detectors.training import Sample, TrainedDetector, regime_limits
from mavfi.errors import BadInputError
from mavfi.numerics.elementary import tanh
from mavfi.numerics.jit import kernel_jit
from mavfi.numerics.portable import call_portably
from mavfi.numerics.stored import load

if TYPE_CHECKING:
    from sklearn.neural_network import MLPRegressor

SOURCE = "autoencoder"
"""Name in its alarms, and kind of its models."""
INPUT_LIMIT = 10.0
"""Inputs are clamped to this many training peaks: otherwise one huge input would disturb all outputs."""
WEIGHT_DIGITS = 8
"""Significant digits of the stored weights; further digits may depend on the version of the linear algebra library."""
_TRAINING_STREAM = 4
"""Spawn key of the random stream that draws training rows."""
_WIDEST = 10_000
"""Most neurons in a layer."""


class Network(NamedTuple):
    """A trained multi-layer perceptron with tanh in the hidden layers and a linear output.

    Attributes:
        scale: Training peak of each delta. Shape (n,).
        sizes: Neurons per layer, including the input; n, ..., n. Shape (layers,), int64.
        weights: For each layer, the coefficients, (neurons before, neurons) in C order, then the intercepts.
        work: Buffers for two layers and the scaled inputs. Shape (3, largest layer).
    """

    scale: np.ndarray
    sizes: np.ndarray
    weights: np.ndarray
    work: np.ndarray


@kernel_jit
def reconstruct(inputs: np.ndarray, network: Network) -> None:
    """Run the network on inputs of shape (n,); leaves the output in the first row of `work`."""
    sizes, weights = network.sizes, network.weights
    now, after = network.work[0], network.work[1]
    now[: sizes[0]] = inputs
    start = 0
    for layer in range(1, len(sizes)):
        before, neurons = sizes[layer - 1], sizes[layer]
        intercepts = start + before * neurons
        total = after[:neurons]
        total[:] = 0.0
        for source in range(before):  # the sums of all neurons side by side: several per machine instruction
            value, row = now[source], weights[start + source * neurons : start + (source + 1) * neurons]
            for neuron in range(neurons):
                total[neuron] += value * row[neuron]
        for neuron in range(neurons):
            total[neuron] += weights[intercepts + neuron]
        if layer < len(sizes) - 1:
            for neuron in range(neurons):
                total[neuron] = tanh(total[neuron])
        start = intercepts + neurons
        now[:neurons] = total


@kernel_jit
def residuals(vector: np.ndarray, network: Network, errors: np.ndarray) -> None:
    """Absolute reconstruction error of a vector of deltas.

    Args:
        vector: Deltas. Shape (n,), int16.
        network: A trained network.
        errors: Output, in units of the network's scale. Shape (n,).
    """
    inputs = network.work[2, : len(vector)]
    for index in range(len(vector)):
        inputs[index] = min(max(vector[index] / network.scale[index], -INPUT_LIMIT), INPUT_LIMIT)
    reconstruct(inputs, network)
    for index in range(len(vector)):
        errors[index] = abs(inputs[index] - network.work[0, index])


@kernel_jit
def read_residuals(
    content: np.ndarray, slot: int, watch: WatchedFields, network: Network, vector: np.ndarray, errors: np.ndarray
) -> int:
    """Residuals of the latest deltas of all fields, after `features.measure` has updated those of this publication."""
    regime = features.measure(content, slot, watch, vector)
    residuals(vector, network, errors)
    return regime


@kernel_jit
def settle_network(
    watch: WatchedFields, scratch: LastJudgement, limit: np.ndarray, network: Network, held: np.ndarray
) -> None:
    """Commit the publication judged last as published; hold its deltas if they are normal."""
    table_row = watch.places[scratch.status[features.SLOT]]
    for index in range(table_row[features.FIRST], table_row[features.LAST]):
        held[index] = scratch.deltas[index] if scratch.score[0] <= 1.0 else 0
    features.settle(scratch, watch)


@kernel_jit
def judge_network(
    content: np.ndarray,
    slot: int,
    watch: WatchedFields,
    scratch: LastJudgement,
    limit: np.ndarray,
    network: Network,
    held: np.ndarray,
) -> float:
    """Score of a publication, see `preprocess.DeltaScorer`, from all latest deltas; `held` has shape (n,)."""
    if scratch.status[features.ACCEPTED] != 0:
        settle_network(watch, scratch, limit, network, held)
    features.propose(content, slot, scratch)
    scratch.deltas[:] = held
    regime = read_residuals(content, slot, watch, network, scratch.deltas, scratch.distance)
    return conclude(regime, watch.places[slot], scratch, limit)


class LastErrors(NamedTuple):
    """The vector of deltas that was judged last, and its errors: most publications have the deltas of the one before.

    Attributes:
        deltas: Shape (n,), int16.
        errors: Shape (n,).
        known: Whether there is one. Shape (1,).
    """

    deltas: np.ndarray
    errors: np.ndarray
    known: np.ndarray


@kernel_jit
def _judge_unless_known(
    content: np.ndarray,
    slot: int,
    watch: WatchedFields,
    scratch: LastJudgement,
    limit: np.ndarray,
    network: Network,
    held: np.ndarray,
    last: LastErrors,
) -> float:
    """`judge_network`, but the network does not run for the deltas of the publication before.

    `judge_network` is not built of this function, since faults are drawn in its instructions.
    """
    if scratch.status[features.ACCEPTED] != 0:
        settle_network(watch, scratch, limit, network, held)
    features.propose(content, slot, scratch)
    scratch.deltas[:] = held
    regime = features.measure(content, slot, watch, scratch.deltas)
    same = last.known[0]
    for index in range(len(held)):
        same &= last.deltas[index] == scratch.deltas[index]
    if not same:
        residuals(scratch.deltas, network, last.errors)
        last.deltas[:] = scratch.deltas
        last.known[0] = True
    scratch.distance[:] = last.errors
    return conclude(regime, watch.places[slot], scratch, limit)


_NO_ERRORS = LastErrors(np.zeros(1, np.int16), np.zeros(1), np.zeros(1, np.bool_))
_TABLES = features.kind_with(
    Network(np.zeros(1), np.zeros(1, np.int64), np.zeros(1), np.zeros((3, 1))), np.zeros(1, np.int16), _NO_ERRORS
)
"""Types of the compiled functions' arguments, by examples."""


@kernel_jit
def _network_at(content: np.ndarray, slot: int, address: int) -> float:
    watch, scratch, limit, network, held, last = load(address, _TABLES)
    return _judge_unless_known(content, slot, watch, scratch, limit, network, held, last)


class AutoencoderScorer(DeltaScorer):
    """Reconstruction errors of the latest deltas of all fields.

    Every delta is judged once: a delta published in spite of an alarm is not held for later vectors.
    """

    judge = staticmethod(judge_network)
    settle = staticmethod(settle_network)
    judge_at = staticmethod(_network_at)
    kind = _TABLES

    def __init__(self, preprocessor: Preprocessor, network: Network) -> None:
        size = len(preprocessor.fields)
        held = np.zeros(size, np.int16)
        self.cached_results = (LastErrors(np.zeros(size, np.int16), np.zeros(size), np.zeros(1, np.bool_)),)
        super().__init__(preprocessor, network, held)
        self.memory_arrays = {**self.memory_arrays, "held": held}


class AutoencoderDetector(ScoringDetector, TrainedDetector):
    """AAD.

    With a model of the paper's codes: mean squared error against its upper bound on error-free flights.  With one of
    predictions: residual of each output against its training maximum, per regime.

    Args:
        model: A model of kind "autoencoder".
        policy: Name of a recovery policy, see `scoring.POLICIES`.
        preprocessor: For the fields that the model was trained on, unless these are a monitored set.

    Raises:
        BadInputError: Unknown policy.
    """

    model_kind = SOURCE

    def __init__(self, model: Model, policy: str = "keyed", preprocessor: Preprocessor | None = None) -> None:
        deltas = preprocessor or Preprocessor(model.monitored, model.profile, model.prediction)
        count = len(deltas.fields)
        network = network_of(model, count)
        shape = (count, features.REGIMES)
        if model.profile == "paper":  # one limit for all fields
            shape = (1, 1)
        limit = model.numbers("limit", *shape, least=SMALLEST_LIMIT)
        threshold = Threshold(limit, count, model.numbers("key", count, least=SMALLEST_LIMIT))
        super().__init__(SOURCE, AutoencoderScorer(deltas, network), threshold, find_policy(policy))

    @classmethod
    def fit(cls, sample: Sample, features: Preprocessor, figures: Mapping[str, Any]) -> dict[str, Any]:
        """Parameters of a model, see `fit_autoencoder`."""
        return fit_autoencoder(sample, **figures)


def network_of(model: Model, fields: int) -> Network:
    """The network of a model with this number of fields; `BadInputError` if the model has none."""
    sizes = _layers(model, fields)
    weights = model.numbers("weights", int((sizes[:-1] * sizes[1:] + sizes[1:]).sum()))
    return Network(model.numbers("scale", fields, least=1.0), sizes, weights, np.zeros((3, int(sizes.max()))))


def _layers(model: Model, fields: int) -> np.ndarray:
    """Neurons per layer of a model with this number of fields."""
    parameter = model.parameters.get("sizes")
    layers = 0
    if isinstance(parameter, list):
        layers = len(parameter)
    sizes = model.numbers("sizes", layers, least=1.0)
    if len(sizes) < 2 or (sizes > _WIDEST).any() or (sizes % 1 != 0).any() or not sizes[0] == sizes[-1] == fields:
        raise BadInputError(f"parameter 'sizes': {parameter}; allowed: neurons per layer, {fields}, ..., {fields}")
    return sizes.astype(np.int64)


def fit_autoencoder(  # noqa: PLR0913 - the figures of a YAML file
    sample: Sample,
    *,
    hidden_layers: Sequence[int],
    epochs: int,
    learning_rate: float,
    largest_class: int,
    margin: float | None = None,
    smallest_regime: int = 0,
) -> dict[str, Any]:
    """Weights and limits of the AAD.

    Args:
        sample: Error-free flights.
        hidden_layers: Neurons per hidden layer.
        epochs: Training epochs.
        learning_rate: Learning rate of Adam.
        largest_class: Training vectors per state and regime; rarer classes are used completely.
        margin: Limit / largest error in training, by output and regime; None = one limit, the largest mean squared
            error, without a margin.
        smallest_regime: A regime with fewer samples takes the largest limit among the regimes of its field.
    """
    scale = np.maximum(1.0, np.abs(sample.vectors.astype(np.float64)).max(axis=0))
    inputs = sample.vectors[representative(sample, largest_class)] / scale
    network = export(call_portably(train_network, inputs, hidden_layers, epochs, learning_rate), scale)
    errors = all_residuals(sample.vectors, network)
    usual = np.maximum(errors.max(axis=0), 1.0 / scale)
    if margin is None:
        limit = [[float((errors**2).mean(axis=1).max())]]
    else:
        limit = regime_limits(*_regime_peaks(errors, sample.regimes, scale), margin, smallest_regime)
    return {
        "scale": scale.tolist(),
        "sizes": network.sizes.tolist(),
        "weights": network.weights.tolist(),
        "limit": limit,
        "key": usual.tolist(),
    }


def _regime_peaks(errors: np.ndarray, regimes: np.ndarray, scale: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Largest residual and number of samples by output and regime; the residual of one code never raises an alarm."""
    peaks = np.repeat((1.0 / scale)[:, None], features.REGIMES, axis=1)
    counts = np.bincount(regimes, minlength=features.REGIMES)
    for regime in np.flatnonzero(counts):
        peaks[:, regime] = np.maximum(peaks[:, regime], errors[regimes == regime].max(axis=0))
    return peaks, np.broadcast_to(counts, peaks.shape)


def representative(sample: Sample, largest_class: int) -> np.ndarray:
    """Training rows: all rows of each state and regime, or `largest_class` drawn ones. Ascending, int64."""
    generator = np.random.Generator(np.random.PCG64(np.random.SeedSequence(0, spawn_key=(_TRAINING_STREAM,))))
    classes = sample.slots * features.REGIMES + sample.regimes
    rows = []
    for label in np.unique(classes):
        members = np.flatnonzero(classes == label)
        if len(members) > largest_class:
            members = generator.choice(members, largest_class, replace=False)
        rows.append(members)
    return np.sort(np.concatenate(rows))


def train_network(
    inputs: np.ndarray, hidden_layers: Sequence[int], epochs: int, learning_rate: float
) -> "MLPRegressor":
    """A network that reproduces its inputs, shape (m, n): Adam, mean squared error, fixed epochs, one thread.

    The paper's encoder "of size 13, 6 and 3" counts the input as a layer, and the decoder mirrors it.
    """
    from sklearn.exceptions import ConvergenceWarning
    from sklearn.neural_network import MLPRegressor
    from threadpoolctl import threadpool_limits

    network = MLPRegressor(
        hidden_layer_sizes=tuple(hidden_layers),
        activation="tanh",
        solver="adam",
        learning_rate_init=learning_rate,
        batch_size=min(256, len(inputs)),
        max_iter=epochs,
        tol=0.0,
        n_iter_no_change=epochs,
        random_state=0,
    )
    targets = inputs
    if inputs.shape[1] == 1:  # scikit-learn warns of a single column
        targets = inputs.ravel()
    with threadpool_limits(1), warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)  # the number of epochs is the stopping rule
        network.fit(inputs, targets)
    return network


def export(network: "MLPRegressor", scale: np.ndarray) -> Network:
    """A trained network in the form used in flight; its inputs are deltas / `scale`.

    Weights are rounded so that training on another machine gives the same file (two machines differed by 2e-14).
    """
    sizes = [network.coefs_[0].shape[0], *(len(intercepts) for intercepts in network.intercepts_)]
    layers = zip(network.coefs_, network.intercepts_, strict=True)
    weights = [part for coefficients, intercepts in layers for part in (coefficients.ravel(), intercepts)]
    rounded = np.array([float(f"{weight:.{WEIGHT_DIGITS - 1}e}") for weight in np.concatenate(weights)])
    return Network(scale, np.array(sizes, np.int64), rounded, np.zeros((3, max(sizes))))


@kernel_jit
def all_residuals(vectors: np.ndarray, network: Network) -> np.ndarray:
    """Residuals of the rows of int16 vectors, shape (m, n). Shape (m, n), float64."""
    errors = np.zeros(vectors.shape)
    for row in range(len(vectors)):
        residuals(vectors[row], network, errors[row])
    return errors
