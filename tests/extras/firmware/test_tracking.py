"""Errors of a flight controller that last, on samples made by hand."""

import math

import numpy as np
import pytest

from mavfi.extras.firmware.tracking import Tracking, lasting

UP = np.array([0.0, 0.0, 1.0])
HOVER = np.array([0.0, 0.0, 9.8])


def leaning(angle):
    """z axis of a body that pitches forward (rad)."""
    return np.array([math.sin(angle), 0.0, math.cos(angle)])


def moving(velocity=(0.0, 0.0, 0.0), yaw_rate=0.0):
    odometry = np.zeros(13)
    odometry[3:6], odometry[6], odometry[12] = velocity, 1.0, yaw_rate
    return odometry


def flown(count, *, setpoint=(0.0, 0.0, 0.0, 0.0), odometry=None, wanted=HOVER, up=UP, tracking=None, first=0):
    """Samples every 4 ms that are all equal."""
    tracking_errors = Tracking() if tracking is None else tracking
    state = moving() if odometry is None else odometry
    for number in range(first, first + count):
        tracking_errors.sample(4000 * number, np.array(setpoint), state, wanted, up)
    return tracking_errors


def test_errors_are_between_what_is_commanded_and_flown():
    state = moving((1.0, 2.0, 0.0), -0.25)
    tracking = flown(200, setpoint=(3.0, 0.0, 1.0, 0.5), odometry=state, wanted=9.0 * leaning(0.3), up=leaning(-0.1))
    tracking_errors = tracking.since(0.0)
    assert tracking_errors.tilt == pytest.approx(0.1)
    assert tracking_errors.attitude == pytest.approx(0.4)
    assert tracking_errors.velocity == pytest.approx(3.0)
    assert tracking_errors.yaw_rate == pytest.approx(0.75)


def test_a_step_of_the_command_is_no_lasting_error():
    tracking = flown(250)
    flown(124, setpoint=(3.0, 0.0, 0.0, 0.0), wanted=9.0 * leaning(0.5), tracking=tracking, first=250)
    flown(250, tracking=tracking, first=374)
    assert tracking.since(0.0).attitude == tracking.since(0.0).velocity == 0.0
    flown(125, setpoint=(3.0, 0.0, 0.0, 0.0), wanted=9.0 * leaning(0.5), tracking=tracking, first=624)
    assert tracking.since(0.0).attitude == pytest.approx(0.5)
    assert tracking.since(0.0).velocity == 3.0


def test_only_what_follows_the_fault_counts():
    tracking = flown(250, odometry=moving((2.0, 0.0, 0.0)))
    flown(250, odometry=moving((0.5, 0.0, 0.0)), tracking=tracking, first=250)
    assert tracking.since(0.0).velocity == 2.0
    assert tracking.since(0.996).velocity == 0.5  # of one sample and half a second: the longer one
    assert tracking.since(1.0).velocity == 0.5


def test_a_state_that_is_not_finite_is_as_far_off_as_can_be():
    assert flown(200, odometry=moving((math.nan, 0.0, 0.0))).since(0.0).velocity == math.inf
    assert flown(200, up=np.full(3, math.nan)).since(0.0).tilt == math.pi


@pytest.mark.parametrize("count", [1, 124, 125, 126, 1000])
def test_what_lasts_is_found_as_by_looking_at_every_window(count):
    errors = np.random.default_rng(count).uniform(0.0, 1.0, count)
    errors[count // 3 : count // 3 + 125] += 2.0
    width = min(125, count)
    assert lasting(errors) == max(min(errors[first : first + width]) for first in range(count - width + 1))
