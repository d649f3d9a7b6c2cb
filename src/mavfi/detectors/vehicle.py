"""The vehicle's odometry as detectors read it: late, since most of its publications are never needed."""

from collections import deque
from collections.abc import Callable

import numpy as np

_MOST_WAITING = 100
"""Largest number of publications queued; older ones are forgotten."""


class VehicleQueue:
    """Headers of odometry, of which the latest that is finite will be stored.

    Args:
        store: Stores position and velocity of a header; returns whether they are finite.
    """

    def __init__(self, store: Callable[[np.ndarray], bool]) -> None:
        self._store = store
        self._headers: deque[np.ndarray] = deque(maxlen=_MOST_WAITING)

    def add(self, header: np.ndarray) -> None:
        """Queue a header."""
        self._headers.append(header)

    def settle(self) -> None:
        """Store the latest that is finite."""
        for header in reversed(self._headers):
            if self._store(header):
                break
        self._headers.clear()

    def forget(self) -> None:
        """Forget what is queued."""
        self._headers.clear()
