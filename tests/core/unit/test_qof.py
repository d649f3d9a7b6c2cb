"""Quality of flight against values worked out by hand."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavfi.mission import MissionStatus
from mavfi.outcomes import BATTERY_ENERGY, QoF, quality_of, quality_of_flight
from mavfi.record import COLUMNS, FlightLog, FlightRecord, record_of


def log_of(time, position, velocity):
    rows = np.zeros((len(time), len(COLUMNS)))
    rows[:, 0], rows[:, 1:4], rows[:, 4:7] = time, position, velocity
    return FlightLog(rows, MissionStatus.SUCCESS)


def regression(velocity, acceleration):
    """Power by MAVBench's regression as it is published, for km/h and km/h/s (W)."""
    velocity, acceleration = 3.6 * velocity, 3.6 * acceleration
    xy, axy = (np.hypot(v[:, 0], v[:, 1]) for v in (velocity, acceleration))
    z, az = np.abs(velocity[:, 2]), np.abs(acceleration[:, 2])
    return 443.9 - 1.526 * xy + 3.934 * axy + 0.968 * xy * axy + 18.125 * z + 96.613 * az - 1.085 * z * az


@given(st.integers(0, 2**32), st.integers(2, 200), st.floats(0.1, 20.0))
def test_energy_is_the_power_integrated_over_the_flight(seed, count, speed):
    random = np.random.default_rng(seed)
    time = np.cumsum(random.uniform(0.004, 0.1, count))
    velocity = speed * random.uniform(-1, 1, (count, 3))
    position = np.cumsum(velocity * 0.02, axis=0)
    log = log_of(time, position, velocity)
    interval = np.diff(time)
    watts = regression(0.5 * (velocity[1:] + velocity[:-1]), np.diff(velocity, axis=0) / interval[:, None])
    quality = quality_of_flight(log)
    assert quality.energy_j == pytest.approx(float((watts * interval).sum()), rel=1e-9)
    assert quality.flight_time_s == pytest.approx(time[-1] - time[0])
    assert quality.distance_m == pytest.approx(np.linalg.norm(np.diff(position, axis=0), axis=1).sum())
    stored = FlightRecord.from_json(record_of(log).to_json())
    assert quality_of(stored) == quality, "a ledger is enough"


def test_a_hover_of_100_seconds():
    time = np.arange(0.0, 100.01, 0.02)
    quality = quality_of_flight(log_of(time, (1.0, 2.0, 3.0), 0.0))
    assert quality.flight_time_s == pytest.approx(100.0)
    assert quality.energy_j == pytest.approx(44_390.0)
    assert quality.distance_m == 0.0
    assert quality.battery_used == pytest.approx(0.20197, abs=1e-5)


def test_the_battery_of_published_logs():
    """Logs of MAVBench state 89.3278 % after 23455.1 J and 91.2521 % after 19224.5 J."""
    assert 100.0 * (1.0 - 23455.1 / BATTERY_ENERGY) == pytest.approx(89.3278, abs=2e-4)
    assert 100.0 * (1.0 - 19224.5 / BATTERY_ENERGY) == pytest.approx(91.2521, abs=1e-3)


def test_rows_from_the_first_not_finite_one_on_do_not_count():
    time = np.arange(0.0, 10.0, 0.02)
    position = np.zeros((len(time), 3))
    position[300:, 1] = math.nan
    short = log_of(time[:300], position[:300], 0.0)
    assert quality_of_flight(log_of(time, position, 0.0)) == quality_of_flight(short)


@pytest.mark.parametrize("rows", (0, 1))
def test_a_flight_that_never_was_has_no_quality(rows):
    assert quality_of_flight(log_of(np.zeros(rows), 0.0, 0.0)) == QoF(0.0, 0.0, 0.0, 0.0)
