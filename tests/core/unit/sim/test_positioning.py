"""Position fixes and the compass."""

import math

import numpy as np
import pytest

from mavfi.config import LocalizationConfig
from mavfi.sim.imu import Positioning
from tests.core.unit.sim.flights import simulator

TRUTH = np.array([1.0, 2.0, 3.0, 0.0, 0.0, 0.0, math.cos(1.57), 0.0, 0.0, math.sin(1.57), 0.0, 0.0, 0.0])
"""A heading of 3.14 rad: noise carries it over the seam."""


def fixes(count=4000, key=5, **figures):
    receiver = Positioning(LocalizationConfig(kind="estimator", **figures), key)
    return np.array([receiver.fix(TRUTH, 100_000 * k) for k in range(count)])


def test_noise_is_white_with_the_stated_deviations():
    rows = fixes(position_noise=0.05, heading_noise=0.025)
    error = rows - (1.0, 2.0, 3.0, 3.14)
    error[:, 3] = np.angle(np.exp(1j * error[:, 3]))
    np.testing.assert_allclose(error.std(axis=0), (0.05, 0.05, 0.05, 0.025), rtol=0.05)
    np.testing.assert_allclose(error.mean(axis=0), 0.0, atol=0.004)
    assert np.abs(np.corrcoef(error[1:, 0], error[:-1, 0])[0, 1]) < 0.06
    assert np.abs(rows[:, 3]).max() <= math.pi and rows[:, 3].min() < -3.0


def test_it_is_a_function_of_key_and_time():
    receiver = Positioning(LocalizationConfig(kind="estimator"), 5)
    late, early = receiver.fix(TRUTH, 900_000), receiver.fix(TRUTH, 100_000)
    np.testing.assert_array_equal(fixes(10)[[9, 1]], [late, early])
    assert (fixes(10, key=6) != fixes(10)).all()


def test_without_noise_it_is_the_truth():
    np.testing.assert_allclose(fixes(3, position_noise=0.0, heading_noise=0.0)[2], (1.0, 2.0, 3.0, 3.14))
    flight = simulator()
    flight.advance(20_000)
    assert flight.position_fix()[:3] == pytest.approx(flight.odometry[:3], abs=0.3)
    assert (flight.position_fix() == flight.position_fix()).all()
