"""The vehicle's odometry as detectors read it: late, since most of its publications are never needed."""

from collections import deque
from collections.abc import Callable

import numpy as np

_WAITING = 100
"""Largest number of publications queued; older ones are forgotten."""


class VehicleQueue:
    """Headers of odometry, of which the latest that is finite will be stored.

    Args:
        store: Stores position and velocity of a header; returns whether they are finite.
    """

    def __init__(self, store: Callable[[np.ndarray], bool]) -> None:
        self.store = store
        self._headers: deque[np.ndarray] = deque(maxlen=_WAITING)

    @property
    def add(self) -> Callable[[np.ndarray], None]:
        """Queues a header.  A function of the queue itself: another one in Python would take longer."""
        return self._headers.append

    def settle(self) -> None:
        """Store the latest that is finite."""
        if self._headers:
            for header in reversed(self._headers):
                if self.store(header):
                    break
            self._headers.clear()

    def forget(self) -> None:
        """Forget what is queued."""
        self._headers.clear()

    def settled(self, function: Callable[[np.ndarray], bool]) -> Callable[[np.ndarray], bool]:
        """A function of a header that finds the queue empty."""

        def call(header: np.ndarray) -> bool:
            if self._headers:
                self.settle()
            return function(header)

        return call
