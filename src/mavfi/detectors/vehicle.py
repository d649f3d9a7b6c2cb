"""The vehicle's odometry as detectors read it: late, since most of its publications are never needed."""

from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np

from mavfi.states import bytes_of

_MOST_WAITING = 100
"""Largest number of publications queued; older ones are forgotten."""


class VehicleQueue:
    """Headers of odometry, of which the latest that is finite will be stored.

    Args:
        place: Where position and velocity are stored.

    Attributes:
        store: Compiled: bytes of a header, then `place`; stores position and velocity, and returns whether they are
            finite.
    """

    store: Callable[..., bool]

    def __init__(self, place: Any) -> None:  # noqa: ANN401 - an array, or a tuple of them
        self._place = place
        self._headers: deque[np.ndarray] = deque(maxlen=_MOST_WAITING)

    def __getstate__(self) -> dict[str, Any]:
        """Pickle without machine code, which is valid in one process only."""
        return {name: value for name, value in self.__dict__.items() if name != "store"}

    def add(self, header: np.ndarray) -> None:
        """Queue a header."""
        self._headers.append(header)

    def settle(self) -> None:
        """Store the latest that is finite."""
        headers = self._headers
        while headers:
            if self.store(bytes_of(headers.pop()), self._place):
                headers.clear()

    def forget(self) -> None:
        """Forget what is queued."""
        self._headers.clear()
