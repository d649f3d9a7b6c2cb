"""The simulator: commands, time, contact, snapshots, warnings."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavfi.sim.environments.generated import cuboids
from mavfi.sim.simulator import Simulator
from tests.core.unit.sim.flights import TICK_US, fly, open_world, room, scenario, simulator

ABSURD = (math.nan, math.inf, -math.inf)


def trace(flight, seconds=3.0):
    rows = fly(flight, (2.0, 1.0, 0.2, 0.4), seconds)
    ranges, pose = flight.depth()
    return rows.tobytes() + ranges.tobytes() + pose.tobytes() + flight.imu().tobytes()


def test_it_starts_at_rest_and_faces_the_goal():
    world = cuboids(3, 0.05, 6.0)
    flight = Simulator(world, scenario())
    way = world.goal - world.start
    np.testing.assert_array_equal(flight.odometry[:3], world.start)
    assert 2.0 * math.atan2(flight.odometry[9], flight.odometry[6]) == pytest.approx(math.atan2(way[1], way[0]))
    assert not flight.odometry[3:6].any() and not flight.odometry[10:].any()


def test_how_often_it_is_advanced_does_not_matter():
    fine, coarse = simulator(), simulator()
    for flight in (fine, coarse):
        flight.command(np.array([2.0, -1.0, 0.5, 1.0]), 0.5)
    for tick in range(1, 251):
        fine.advance(4_000 * tick)
    coarse.advance(1_000_000)
    np.testing.assert_array_equal(fine.odometry, coarse.odometry)


@pytest.mark.parametrize("value", ABSURD)
@pytest.mark.parametrize("field", range(5))
def test_a_command_that_is_not_finite_is_refused_and_the_last_one_held(value, field):
    flight, twin = simulator(), simulator()
    for each in (flight, twin):
        each.command(np.array([1.0, 0.5, 0.0, 0.2]), 2.0)
    command = [3.0, 0.0, 0.0, 0.0, 1.0]
    command[field] = value
    flight.command(np.array(command[:4]), command[4])
    for each in (flight, twin):
        each.advance(1_000_000)
    assert flight.rejected_commands == 1 and twin.rejected_commands == 0
    np.testing.assert_array_equal(flight.odometry, twin.odometry)


def test_a_command_expires_to_hover():
    flight = simulator()
    flight.command(np.array([3.0, 0.0, 0.0, 1.0]), 1.0)
    flight.advance(1_000_000)
    assert flight.odometry[3] > 2.0
    flight.advance(6_000_000)
    np.testing.assert_allclose(flight.odometry[3:6], 0.0, atol=0.02)
    assert flight.odometry[12] == pytest.approx(0.0, abs=1e-3)


def test_touching_a_box_is_a_collision_and_stays_one():
    flight = simulator(open_world(5.0, lower=[(5.0, -2.0, 0.0)], upper=[(7.0, 2.0, 9.0)]))
    rows = fly(flight, (3.0, 0.0, 0.0, 0.0), 4.0)
    assert flight.collided
    assert rows[:, 0].max() == pytest.approx(5.0 - 0.35, abs=0.05)
    fly(flight, (-3.0, 0.0, 0.0, 0.0), 1.0)
    assert flight.collided


def test_touching_a_voxel_is_a_collision():
    flight = simulator(room(), vehicle="small_quad")
    rows = fly(flight, (1.0, 0.0, 0.0, 0.0), 1.5)
    assert not flight.collided and rows[-1, 0] + 0.1 < 3.9
    rows = fly(flight, (1.0, 0.0, 0.0, 0.0), 1.5)
    first = rows[rows[:, 0] + 0.1 > 3.9]
    assert flight.collided and len(first)


@pytest.mark.parametrize("world", (open_world(5.0, [(4.0, -2.0, 0.0)], [(6.0, 2.0, 9.0)]), room()))
def test_a_restored_snapshot_continues_bit_by_bit(world):
    """Through a contact, with sensor noise, into the same simulator and into another one."""
    flight = Simulator(world, scenario(noise=0.02))
    fly(flight, (2.0, 0.3, 0.1, 0.4), 0.8)
    flight.command(np.array([math.nan, 0.0, 0.0, 0.0]), 1.0)
    flight.imu()
    saved = flight.snapshot()
    expected = trace(flight)
    collided = flight.collided
    other = Simulator(world, scenario(noise=0.02))
    for restored in (flight, other):
        restored.restore(saved)
        assert restored.time_us == 800_000 and restored.rejected_commands == 1
        assert trace(restored) == expected
        assert restored.collided is collided


@given(st.lists(st.tuples(*[st.floats(width=64)] * 5), min_size=1, max_size=4))
def test_no_command_reaches_mujoco_unsaturated(commands):
    flight = simulator()
    largest = flight._airframe.max_thrust
    for vx, vy, vz, yaw_rate, duration in commands:
        flight.command(np.array([vx, vy, vz, yaw_rate]), duration)
        assert np.linalg.norm(flight._setpoint[:3]) <= 1.33 * 3.0 + 1e-9
        flight.advance(flight.time_us + 40_000)
        thrusts = flight._thrusts
        assert ((thrusts >= 0.0) & (thrusts <= largest)).all()
        assert np.isfinite(flight._data.qfrc_applied).all() and np.abs(flight._data.qfrc_applied).max() < 6 * largest
    assert flight.warnings() == [] and np.isfinite(flight.odometry).all()


def test_warnings_of_mujoco_are_reported_and_time_is_not_reset(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    flight = simulator()
    flight.advance(TICK_US)
    assert flight.warnings() == []
    flight._data.qvel[0] = math.nan
    flight.advance(2 * TICK_US)
    assert any("BADQVEL" in warning for warning in flight.warnings())
    assert flight._data.time == pytest.approx(2e-6 * TICK_US)
    assert list(tmp_path.iterdir()) == []
