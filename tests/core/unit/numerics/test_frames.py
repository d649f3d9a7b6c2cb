"""Frames of PX4 and MAVLink."""

import numpy as np
import pytest

from mavfi.numerics.frames import euler, geodetic, local, ned_of


def test_geodetic_and_back():
    ned = np.array([120.0, -45.0, -7.0])
    np.testing.assert_allclose(local(*geodetic(ned)), ned, atol=1e-6)


def test_half_a_turn_about_x():
    rows = np.zeros((200, 21))
    time = 0.02 * np.arange(200)
    rows[:, 7], rows[:, 10], rows[:, 13] = np.cos(time / 2), np.sin(time / 2), 1.0
    ned = ned_of(rows)
    assert euler(ned.quaternion[50])[2] == pytest.approx(-1.0)
    assert np.array_equal(ned.rates[:, 2], -np.ones(len(ned.rates)))
