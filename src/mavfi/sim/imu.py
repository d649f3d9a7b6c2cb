"""Inertial measurement unit with AirSim's noise figures.

Source: AirSim, ImuSimpleParams (MIT licence), from the data sheet of the MPU-6000: white noise from its random walk,
and a random-walk bias.  There is no scale or alignment error.
"""

import math

import numpy as np

from mavfi.config import LocalizationConfig
from mavfi.numerics.random import normals
from mavfi.numerics.rotations import wrap_angle, yaw_of

GYRO_RANDOM_WALK = 8.727e-5
"""rad / sqrt(s) (0.30 deg / sqrt(h))."""
GYRO_BIAS_STABILITY, GYRO_BIAS_TIME = 2.230e-5, 500.0
"""rad/s (4.6 deg/h), and the averaging time for which it is specified (s)."""
ACCELEROMETER_RANDOM_WALK = 2.354e-3
"""m/s^2 sqrt(s) (0.24 mg / sqrt(Hz))."""
ACCELEROMETER_BIAS_STABILITY, ACCELEROMETER_BIAS_TIME = 3.53e-4, 800.0
"""m/s^2 (36 ug), and the averaging time for which it is specified (s)."""
ACCELEROMETER_BIAS_WALK = ACCELEROMETER_BIAS_STABILITY / math.sqrt(ACCELEROMETER_BIAS_TIME)
GYRO_BIAS_WALK = GYRO_BIAS_STABILITY / math.sqrt(GYRO_BIAS_TIME)
"""Standard deviations of the biases after one second (m/s^2 and rad/s, / sqrt(s))."""

_SHORTEST_INTERVAL_US = 1_000
"""Interval assumed for two samples of one instant: white noise would be infinite at an interval of 0."""
_WHITE = np.repeat([ACCELEROMETER_RANDOM_WALK, GYRO_RANDOM_WALK], 3)
_WALK = np.repeat([ACCELEROMETER_BIAS_WALK, GYRO_BIAS_WALK], 3)


class Imu:
    """The inertial measurement unit of one flight; biases start at zero.

    Attributes:
        bias: Bias of accelerometer (m/s^2) and gyro (rad/s). Shape (6,).
        time_us: Time of the last sample (us).
    """

    def __init__(self, noise_key: int, scale: float = 1.0) -> None:
        """Start at time zero.

        Args:
            noise_key: Key of the noise.
            scale: Noise / AirSim's figures.
        """
        self._scale = scale
        self.bias = np.zeros(6)
        self.time_us = 0
        self._noise_key = noise_key

    def sample(self, truth: np.ndarray, time_us: int) -> np.ndarray:
        """Take a sample.

        Args:
            truth: Specific force (m/s^2) and rates (rad/s), body frame. Shape (6,).
            time_us: Time (us), not before the last sample.

        Returns:
            The truth with bias and noise. Shape (6,).
        """
        interval = max(time_us - self.time_us, _SHORTEST_INTERVAL_US) * 1e-6
        white, walk = normals(self._noise_key, time_us, 12).reshape(2, 6)
        self.bias = self.bias + self._scale * _WALK * math.sqrt(interval) * walk
        self.time_us = time_us
        sample: np.ndarray = truth + self.bias + self._scale * _WHITE / math.sqrt(interval) * white
        return sample


# ---- position fixes and compass --------------------------------------------------------------------------------------


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
        truth = np.array([*odometry[:3], yaw_of(odometry[6:10])])
        measured: np.ndarray = truth + self._deviation * normals(self._noise_key, time_us, 4)
        measured[3] = wrap_angle(measured[3])
        return measured
