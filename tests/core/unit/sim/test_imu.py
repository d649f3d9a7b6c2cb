"""The inertial measurement unit."""

import math

import numpy as np
import pytest

from mavfi.config import LocalizationConfig
from mavfi.sim.imu import ACCELEROMETER_RANDOM_WALK, GYRO_RANDOM_WALK, Imu, Positioning
from tests.core.unit.sim.flights import fly, simulator


def samples(count=2000, interval_us=20_000, key=3):
    imu = Imu(key)
    return imu, np.array([imu.sample(np.zeros(6), interval_us * (k + 1)) for k in range(count)])


def test_white_noise_has_the_stated_random_walk():
    _, rows = samples()
    np.testing.assert_allclose(rows[:, :3].std(axis=0), ACCELEROMETER_RANDOM_WALK / np.sqrt(0.02), rtol=0.08)
    np.testing.assert_allclose(rows[:, 3:].std(axis=0), GYRO_RANDOM_WALK / np.sqrt(0.02), rtol=0.08)


def test_biases_start_at_zero_and_walk():
    assert not Imu(3).bias.any()
    imu, _ = samples()
    assert imu.bias.all() and np.abs(imu.bias[:3]).max() < 1e-3 and np.abs(imu.bias[3:]).max() < 1e-4


def test_it_feels_the_weight_at_hover():
    flight = simulator()
    flight.advance(20_000)
    np.testing.assert_allclose(flight.imu(), (0.0, 0.0, 9.80665, 0.0, 0.0, 0.0), atol=0.1)


def test_the_gyro_measures_the_turn():
    flight = simulator()
    fly(flight, (0.0, 0.0, 0.0, 1.0), 3.0)
    assert flight.imu()[5] == pytest.approx(1.0, abs=0.01)


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
