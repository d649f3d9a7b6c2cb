"""Wind: the form of its gusts, and what it does to a vehicle, against closed forms."""

import math

import numpy as np
import pytest

from mavfi.config import VehicleConfig, WindConfig, shipped
from mavfi.sim.engine import GRAVITY
from mavfi.sim.simulator import Simulator
from mavfi.sim.wind import Weather, Wind, wind_at
from tests.core.unit.sim.flights import fly, open_world, scenario

VEHICLE = shipped("vehicles", VehicleConfig, "airsim_quad")


def weather(seed=1, **figures):
    return Weather(WindConfig(**figures), np.random.SeedSequence(seed))


def air(wind, time):
    velocity = np.full(3, np.nan)
    wind_at(wind, time, velocity)
    return velocity


def in_wind(**figures):
    return Simulator(open_world(), scenario().model_copy(update={"wind": WindConfig(**figures)}))


def test_a_gust_is_one_minus_cosine():
    wind = Wind(np.array([1.0, 0.0, 0.0]), np.array([[2.0, 4.0, 0.0, 3.0, -0.5], [8.0, 1.0, 5.0, 0.0, 0.0]]))
    peak = np.array([0.0, 3.0, -0.5])
    for time in (1.9, 7.0, math.nan):
        np.testing.assert_array_equal(air(wind, time), (1.0, 0.0, 0.0))
    for time in np.linspace(2.0, 6.0, 17):
        share = 0.5 * (1.0 - math.cos(math.pi * (time - 2.0) / 2.0))
        np.testing.assert_allclose(air(wind, time), (1.0, 0.0, 0.0) + share * peak, atol=1e-12)
    np.testing.assert_allclose(air(wind, 8.5), (6.0, 0.0, 0.0), atol=1e-12)


def test_gusts_have_the_stated_amplitude_calm_and_length():
    gusts = weather(gust=3.0, interval=5.0, length=4.0).until(20_000.0).gusts
    onsets, durations, peaks = gusts[:, 0], gusts[:, 1], gusts[:, 2:]
    calm = np.diff(onsets) - durations[:-1]
    assert (calm >= 0.0).all() and calm.mean() == pytest.approx(5.0, rel=0.1)
    assert calm.std() == pytest.approx(5.0, rel=0.1)
    assert durations.min() >= 2.0 and durations.max() <= 6.0 and durations.mean() == pytest.approx(4.0, rel=0.05)
    np.testing.assert_allclose(np.linalg.norm(peaks, axis=1), 3.0)
    assert 0.55 < np.abs(peaks[:, 2]).max() <= 0.6 and abs(peaks.mean(axis=0)).max() < 0.2


def test_wind_is_a_function_of_seed_and_time_however_it_is_asked_for():
    at_once, bit_by_bit = weather(gust=3.0), weather(gust=3.0)
    last = at_once.until(2_000.0)
    for time in np.linspace(0.0, 2_000.0, 200):
        np.testing.assert_array_equal(air(bit_by_bit.until(time), time), air(last, time))
    assert (weather(seed=2, gust=3.0).until(10.0).gusts != weather(seed=1, gust=3.0).until(10.0).gusts).any()
    assert len(weather().until(1e6).gusts) == 0 and not air(weather().until(5.0), 5.0).any()


@pytest.mark.parametrize("mean", [8.0, 15.0])
def test_hover_in_a_steady_wind_drifts_and_leans_until_the_forces_balance(mean):
    """There is no integrator in x and y: m k v = c (w - v)^2, and the lean is the drag over the weight."""
    flight = in_wind(mean=(mean, 0.0, 0.0))
    rows = fly(flight, (0.0, 0.0, 0.0, 0.0), 12.0)
    drift = rows[-1, 3]
    drag = VEHICLE.drag[0] * (mean - drift) ** 2
    assert drift == pytest.approx(drag / (VEHICLE.mass * VEHICLE.velocity_gain), rel=0.03)
    w, x, y, z = rows[-1, 6:10]
    lean = -math.atan2(2.0 * (x * z + w * y), 1.0 - 2.0 * (x * x + y * y))
    assert lean == pytest.approx(math.atan2(drag, VEHICLE.mass * GRAVITY), rel=0.03)
    assert rows[-1, 5] == pytest.approx(0.0, abs=0.03) and rows[-1, 4] == pytest.approx(0.0, abs=1e-6)
    np.testing.assert_allclose(np.linalg.norm(flight.imu()[:3]), GRAVITY, atol=0.15)
