"""Training samples: detector features of recorded flights, computed by the functions used in flight."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mavfi.detectors import features
from mavfi.detectors.preprocess import Preprocessor
from mavfi.detectors.recorder import WATCHED, Recording
from mavfi.errors import BadInputError


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
    vectors, regimes = np.zeros((count, len(preprocessor.fields)), np.int16), np.zeros(count, np.int64)
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
    parts = [_without_odometry(recording, preprocessor) for recording in recordings]
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


def _without_odometry(recording: Recording, preprocessor: Preprocessor) -> Sample:
    lookup = np.array([*(preprocessor.slots.get(name, features.ODOMETRY) for name in WATCHED), features.ODOMETRY])
    found = sample_of(features.Events(lookup[recording.kinds], recording.ends, recording.content), preprocessor)
    published = found.slots != features.ODOMETRY
    return Sample(*(getattr(found, name)[published] for name in Sample.__annotations__))


def regime_limits(peaks: np.ndarray, counts: np.ndarray, margin: float, smallest: int) -> list[list[float]]:
    """Limits of each field and regime.

    Args:
        peaks: Largest distance in training. Shape (n, regimes).
        counts: Number of samples. Shape (n, regimes).
        margin: Limit / largest distance.
        smallest: A regime with fewer samples takes the largest limit among the regimes of its field.
    """
    limit = margin * peaks
    found: list[list[float]] = np.where(counts < smallest, limit.max(axis=1, keepdims=True), limit).tolist()
    return found
