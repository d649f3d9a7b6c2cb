"""What flight tasks command, and that no C library decides its bits."""

import math

import pytest

from mavfi.extras.airsim.piloted import Yaw, fly_velocity, from_body
from mavfi.numerics import elementary


class Vehicle:
    """A vehicle with a heading (rad, clockwise from north); keeps what it is sent."""

    now_us = 0

    def __init__(self, yaw):
        self.yaw = yaw
        self.sent = []

    def send(self, velocity, yaw_rate, seconds):
        self.sent.append((velocity, yaw_rate))


@pytest.fixture(autouse=True)
def no_libm(monkeypatch):
    """Functions of the C library fail; its bits differ between processors."""

    def refused(*_):
        raise AssertionError("a function of the C library")

    elementary.cos(0.0)  # the compiler reads the module `math` when it loads its first function
    for name in ("sin", "cos", "tan", "asin", "acos", "atan", "atan2", "exp", "log", "pow"):
        monkeypatch.setattr(math, name, refused)


def test_a_velocity_of_the_body_is_turned_by_the_heading():
    c, s = elementary.cos(0.3), elementary.sin(0.3)
    assert from_body(Vehicle(0.3), 2.0, 1.0) == (2.0 * c - s, 2.0 * s + c)


def test_the_nose_turns_towards_the_velocity_by_the_shorter_way_and_no_faster_than_it_may():
    east = (0.0, 2.0, 0.0)
    facing = Yaw(is_rate=False, forward=True)
    nearly, away = Vehicle(0.5 * math.pi - 0.1), Vehicle(-0.5 * math.pi + 0.1)
    for vehicle in (nearly, away):
        next(fly_velocity(vehicle, east, 1.0, facing))
    assert nearly.sent == [(east, pytest.approx(0.25))]
    assert away.sent == [(east, 1.5)]
