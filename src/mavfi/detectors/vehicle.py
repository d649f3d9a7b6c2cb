"""The vehicle's odometry as detectors read it: late, since most of its publications are never needed."""

from collections.abc import Callable

import numpy as np

_WAITING = 100
"""Largest number of publications queued before the latest is stored."""


class VehicleQueue:
    """Headers of odometry, of which the latest that is finite will be stored.

    Args:
        store: Stores position and velocity of a header; returns whether they are finite.
    """

    def __init__(self, store: Callable[[np.ndarray], bool]) -> None:
        self.store = store
        self._headers: list[np.ndarray] = []

    def add(self, header: np.ndarray) -> float:
        """Queue a header; returns 0, the score of a publication that is not judged."""
        self._headers.append(header)
        if len(self._headers) == _WAITING:
            self.settle()
        return 0.0

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

    def settled(self, function: Callable[[np.ndarray], float]) -> Callable[[np.ndarray], float]:
        """A function of a header that finds the queue empty."""

        def call(header: np.ndarray) -> float:
            if self._headers:
                self.settle()
            return function(header)

        return call
