"""Position fixes and a compass, with white noise; they correct the drift of the IMU."""

import numpy as np

from mavfi.config import LocalizationConfig
from mavfi.numerics.random import normals
from mavfi.numerics.rotations import wrap_angle, yaw_of


class Positioning:
    """The receiver of one flight; its noise is a function of seed and time."""

    def __init__(self, config: LocalizationConfig, noise_key: int) -> None:
        """Prepare without a measurement.

        Args:
            config: Standard deviations.
            noise_key: Key of the noise.
        """
        self._deviation = np.array([config.position_noise] * 3 + [config.heading_noise])
        self._noise_key = noise_key

    def fix(self, odometry: np.ndarray, time_us: int) -> np.ndarray:
        """Take a measurement.

        Args:
            odometry: True state, see `Simulator.odometry`. Shape (13,).
            time_us: Time (us).

        Returns:
            Position (m) and heading (rad), world frame, with noise. Shape (4,).
        """
        stream = np.random.Generator(np.random.Philox(key=self._noise_key, counter=[0, 0, 0, time_us]))
        measured: np.ndarray = np.array([*odometry[:3], yaw_of(odometry[6:10])]) + self._deviation * normals(stream, 4)
        measured[3] = wrap_angle(measured[3])
        return measured
