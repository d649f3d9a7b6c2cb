"""A custom detector: an alarm when a command asks for a jump that the vehicle cannot follow, compiled.

mavfi fly --environment sparse --seed 7 --detector my_detector:Jumps
mavfi fly --environment sparse --seed 7 --detector my_detector:Jumps --fault instruction:Jumps
"""

import numpy as np

from mavfi.detectors import Alarm, Detector
from mavfi.numerics.jit import kernel_jit
from mavfi.states import State, floats

LIMIT = 6.0
"""Largest change between two commands (m/s)."""


@kernel_jit
def change(command: np.ndarray, last: np.ndarray) -> float:
    """Largest change of a component of the velocity (m/s). Shapes (3,)."""
    largest = 0.0
    for axis in range(3):
        step = abs(command[axis] - last[axis])
        if not step <= largest:  # also of NaN
            largest = step
    return largest


class Jumps(Detector):
    """Compares each velocity command with the last one."""

    states = frozenset({"control.command"})
    compiled = (change,)  # faults can be in it, and in what it calls

    def __init__(self) -> None:
        self._last = np.zeros(3)

    def start(self) -> None:
        """A flight begins."""
        self._last[:] = 0.0

    def arrays(self) -> dict[str, np.ndarray]:
        """The memory that faults can be in, by name."""
        return {"last": self._last}

    def check(self, state: State, time_us: int) -> Alarm | None:
        """Called with every command before the vehicle gets it."""
        if state.spec.name != "control.command":  # way-points are shown to every detector
            return None
        jump = change(floats(state.header, 3), self._last)
        if jump <= LIMIT:  # false for NaN
            return None
        return Alarm("jumps", stage="control", score=min(jump / LIMIT, 1e9), hard=True)

    def accept(self, state: State, time_us: int) -> None:
        """Called with the command that the vehicle really gets."""
        if state.spec.name == "control.command":
            self._last[:] = floats(state.header, 3)
