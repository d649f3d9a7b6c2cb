"""Fits the detectors to error-free flights.  The flights come from elsewhere; nothing here flies."""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import sklearn
from sklearn.exceptions import ConvergenceWarning
from sklearn.neural_network import MLPRegressor
from threadpoolctl import threadpool_limits

from mavfi.detectors import autoencoder, features, gaussian
from mavfi.detectors.model import FITTED_TO, Model
from mavfi.detectors.preprocess import PROFILES, Preprocessor
from mavfi.detectors.recorder import WATCHED, Recording
from mavfi.errors import BadInputError
from mavfi.numerics import welford
from mavfi.numerics.jit import kernel_jit

SIGMAS = 5.0
"""The paper's n, for all fields; it can be configured there and is not told."""
MIN_COUNT = 20.0
"""Samples before an online detector judges."""
MARGIN = 1.25
"""`tuned`: limit / largest distance in training; without it, thirteen maxima are exceeded four times an hour."""
SMALLEST_REGIME = 50
"""Samples below which a regime takes the largest limit of its field's regimes."""
HIDDEN_LAYERS = (6, 3, 6)
"""The paper's encoder "of size 13, 6 and 3" counts the input as a layer; the decoder mirrors it."""
LARGEST_CLASS = 20_000
"""Vectors of one state and regime that the network is trained on; rarer ones are all taken."""
EPOCHS = 40
WEIGHT_DIGITS = 8
"""Significant digits of weights that are kept; those after them depend on the linear algebra of the machine."""
_TRAINING_STREAM = 4


@dataclass(frozen=True)
class Sample:
    """What a detector sees in all flights.

    Attributes:
        vectors: Last delta of every field at each publication. Shape (m, n), int16.
        slots: State that was published. Shape (m,), int64.
        regimes: Shape (m,), int64.
        first: Whether it was the first publication of its state in a flight: it has no delta. Shape (m,), bool.
    """

    vectors: np.ndarray
    slots: np.ndarray
    regimes: np.ndarray
    first: np.ndarray


def fit(
    recordings: Sequence[Recording], provenance: Mapping[str, Any], monitored: str = "paper-13"
) -> dict[str, Model]:
    """Fit both detectors in both profiles.

    Args:
        recordings: Error-free flights, 100 or more for thresholds that hold.
        provenance: Where they come from: stack, platform, v_max, planner, and whatever else tells (seeds, flights).
        monitored: Name of the monitored set.

    Returns:
        Models by "<kind>-<profile>".  The same recordings give the same models.

    Raises:
        BadInputError: The recordings lack publications, or hold numbers that are not finite.
    """
    missing = [key for key in FITTED_TO if key not in provenance]
    if missing:
        raise BadInputError(f"provenance of a model: lacks {', '.join(missing)}")
    prediction, errors = best_prediction(recordings)
    origin = {**provenance, "versions": {"numpy": np.__version__, "scikit-learn": sklearn.__version__}}
    models = {}
    for profile in PROFILES:
        preprocessor = Preprocessor(monitored, profile, prediction)
        sample = collect(recordings, preprocessor)
        statistics = fit_online(sample, preprocessor) if profile == "paper" else fit_frozen(sample, preprocessor)
        network = fit_autoencoder(sample, per_output=profile == "tuned")
        told = origin if profile == "paper" else {**origin, "innovation_m": errors}
        for kind, parameters in ((gaussian.SOURCE, statistics), (autoencoder.SOURCE, network)):
            models[f"{kind}-{profile}"] = Model(kind, profile, monitored, prediction, parameters, told)
    return models


def save(models: Mapping[str, Model], folder: Path) -> list[Path]:
    """Write every model into a folder.

    Raises:
        BadInputError: The folder cannot be written.
    """
    return [model.save(folder) for model in models.values()]


def collect(recordings: Sequence[Recording], preprocessor: Preprocessor) -> Sample:
    """The vectors of all flights, by the functions that detectors fly with.

    Raises:
        BadInputError: A watched state was never published, or a published number is not finite.
    """
    parts = [_replay(recording, preprocessor) for recording in recordings]
    if not parts:
        raise BadInputError("training: no recordings; fly at least one error-free flight")
    sample = Sample(*(np.concatenate([getattr(part, name) for part in parts]) for name in Sample.__annotations__))
    for name, slot in preprocessor.slots.items():
        if not np.any((sample.slots == slot) & ~sample.first):
            raise BadInputError(f"training: {name} was published less than twice in every recorded flight")
    if np.any(sample.regimes < 0):
        raise BadInputError("training: a recorded flight holds numbers that are not finite")
    return sample


def _replay(recording: Recording, preprocessor: Preprocessor) -> Sample:
    preprocessor.start()
    lookup = np.array([*(preprocessor.slots.get(name, features.ODOMETRY) for name in WATCHED), features.ODOMETRY])
    slots = lookup[recording.kinds]
    vectors = np.zeros((len(slots), len(preprocessor.fields)), np.int16)
    regimes = np.zeros(len(slots), np.int64)
    events = features.Events(slots, recording.ends, recording.content)
    features.replay(events, preprocessor.watch, vectors, regimes)
    first = np.zeros(len(slots), bool)
    first[np.unique(slots, return_index=True)[1]] = True
    published = slots != features.ODOMETRY
    return Sample(vectors[published], slots[published], regimes[published], first[published])


def innovations(recording: Recording) -> dict[str, np.ndarray]:
    """How far way-points lie from where the ones before them on the same trajectory predict them.

    Returns:
        By prediction (see `preprocess.PREDICTIONS`), error per axis (m). Shape (k, 3).
    """
    _, headers = recording.headers("planning.waypoint")
    position, velocity = (np.stack([headers[name] for name in names], 1) for names in (("x", "y", "z"), _VELOCITY))
    same = headers["trajectory_seq"][1:] == headers["trajectory_seq"][:-1]
    step = np.diff(position, axis=0)
    mean = (velocity[1:] + velocity[:-1]) / 2.0
    duration = headers["duration"][1:, None]
    return {"interval": (step - velocity[1:] * duration)[same], "trapezoid": (step - mean * duration)[same]}


_VELOCITY = ("vx", "vy", "vz")


def best_prediction(recordings: Sequence[Recording]) -> tuple[str, dict[str, dict[str, float]]]:
    """The prediction that fits these flights best.

    Args:
        recordings: Error-free flights.

    Returns:
        Key of `preprocess.PREDICTIONS`; by prediction, the 99 % quantile and the largest error (m).
    """
    found = [innovations(recording) for recording in recordings]
    told = {}
    for name in ("interval", "trapezoid"):
        errors = np.abs(np.concatenate([part[name].ravel() for part in found] or [np.zeros(0)]))
        if len(errors) == 0:
            raise BadInputError("training: the recordings hold no trajectory of two way-points")
        told[name] = {"p99": float(np.quantile(errors, 0.99)), "max": float(errors.max())}
    return min(told, key=lambda name: told[name]["p99"]), told


def fit_online(sample: Sample, preprocessor: Preprocessor) -> dict[str, Any]:
    """Statistics from which the `paper` GAD goes on: k, M, S of each field."""
    statistics = []
    for index, slot in _fields(preprocessor):
        values = sample.vectors[(sample.slots == slot) & ~sample.first, index]
        statistics.append([float(number) for number in welford.accumulate(values.astype(np.float64))])
    return {"statistics": statistics, "sigmas": SIGMAS, "min_count": MIN_COUNT}


def fit_frozen(sample: Sample, preprocessor: Preprocessor) -> dict[str, Any]:
    """Centre and limit of the `tuned` GAD, of each field and regime; a distance of one code is always allowed."""
    centre = np.zeros((len(preprocessor.fields), features.REGIMES))
    limit = np.full_like(centre, MARGIN)
    for index, slot in _fields(preprocessor):
        own = (sample.slots == slot) & ~sample.first
        few = []
        for regime in range(features.REGIMES):
            values = sample.vectors[own & (sample.regimes == regime), index].astype(np.float64)
            if len(values) < SMALLEST_REGIME:
                few.append(regime)
            if len(values):
                centre[index, regime] = values.mean()
                limit[index, regime] = MARGIN * max(1.0, float(np.abs(values - values.mean()).max()))
        limit[index, few] = limit[index].max()
    return {"centre": centre.tolist(), "limit": limit.tolist()}


def _fields(preprocessor: Preprocessor) -> list[tuple[int, int]]:
    """Index and watched state of each field."""
    return [(index, preprocessor.slots[preprocessor.state(index)]) for index in range(len(preprocessor.fields))]


def fit_autoencoder(sample: Sample, per_output: bool) -> dict[str, Any]:
    """Weights and limits of the AAD.

    Args:
        sample: Error-free flights.
        per_output: Limits per output and regime with a margin (`tuned`); otherwise the largest mean squared error.
    """
    scale = np.maximum(1.0, np.abs(sample.vectors.astype(np.float64)).max(axis=0))
    chosen = sample.vectors[representative(sample)]
    network = export(train_network(chosen / scale), scale)
    errors = all_residuals(sample.vectors, network)
    peaks = np.maximum(errors.max(axis=0), 1.0 / scale)
    limit = _regime_limits(errors, sample.regimes, scale) if per_output else [[float((errors**2).mean(axis=1).max())]]
    return {
        "scale": scale.tolist(), "sizes": network.sizes.tolist(), "weights": network.weights.tolist(), "limit": limit,
        "key": peaks.tolist(),
    }  # fmt: skip


def _regime_limits(errors: np.ndarray, regimes: np.ndarray, scale: np.ndarray) -> list[list[float]]:
    """Largest residual of each output and regime with a margin; the residual of one code is always allowed."""
    limit = np.repeat((1.0 / scale)[:, None], features.REGIMES, axis=1)
    few = []
    for regime in range(features.REGIMES):
        own = errors[regimes == regime]
        if len(own):
            limit[:, regime] = np.maximum(limit[:, regime], own.max(axis=0))
        if len(own) < SMALLEST_REGIME:
            few.append(regime)
    limit[:, few] = limit.max(axis=1, keepdims=True)
    result: list[list[float]] = (MARGIN * limit).tolist()
    return result


def representative(sample: Sample) -> np.ndarray:
    """Rows to train the network on: of each state and regime all, or LARGEST_CLASS drawn ones. Ascending, int64."""
    generator = np.random.Generator(np.random.PCG64(np.random.SeedSequence(0, spawn_key=(_TRAINING_STREAM,))))
    classes = sample.slots * features.REGIMES + sample.regimes
    rows = []
    for label in np.unique(classes):
        own = np.flatnonzero(classes == label)
        rows.append(generator.choice(own, LARGEST_CLASS, replace=False) if len(own) > LARGEST_CLASS else own)
    return np.sort(np.concatenate(rows))


def train_network(inputs: np.ndarray) -> MLPRegressor:
    """A network that reproduces its inputs; Adam, mean squared error, a fixed number of epochs on one thread.

    Args:
        inputs: Scaled deltas. Shape (m, n).
    """
    network = MLPRegressor(
        hidden_layer_sizes=HIDDEN_LAYERS, activation="tanh", solver="adam", learning_rate_init=2e-3,
        batch_size=min(256, len(inputs)), max_iter=EPOCHS, tol=0.0, n_iter_no_change=EPOCHS, random_state=0,
    )  # fmt: skip
    with threadpool_limits(1), warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)  # the number of epochs is the stopping rule
        network.fit(inputs, inputs if inputs.shape[1] > 1 else inputs.ravel())
    return network


def export(network: MLPRegressor, scale: np.ndarray) -> autoencoder.Network:
    """A trained network as detectors fly it; its inputs are deltas / `scale`.

    Weights are rounded, so that training on another machine gives the same file (2e-14 lay between two of them).
    """
    sizes = [network.coefs_[0].shape[0], *(len(intercepts) for intercepts in network.intercepts_)]
    layers = zip(network.coefs_, network.intercepts_, strict=True)
    weights = [part for coefficients, intercepts in layers for part in (coefficients.ravel(), intercepts)]
    rounded = np.array([float(f"{weight:.{WEIGHT_DIGITS - 1}e}") for weight in np.concatenate(weights)])
    return autoencoder.Network(scale, np.array(sizes, np.int64), rounded, np.zeros((3, max(sizes))))


@kernel_jit
def all_residuals(vectors: np.ndarray, network: autoencoder.Network) -> np.ndarray:
    """Residuals of many vectors.

    Args:
        vectors: Shape (m, n), int16.
        network: The network.

    Returns:
        Shape (m, n), float64.
    """
    errors = np.zeros(vectors.shape)
    for row in range(len(vectors)):
        autoencoder.residuals(vectors[row], network, errors[row])
    return errors
