"""How detectors are trained: what is recorded of error-free flights, and what becomes of it.

The class of a trained detector names its `Training`; those of monitored fields share `MONITORED_FIELDS`.  Features of
recorded flights are computed by the functions used in flight.
"""

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np

from mavfi.detectors import features
from mavfi.detectors.detector import Detector
from mavfi.detectors.model import Model
from mavfi.detectors.preprocess import PREDICTIONS, PROFILES, Preprocessor
from mavfi.errors import BadInputError
from mavfi.states import MONITORED_SETS, ODOMETRY, STATES, State, StateSpec

WATCHED = tuple(dict.fromkeys(state for fields in MONITORED_SETS.values() for state, _ in fields))
"""States with a field in a monitored set."""
_WAYPOINT = "planning.waypoint"
"""The state that names the trajectory in force."""
_ODOMETRY_SIZE = STATES[ODOMETRY["truth"]].header_dtype.itemsize
"""Bytes of a recorded odometry: an estimate begins with the same fields."""
_VELOCITY = ("vx", "vy", "vz")
"""Fields of a way-point's velocity."""


# ---- recordings -----------------------------------------------------------------------------------------------------
class Recording(NamedTuple):
    """Every publication of a watched state in one flight, and the vehicle's odometry at each new trajectory.

    Attributes:
        kinds: Index in WATCHED, or features.ODOMETRY. Shape (m,), int8.
        times_us: Publication times (us). Shape (m,), int64.
        content: The published headers, concatenated. Shape (total,), uint8.
    """

    kinds: np.ndarray
    times_us: np.ndarray
    content: np.ndarray

    @property
    def ends(self) -> np.ndarray:
        """End of each header in `content`. Shape (m,), int64."""
        sizes = [*(STATES[name].header_dtype.itemsize for name in WATCHED), _ODOMETRY_SIZE]
        return np.cumsum(np.array(sizes, np.int64)[self.kinds])

    def headers(self, name: str) -> tuple[np.ndarray, np.ndarray]:
        """Publications of one watched state: times (us), shape (k,), and headers, shape (k,), structured."""
        spec = STATES[name]
        chosen = np.flatnonzero(self.kinds == WATCHED.index(name))
        size = spec.header_dtype.itemsize
        rows = self.ends[chosen, None] - size + np.arange(size)
        return self.times_us[chosen], self.content[rows].reshape(-1).view(spec.header_dtype)


class Recorder(Detector):
    """A detector that never raises an alarm and records publications."""

    def __init__(self) -> None:
        self.start()

    def start(self) -> None:
        """Reset the memory at the start of a flight."""
        self._kinds: list[int] = []
        self._times: list[int] = []
        self._content: list[bytes] = []
        self._odometry = b""
        self._trajectory: int | None = None

    def accept(self, state: State, time_us: int) -> None:
        """Record a published value."""
        name = state.spec.name
        if name in ODOMETRY.values():
            self._odometry = state.header.tobytes()[:_ODOMETRY_SIZE]
        elif name in _KINDS:
            if name == _WAYPOINT:  # the odometry at the first way-point of each trajectory
                trajectory = int(state.header["trajectory_seq"][0])
                if trajectory != self._trajectory and self._odometry:
                    self._append(features.ODOMETRY, time_us, self._odometry)
                self._trajectory = trajectory
            self._append(_KINDS[name], time_us, state.header.tobytes())

    def recording(self) -> Recording:
        """All publications since `start`."""
        content = np.frombuffer(b"".join(self._content), np.uint8)
        return Recording(np.array(self._kinds, np.int8), np.array(self._times, np.int64), content)

    def _append(self, kind: int, time_us: int, content: bytes) -> None:
        """Append a header to the recording."""
        self._kinds.append(kind)
        self._times.append(time_us)
        self._content.append(content)


_KINDS = {name: kind for kind, name in enumerate(WATCHED)}
"""Kind of the publications of each watched state, see `Recording`."""


# ---- samples --------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Sample:
    """Features of all flights.

    Attributes:
        vectors: Latest delta of every field at each publication. Shape (m, n), int16.
        slots: Index of the published state. Shape (m,), int64.
        regimes: Shape (m,), int64.
        first: Whether it is the first publication of its state in a flight, without a delta. Shape (m,), bool.
    """

    vectors: np.ndarray
    slots: np.ndarray
    regimes: np.ndarray
    first: np.ndarray


def sample_of(events: features.Events, preprocessor: Preprocessor) -> Sample:
    """Sample of one flight, including odometry; the preprocessor is reset before and after."""
    count = len(events.slots)
    vectors = np.zeros((count, len(preprocessor.fields)), np.int16)
    regimes = np.zeros(count, np.int64)
    preprocessor.start()
    features.replay(events, preprocessor.watch, vectors, regimes)
    preprocessor.start()
    first = np.zeros(count, bool)
    first[np.unique(events.slots, return_index=True)[1]] = True
    return Sample(vectors, events.slots, regimes, first)


def collect(recordings: Sequence[Recording], preprocessor: Preprocessor) -> Sample:
    """Sample of all flights.

    Raises:
        BadInputError: A watched state was never published, or a published number is not finite.
    """
    # slots of the recorded kinds, the last of which is the odometry; rows of it are left out
    slots = np.array([*(preprocessor.slots.get(name, features.ODOMETRY) for name in WATCHED), features.ODOMETRY])
    parts = []
    for recording in recordings:
        events = features.Events(slots[recording.kinds], recording.ends, recording.content)
        sample = sample_of(events, preprocessor)
        is_watched = sample.slots != features.ODOMETRY
        parts.append(Sample(*(getattr(sample, name)[is_watched] for name in Sample.__annotations__)))
    if not parts:
        raise BadInputError("training: no recordings; fly at least one error-free flight")
    sample = join(parts)
    for name, slot in preprocessor.slots.items():
        if not np.any((sample.slots == slot) & ~sample.first):
            raise BadInputError(f"training: {name} was published less than twice in every recorded flight")
    check_finite(sample)
    return sample


def check_finite(sample: Sample) -> None:
    """Reject recordings with numbers that are not finite."""
    if np.any(sample.regimes < 0):
        raise BadInputError("training: a recorded flight holds numbers that are not finite")


def join(parts: Sequence[Sample]) -> Sample:
    """Concatenate the samples of all flights, in order."""
    return Sample(*(np.concatenate([getattr(part, name) for part in parts]) for name in Sample.__annotations__))


def regime_limits(peaks: np.ndarray, counts: np.ndarray, margin: float, smallest: int) -> list[list[float]]:
    """Limits of each field and regime.

    Args:
        peaks: Largest distance in training. Shape (n, regimes).
        counts: Number of samples. Shape (n, regimes).
        margin: Limit / largest distance.
        smallest: A regime with fewer samples takes the largest limit among the regimes of its field.
    """
    limit = margin * peaks
    limits: list[list[float]] = np.where(counts < smallest, limit.max(axis=1, keepdims=True), limit).tolist()
    return limits


# ---- the kinds of training ------------------------------------------------------------------------------------------
class Training(ABC):
    """How the detectors of a kind are trained.

    Attributes:
        parts: What is recorded of a flight: a named tuple of arrays, by names that no other training uses.
        profiles: Profiles of the models.
        environments: Environments of the flights by default, one of each family that the detectors depend on.
    """

    parts: type[Any]
    profiles: tuple[str, ...]
    environments: tuple[str, ...]

    def __eq__(self, other: object) -> bool:  # in another process it is another object
        return type(self) is type(other) and vars(self) == vars(other)

    def __hash__(self) -> int:
        return hash(type(self))

    @abstractmethod
    def recorder(self, autopilot: str) -> Any:  # noqa: ANN401 - a detector that records
        """A detector whose `recording()` has the `parts` of a flight with this autopilot profile."""

    @abstractmethod
    def is_whole(self, recording: Any) -> bool:  # noqa: ANN401 - `parts`
        """Whether a recording, read from a file, is consistent."""

    @abstractmethod
    def fit(
        self,
        detectors: Mapping[str, type["TrainedDetector"]],
        profile: str,
        recordings: Sequence[Any],
        origin: Mapping[str, Any],
        figures: Mapping[str, Mapping[str, Any]],
    ) -> Iterator[Model]:
        """Models of detectors in a profile.

        Args:
            detectors: The detectors by name.
            profile: One of `profiles`.
            recordings: Error-free flights: 100 or more for stable thresholds.
            origin: Provenance of the models.
            figures: Figures of training by detector, of configs/detectors.

        Raises:
            BadInputError: The recordings lack publications, or hold numbers that are not finite.
        """


class MonitoredFields(Training):
    """Training with a set of monitored fields, in both profiles.

    Args:
        monitored: Name of the set.
    """

    parts = Recording
    profiles = PROFILES
    environments = ("training",)  # randomised worlds; excludes the generators of the evaluation environments

    def __init__(self, monitored: str = "paper-13") -> None:
        self._monitored = monitored

    def recorder(self, autopilot: str) -> Recorder:
        """See `Training`."""
        return Recorder()

    def is_whole(self, recording: Recording) -> bool:
        """See `Training`."""
        kinds, times_us, content = recording
        if [part.dtype for part in recording] != [np.int8, np.int64, np.uint8] or any(p.ndim != 1 for p in recording):
            return False
        if len(kinds) != len(times_us) or ((kinds < features.ODOMETRY) | (kinds >= len(WATCHED))).any():
            return False
        size = 0
        if len(kinds):
            size = int(recording.ends[-1])
        return size == len(content)

    def fit(
        self,
        detectors: Mapping[str, type["TrainedDetector"]],
        profile: str,
        recordings: Sequence[Recording],
        origin: Mapping[str, Any],
        figures: Mapping[str, Mapping[str, Any]],
    ) -> Iterator[Model]:
        """See `Training`."""
        prediction, errors = best_prediction(recordings)
        preprocessor = Preprocessor(self._monitored, profile, prediction)
        sample = collect(recordings, preprocessor)
        if profile != "paper":
            origin = {**origin, "innovation_m": errors}
        for name, detector in detectors.items():
            parameters = detector.fit(sample, preprocessor, figures[name])
            yield Model(detector.model_kind, profile, self._monitored, prediction, parameters, dict(origin))


MONITORED_FIELDS = MonitoredFields()
"""The training that detectors of monitored fields share."""


class TrainedDetector(Detector):
    """Base class of detectors that `mavfi train` fits: constructed with a model of their kind, then their options.

    Attributes:
        model_kind: Kind of the model, part of the name of its file.
        training: How it is trained.
    """

    model_kind: ClassVar[str]
    training: ClassVar[Training] = MONITORED_FIELDS

    @classmethod
    def of_messages(
        cls, recordings: Sequence[Sequence[State]], specs: Mapping[str, StateSpec], figures: Mapping[str, Any]
    ) -> Detector:
        """A detector fitted to normal messages of any program (`mavfi watch`).

        Args:
            recordings: The messages of each recording, in order.
            specs: Their states by name; all fields are float64.
            figures: Figures of training, of configs/detectors.

        Raises:
            BadInputError: It can be fitted to missions only.
        """
        raise BadInputError(f"detector {cls.__name__}: is fitted to missions only; allowed: one with `of_messages`")

    @classmethod
    def fit(cls, sample: Any, features: Any, figures: Mapping[str, Any]) -> dict[str, Any]:  # noqa: ANN401
        """Parameters of a model, from error-free flights.

        Args:
            sample: A `Sample` of the flights.
            features: What computed it: a `Preprocessor` for monitored fields.
            figures: Figures of training, of configs/detectors.
        """
        raise NotImplementedError


def innovations(recording: Recording) -> dict[str, np.ndarray]:
    """By prediction, errors (m) of way-points predicted from the previous one of the same trajectory. Shape (k, 3)."""
    _, headers = recording.headers("planning.waypoint")
    position, velocity = (np.stack([headers[name] for name in names], 1) for names in (("x", "y", "z"), _VELOCITY))
    same = headers["trajectory_seq"][1:] == headers["trajectory_seq"][:-1]
    step = np.diff(position, axis=0)
    mean = (velocity[1:] + velocity[:-1]) / 2.0
    duration = headers["duration"][1:, None]
    return {"interval": (step - velocity[1:] * duration)[same], "trapezoid": (step - mean * duration)[same]}


def best_prediction(recordings: Sequence[Recording]) -> tuple[str, dict[str, dict[str, float]]]:
    """Best-fitting key of `preprocess.PREDICTIONS`; by prediction, the 99 % quantile and the largest error (m)."""
    by_flight = [innovations(recording) for recording in recordings]
    fits = {}
    for name in PREDICTIONS:
        errors = np.abs(np.concatenate([np.zeros(0), *(flight[name].ravel() for flight in by_flight)]))
        if len(errors) == 0:
            raise BadInputError("training: the recordings hold no trajectory of two way-points")
        fits[name] = {"p99": float(np.quantile(errors, 0.99)), "max": float(errors.max())}
    return min(fits, key=lambda name: fits[name]["p99"]), fits
