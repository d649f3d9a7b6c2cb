"""The state estimator as a kernel: its memory, what it refuses, how it restarts."""

import numpy as np
import pytest

from mavfi.pipeline.estimation import PATIENCE, StateEstimator
from mavfi.states import floats, new_state
from tests.core.reference.kernels.estimation import AIRSIM
from tests.core.unit.pipeline.parts import same

HOVER = (0.0, 0.0, 9.80665, 0.0, 0.0, 0.0)
STEP_US = 4_000


def sample(values=HOVER):
    state = new_state("sensor.imu")
    floats(state.header, 6)[:] = values
    return state


def fix(x=1.0, y=2.0, z=3.0, heading=0.5):
    state = new_state("sensor.position")
    floats(state.header, 4)[:] = (x, y, z, heading)
    return state


class Flight:
    """Feeds an estimator at its rates."""

    def __init__(self):
        self.kernel, self.time_us = StateEstimator(AIRSIM), 0

    def step(self, position=None, imu=None):
        if position is not None:
            assert not self.kernel.receive(position, self.time_us)
        assert self.kernel.receive(sample() if imu is None else imu, self.time_us)
        states = self.kernel.step(self.time_us)
        self.time_us += STEP_US
        return states

    def hover(self, steps, **where):
        for number in range(steps):
            (state,) = self.step(fix(**where) if number % 25 == 0 else None)
        return floats(state.header, 19)


def test_it_says_nothing_before_the_first_fix():
    flight = Flight()
    assert flight.step() == [] and flight.step() == []
    assert flight.step(fix(x=np.nan)) == []
    (state,) = flight.step(fix())
    values = floats(state.header, 19)
    np.testing.assert_allclose(values[:3], (1.0, 2.0, 3.0))
    np.testing.assert_allclose(values[6:10], (np.cos(0.25), 0.0, 0.0, np.sin(0.25)))
    assert not values[3:6].any() and not values[13:].any()


@pytest.mark.parametrize("index", range(6))
@pytest.mark.parametrize("value", [np.nan, np.inf, 1e300, -500.0])
def test_a_sample_that_cannot_be_is_replaced_by_the_last_one(index, value):
    struck, calm = Flight(), Flight()
    for flight in (struck, calm):
        flight.hover(50)
    wrong = np.array(HOVER)
    wrong[index] = value
    struck.step(imu=sample(wrong))
    calm.step()
    assert same(struck.step(), calm.step())


def test_one_wrong_fix_changes_nothing():
    struck, calm = Flight(), Flight()
    for flight in (struck, calm):
        flight.hover(50)
    struck.step(fix(x=1e5))
    calm.step()
    assert same(struck.step(), calm.step())


def test_a_vehicle_that_is_elsewhere_is_believed_in_the_end():
    flight = Flight()
    flight.hover(50)
    moved = flight.hover(25 * (PATIENCE - 1), x=40.0)
    assert moved[0] < 2.0
    moved = flight.hover(25 * 40, x=40.0)
    assert moved[0] == pytest.approx(40.0, abs=0.05) and np.abs(moved[3:6]).max() < 0.05


def test_a_sound_fix_between_wrong_ones_renews_the_patience():
    flight = Flight()
    flight.hover(50)
    for _ in range(3):
        flight.hover(25 * (PATIENCE - 1), x=40.0)
        assert flight.hover(25)[0] == pytest.approx(1.0, abs=0.1)
