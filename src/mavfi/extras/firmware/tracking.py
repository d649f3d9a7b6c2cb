"""How well a firmware follows its set-points: what lasts of its errors, for `mavfi.outcomes.ControlEffect`."""

import math
from array import array

import numpy as np

from mavfi.numerics.elementary import acos
from mavfi.outcomes import LASTING_S, ControlErrors
from mavfi.sim.scene import STEP_US

_LASTING = round(1e6 * LASTING_S) // STEP_US
"""Number of set-points in `LASTING_S`."""
_NAMES = "time_s", "tilt", "attitude", "velocity", "yaw_rate"
"""Columns of the errors."""


class Tracking:
    """Errors of a flight at each set-point, every 4 ms."""

    def __init__(self) -> None:
        self._samples = array("d")

    def sample(
        self, time_us: int, setpoint: np.ndarray, odometry: np.ndarray, wanted: np.ndarray, up: np.ndarray
    ) -> None:
        """Note the errors at an instant.

        Args:
            time_us: The instant of the flight (us).
            setpoint: Wanted vx vy vz (m/s), world frame, and yaw rate (rad/s). Shape (4,).
            odometry: True state, as in `sim.controller.InitialConditions`. Shape (13,).
            wanted: Specific force asked of the firmware, world frame (m/s^2). Shape (3,).
            up: The body's z axis, world frame: unit vector. Shape (3,).
        """
        along = (wanted * up).sum() / math.sqrt((wanted * wanted).sum())
        missing = setpoint[:3] - odometry[3:6]
        velocity = math.sqrt((missing * missing).sum())
        yaw_rate = abs(setpoint[3] - odometry[12])
        self._samples.extend((1e-6 * time_us, _angle(up[2]), _angle(along), velocity, yaw_rate))

    def since(self, time_s: float) -> ControlErrors:
        """What lasts of the errors from an instant of the flight on (s); see `lasting`."""
        samples = np.array(self._samples).reshape(-1, len(_NAMES))
        later = samples[samples[:, 0] >= time_s]
        tilt, *errors = np.where(np.isfinite(later), later, np.inf)[:, 1:].T
        return ControlErrors(float(tilt.max(initial=0.0)), *(lasting(error) for error in errors))


def _angle(cosine: float) -> float:
    """Angle of a cosine that rounding may put outside [-1, 1] (rad); of one that is not a number, half a turn."""
    return float(acos(min(1.0, max(-1.0, cosine))))


def lasting(errors: np.ndarray) -> float:
    """The largest value that an error, sampled every 4 ms, reaches for `LASTING_S` without a break.

    Of a shorter series, the value that it never falls below; of an empty one, 0.  Shape (n,).
    """
    if not len(errors):
        return 0.0
    windows = np.lib.stride_tricks.sliding_window_view(errors, min(_LASTING, len(errors)))
    return float(windows.min(axis=1).max())
