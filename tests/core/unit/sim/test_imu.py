"""The inertial measurement unit."""

import numpy as np
import pytest

from mavfi.sim.imu import ACCELEROMETER_RANDOM_WALK, GYRO_RANDOM_WALK, Imu
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


def test_another_key_gives_other_noise():
    assert (samples(3)[1] == samples(3)[1]).all() and (samples(3, key=4)[1] != samples(3)[1]).all()


def test_it_feels_the_weight_at_hover():
    flight = simulator()
    flight.advance(20_000)
    np.testing.assert_allclose(flight.imu(), (0.0, 0.0, 9.80665, 0.0, 0.0, 0.0), atol=0.1)


def test_the_gyro_measures_the_turn():
    flight = simulator()
    fly(flight, (0.0, 0.0, 0.0, 1.0), 3.0)
    assert flight.imu()[5] == pytest.approx(1.0, abs=0.01)
