"""Set-points of the degraded modes: on a simulated point mass that follows them."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavfi.hosts.loop.degraded import REACHED, SHARE, SPACING, VALID_S, Setpoints, Trail
from mavfi.states import new_state

V_MAX = 3.0
reals = st.floats(-1e3, 1e3)
points = st.tuples(reals, reals, reals)


@given(points, points, st.floats(0.1, 10.0))
def test_a_command_points_to_the_target_and_is_limited(position, target, v_max):
    setpoints, trail = Setpoints("hold", v_max), Trail(list(position), [list(target)])
    row = setpoints.command(trail, new_state("control.command")).header[0]
    velocity, way = np.array([row["vx"], row["vy"], row["vz"]]), np.subtract(target, position)
    assert np.linalg.norm(velocity) == pytest.approx(min(np.linalg.norm(way), SHARE * v_max))
    assert np.allclose(np.cross(velocity, way), 0.0, atol=1e-6 * (1.0 + np.linalg.norm(way)))
    assert velocity @ way >= 0.0


def odometry(position):
    state = new_state("sensor.odometry")
    for name, value in zip("xyz", position, strict=True):
        state.header[name] = value
    return state


def flown(mode, path, seconds=120.0):
    """Where a point mass goes that follows a mode from the end of a path."""
    setpoints, trail = Setpoints(mode, V_MAX), Trail()
    for position in path:
        setpoints.note(trail, odometry(position), flown=True)
    setpoints.begin(trail)
    position, went = np.array(path[-1], float), []
    for _ in range(int(seconds / 0.02)):
        setpoints.note(trail, odometry(position), flown=False)
        command = setpoints.command(trail, new_state("control.command"))
        if command is not None:
            row = command.header[0]
            assert row["duration"] == VALID_S and row["yaw_rate"] == 0.0
            position = position + 0.02 * np.array([row["vx"], row["vy"], row["vz"]])
        went.append(position)
    return np.array(went)


def corner(step=0.3):
    """An L-shaped path, 12 m and 9 m."""
    along = [(x, 0.0, 3.0) for x in np.arange(0.0, 12.0, step)]
    return along + [(12.0, y, 3.0) for y in np.arange(0.0, 9.0, step)]


def test_back_returns_along_the_flown_path():
    path = corner()
    went = flown("back", path)
    assert math.dist(went[-1], path[0]) < 0.01
    distances = [np.linalg.norm(np.array(path) - position, axis=1).min() for position in went]
    assert max(distances) < SPACING, "the corner is not cut by more"
    speeds = np.linalg.norm(np.diff(went, axis=0), axis=1) / 0.02
    assert speeds.max() <= 0.5 * V_MAX + 1e-9


def test_hold_stays_where_it_began_and_hover_commands_nothing():
    path = corner()
    assert np.allclose(flown("hold", path, 5.0), path[-1])
    setpoints, trail = Setpoints("hover", V_MAX), Trail()
    setpoints.note(trail, odometry((1.0, 2.0, 3.0)), flown=True)
    setpoints.begin(trail)
    assert setpoints.command(trail, new_state("control.command")) is None and trail.points == []


@pytest.mark.parametrize("mode", ["hold", "back"])
def test_without_a_finite_position_it_hovers(mode):
    setpoints, trail = Setpoints(mode, V_MAX), Trail()
    setpoints.note(trail, odometry((math.nan, 0.0, 0.0)), flown=True)
    setpoints.begin(trail)
    assert setpoints.command(trail, new_state("control.command")) is None


def test_positions_are_stored_at_a_distance_and_before_the_mode_only():
    setpoints, trail = Setpoints("back", V_MAX), Trail()
    for x in np.arange(0.0, 5.01, 0.1):
        setpoints.note(trail, odometry((x, 0.0, 0.0)), flown=True)
    stored = [x for x, _, _ in trail.points]
    assert all(SPACING <= b - a < SPACING + 0.11 for a, b in zip(stored, stored[1:], strict=False)) and len(stored) >= 5
    setpoints.note(trail, odometry((9.0, 0.0, 0.0)), flown=False)
    assert trail.position == [9.0, 0.0, 0.0] and [x for x, _, _ in trail.points] == stored
    assert REACHED < SPACING
