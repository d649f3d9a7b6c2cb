"""A detector: an alarm when a velocity command is not a number, too fast, or a jump from the one before."""

import math

import numpy as np

from mavfi.detectors import Alarm, Detector
from mavfi.states import State, floats

LARGEST_SPEED = 5.0
"""Of a command (m/s)."""
LARGEST_JUMP = 4.0
"""Largest change of a component of the velocity from one command to the next (m/s)."""


class MyDetector(Detector):
    """Looks at each velocity command before the vehicle gets it."""

    states = frozenset({"control.command"})
    """The states that it is shown; `mavfi states` lists all of them with their fields."""

    def __init__(self) -> None:
        self._last = np.zeros(3)

    def start(self) -> None:
        """Called at the start of each flight: forget the flight before."""
        self._last[:] = 0.0

    def check(self, state: State, time_us: int) -> Alarm | None:
        """Called with each publication before it is used; an alarm makes its stage compute the value again."""
        if state.spec.name != "control.command":  # way-points are shown to every detector
            return None
        velocity = floats(state.header, 3)  # the first three fields: vx, vy, vz
        speed = math.hypot(*velocity)
        jump = float(np.abs(velocity - self._last).max())
        # The score says how far the value is beyond the limit; more than 1 is an alarm.
        score = max(speed / LARGEST_SPEED, jump / LARGEST_JUMP)
        if score <= 1.0:  # false for NaN, too
            return None
        if not math.isfinite(score):
            score = 1e9
        return Alarm("my_detector", stage="control", score=score)

    def accept(self, state: State, time_us: int) -> None:
        """Called with the publication that is used in the end."""
        if state.spec.name == "control.command":
            self._last[:] = floats(state.header, 3)
