"""Frames of PX4 and MAVLink."""

import numpy as np
import pytest

from mavfi.extras.logs.ned import euler, ned_of


def test_half_a_turn_about_x():
    rows = np.zeros((200, 21))
    time = 0.02 * np.arange(200)
    rows[:, 7], rows[:, 10], rows[:, 13] = np.cos(time / 2), np.sin(time / 2), 1.0
    ned = ned_of(rows)
    assert euler(ned.quaternion[50])[2] == pytest.approx(-1.0)
    assert np.array_equal(ned.rates[:, 2], -np.ones(len(ned.rates)))
