"""What a failure does to a signal, as a function of time."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavfi.levels.sensor.failures import Signal
from mavfi.levels.sensor.fault import BLOCK_US, DELAY_US, DRIFT_US, SLOW_US, TYPES, UNITS, SensorFault

STEP_US, BEGIN_US, LASTS_S = 20_000, 1_000_000, 1.0
TIMES = range(0, 3_000_000, STEP_US)
FIRST, LAST = BEGIN_US // STEP_US, (BEGIN_US + 1_000_000) // STEP_US
RAMP = np.stack([np.linspace(1.0, 2.0, len(TIMES)), np.linspace(5.0, 3.0, len(TIMES))], axis=1)


def received(kind, unit="gyro", lasts_s=LASTS_S, values=RAMP, **keys):
    signal = Signal(SensorFault(unit, kind, BEGIN_US, lasts_s, **keys))
    return np.array([signal(time_us, row) for time_us, row in zip(TIMES, values, strict=True)])


@given(st.sampled_from(sorted(UNITS)), st.sampled_from(sorted(TYPES)), st.integers(0, 9), st.floats(0.01, 5.0))
def test_outside_its_time_a_failure_changes_nothing(unit, kind, seed, lasts_s):
    signal = received(kind, unit, lasts_s, seed=seed)
    inside = np.array([BEGIN_US <= time_us < BEGIN_US + 1e6 * lasts_s for time_us in TIMES])
    assert (signal[~inside] == RAMP[~inside]).all()
    assert (kind == "ok") == np.array_equal(signal, RAMP) or kind == "intermittent" or lasts_s <= 1e-6 * STEP_US


@given(st.sampled_from(sorted(UNITS)), st.sampled_from(sorted(TYPES)), st.integers(0, 9))
def test_all_readers_of_an_instant_receive_the_same(unit, kind, seed):
    signal = Signal(SensorFault(unit, kind, BEGIN_US, seed=seed))
    for time_us, row in zip(TIMES, RAMP, strict=True):
        assert signal(time_us, row).tobytes() == signal(time_us, row).tobytes()


def test_stuck_keeps_the_value_at_the_start():
    assert (received("stuck")[FIRST:LAST] == RAMP[FIRST]).all()


@pytest.mark.parametrize(("unit", "value"), [("motor", 0.0), ("depth_camera", np.nan)])
def test_off_is_no_thrust_and_no_measurement(unit, value):
    assert np.array_equal(received("off", unit)[FIRST:LAST], np.full((LAST - FIRST, 2), value), equal_nan=True)
    assert np.array_equal(received("off"), received("stuck")), "readers keep the last value"


def test_delay_shifts():
    shift = DELAY_US // STEP_US
    assert np.array_equal(received("delayed")[FIRST:LAST], RAMP[FIRST - shift : LAST - shift])


def test_drift_grows_in_proportion_to_time_and_wrong_is_constant():
    since_s = np.array([time_us - BEGIN_US for time_us in TIMES[FIRST:LAST]]) / DRIFT_US
    for unit in ("gyro", "accelerometer", "compass"):
        error = (received("drift", unit) - RAMP)[FIRST:LAST]
        assert error == pytest.approx(np.outer(since_s * UNITS[unit].error, [1, 1]))
        assert (received("wrong", unit) - RAMP)[FIRST:LAST] == pytest.approx(UNITS[unit].error)
    assert (received("wrong", "position") - RAMP)[FIRST] == pytest.approx([10.0, 0.0]), "along x"
    assert received("wrong", "motor")[FIRST:LAST] == pytest.approx(0.6 * RAMP[FIRST:LAST])


def test_a_drift_ends_at_no_thrust():
    signal = Signal(SensorFault("motor", "drift"))
    assert signal(30 * DRIFT_US, np.ones(1))[0] == 0.0


def test_slow_is_an_update_per_period():
    signal, every = received("slow"), SLOW_US // STEP_US
    for start in range(FIRST, LAST, every):
        assert (signal[start : start + every] == RAMP[start]).all()


def test_intermittent_loses_whole_blocks_of_which_about_half():
    ones = np.ones((len(TIMES), 1))
    signal = received("intermittent", "motor", 1e9, ones)[FIRST:, 0]
    blocks = signal[: len(signal) // 5 * 5].reshape(-1, BLOCK_US // STEP_US)
    assert set(blocks.sum(axis=1)) == {0.0, 5.0} and 4 <= (blocks[:, 0] == 0.0).sum() <= 16
    assert not np.array_equal(signal, received("intermittent", "motor", 1e9, ones, seed=1)[FIRST:, 0])


def test_garbage_is_within_its_range_and_a_function_of_the_seed():
    for unit, low in (("gyro", -3.0), ("motor", 0.0)):
        signal = received("garbage", unit)[FIRST:LAST]
        assert low <= signal.min() < signal.max() <= UNITS[unit].spread
        assert np.array_equal(signal, received("garbage", unit)[FIRST:LAST])
        assert not np.array_equal(signal, received("garbage", unit, seed=1)[FIRST:LAST])
