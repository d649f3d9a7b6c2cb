"""Flight tasks of PX4's modes: what they command, and that no C library decides its bits."""

import math

import pytest

from mavfi.extras.mavlink.flying import Setpoint, offboard, orbit
from mavfi.flight.piloted import HOLD_S, YAW_RATE
from mavfi.numerics import elementary


class Vehicle:
    """A vehicle at a place; keeps what it is sent."""

    now_us, landed = 0, False

    def __init__(self, position=(0.0, 0.0, -3.0), yaw=0.0):
        self.position, self.yaw, self.sent, self.sim = position, yaw, [], self

    def send(self, velocity, yaw_rate, seconds):
        self.sent.append((velocity, yaw_rate, seconds))


@pytest.fixture(autouse=True)
def no_libm(monkeypatch):
    """Functions of the C library fail; its bits differ between processors."""

    def refused(*_):
        raise AssertionError("a function of the C library")

    elementary.cos(0.0)  # the compiler reads the module `math` when it loads its first function
    for name in ("sin", "cos", "tan", "asin", "acos", "atan", "atan2", "exp", "log", "pow"):
        monkeypatch.setattr(math, name, refused)


def test_a_velocity_of_the_body_is_turned_by_the_heading():
    vehicle = Vehicle(yaw=0.3)
    next(offboard(vehicle, lambda: (Setpoint(velocity=(2.0, 1.0, 0.5), body=True), 0)))
    ((velocity, _, seconds),) = vehicle.sent
    c, s = elementary.cos(0.3), elementary.sin(0.3)
    assert velocity == (2.0 * c - s, 2.0 * s + c, 0.5) and seconds == HOLD_S


def test_a_circle_is_flown_along_its_tangent_with_the_nose_to_its_centre():
    vehicle = Vehicle((10.0, 0.0, -3.0), yaw=math.pi)
    next(orbit(vehicle, (0.0, 0.0, -3.0), 10.0, 2.0, clockwise=True))
    ((velocity, yaw_rate, _),) = vehicle.sent
    assert velocity == pytest.approx((0.0, 2.0, 0.0)) and yaw_rate == pytest.approx(0.2)
    vehicle.yaw = 0.0
    next(orbit(vehicle, (0.0, 0.0, -3.0), 10.0, 2.0, clockwise=False))
    assert abs(vehicle.sent[-1][1]) == YAW_RATE, "turned away, it turns back as fast as it may"
