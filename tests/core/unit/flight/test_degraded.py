"""Set-points of the degraded mode: on a simulated point mass that follows them."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavfi.flight.decide import SHARE, VALID_S, HoldMemory, HoldPosition
from mavfi.states import new_state

V_MAX = 3.0
reals = st.floats(-1e3, 1e3)
points = st.tuples(reals, reals, reals)


@given(points, points, st.floats(0.1, 10.0))
def test_a_command_points_to_the_target_and_is_limited(position, target, v_max):
    row = HoldPosition(v_max).command(HoldMemory(list(position), list(target)), new_state("control.command")).header[0]
    velocity, way = np.array([row["vx"], row["vy"], row["vz"]]), np.subtract(target, position)
    assert np.linalg.norm(velocity) == pytest.approx(min(np.linalg.norm(way), SHARE * v_max))
    assert np.allclose(np.cross(velocity, way), 0.0, atol=1e-6 * (1.0 + np.linalg.norm(way)))
    assert velocity @ way >= 0.0


def odometry(position):
    state = new_state("sensor.odometry")
    for name, value in zip("xyz", position, strict=True):
        state.header[name] = value
    return state


def test_the_vehicle_returns_to_where_the_mode_began():
    hold, memory = HoldPosition(V_MAX), HoldMemory()
    hold.note(memory, odometry((1.0, 2.0, 3.0)))
    hold.begin(memory)
    position = np.array([5.0, -1.0, 3.0])
    for _ in range(500):
        hold.note(memory, odometry(position))
        row = hold.command(memory, new_state("control.command")).header[0]
        assert row["duration"] == VALID_S and row["yaw_rate"] == 0.0
        position = position + 0.02 * np.array([row["vx"], row["vy"], row["vz"]])
    assert np.allclose(position, (1.0, 2.0, 3.0), atol=0.01)


def test_without_a_finite_position_it_hovers():
    hold, memory = HoldPosition(V_MAX), HoldMemory()
    hold.note(memory, odometry((math.nan, 0.0, 0.0)))
    hold.begin(memory)
    assert hold.command(memory, new_state("control.command")) is None
