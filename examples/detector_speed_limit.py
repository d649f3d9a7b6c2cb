"""A detector of one's own: an alarm when a command is faster than the vehicle can fly.

    mavfi fly --environment sparse --seed 7 --detector examples.detector_speed_limit:SpeedLimit

run from the folder that holds `examples`, or `detector_speed_limit:SpeedLimit` from within it.
"""

import math

from mavfi.detectors import Alarm, Detector
from mavfi.states import State, floats


class SpeedLimit(Detector):
    """Recomputes the control stage when a velocity command is not finite or above 5 m/s; it remembers nothing."""

    limit = 5.0

    def check(self, state: State, time_us: int) -> Alarm | None:
        """Called with every published state before a consumer sees it."""
        if state.spec.name != "control.command":
            return None
        speed = math.hypot(*floats(state.header, 3))
        if speed <= self.limit:  # false for NaN, too
            return None
        score = speed / self.limit if math.isfinite(speed) else 1e9
        return Alarm("speed_limit", stage="control", score=score)
