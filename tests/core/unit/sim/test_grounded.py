"""The vehicle on the ground, armed and not; contacts; pose, wind, obstacles and cameras at run time."""

import math

import numpy as np
import pytest

from mavfi.config import CameraConfig
from mavfi.errors import BadInputError
from mavfi.sim.engine import GRAVITY
from mavfi.sim.grounded import GROUND, Grounded, times
from mavfi.sim.simulator import Simulator
from tests.core.unit.sim.flights import open_world, room, scenario

LOWER, UPPER = [(5.0, -1.0, 0.0)], [(6.0, 1.0, 4.0)]
SIDE = 0.5 * math.sqrt(2.0)


def grounded(lower=(), upper=(), **changes):
    return Grounded(open_world(10.0, lower, upper), scenario(**changes))


def fly(one, velocity, seconds):
    one.command(np.array([*velocity, 0.0]), seconds)
    one.advance(one.time_us + round(1e6 * seconds))


def test_it_stands_still_until_its_motors_run():
    one = grounded()
    before = one.odometry.copy()
    one.advance(1_000_000)
    assert one.odometry.tobytes() == before.tobytes() and one.resting and not one.armed
    np.testing.assert_allclose(one.odometry[:3], (0.0, 0.0, 0.35))
    np.testing.assert_allclose(one.imu()[:3], (0.0, 0.0, GRAVITY), atol=0.2)
    one.arm(True)
    one.advance(1_200_000)
    assert one.odometry.tobytes() == before.tobytes() and one.resting  # idle
    fly(one, (0.0, 0.0, 1.0), 3.0)
    assert (
        not one.resting and one.height > 2.0 and one.landed_at.time_us < 1_300_000
    )  # the last contact was that of the lift-off


def test_a_landing_is_no_collision_and_ends_at_rest():
    one = grounded()
    one.arm(True)
    fly(one, (0.0, 0.0, 1.0), 3.0)
    fly(one, (0.5, 0.0, -0.5), 8.0)
    assert one.touched is None and one.landed_at is not None and one.landed_at.obstacle == GROUND
    np.testing.assert_allclose(one.landed_at.normal, (0.0, 0.0, 1.0), atol=1e-9)
    one.arm(False)
    one.advance(one.time_us + 200_000)
    assert one.resting and not one.odometry[3:6].any() and one.odometry[2] == 0.35


def test_without_motors_it_falls_and_comes_to_rest():
    one = grounded()
    one.arm(True)
    fly(one, (0.0, 0.0, 2.0), 4.0)
    height, climb = one.height, float(one.odometry[5])
    one.arm(False)
    start_us = one.time_us
    one.advance(start_us + 3_000_000)
    fall = (climb + math.sqrt(climb**2 + 2.0 * GRAVITY * height)) / GRAVITY  # without drag
    assert one.resting and fall < 1e-6 * (one.landed_at.time_us - start_us) < 1.4 * fall


def test_a_contact_with_an_obstacle_has_its_time_place_and_name():
    one = grounded(LOWER, UPPER)
    one.arm(True)
    fly(one, (0.0, 0.0, 1.0), 2.0)
    assert one.touched is None
    fly(one, (2.0, 0.0, 0.0), 4.0)
    assert one.touched.obstacle == 0 and one.touched.time_us > 2_000_000
    np.testing.assert_allclose(one.touched.normal, (-1.0, 0.0, 0.0), atol=1e-6)
    assert one.touched.point[0] == pytest.approx(5.0, abs=0.05) and 0.0 <= one.touched.depth < 0.1


def test_in_the_air_it_is_the_vehicle_of_missions():
    one, other = Grounded(open_world(), scenario(), on_ground=False), Simulator(open_world(), scenario())
    for vehicle in (one, other):
        vehicle.command(np.array([2.0, -1.0, 0.3, 0.4]), 0.7)
        vehicle.advance(1_000_000)
    assert one.odometry.tobytes() == other.odometry.tobytes()
    assert one.ranges(CameraConfig())[0].tobytes() == other.depth()[0].tobytes()


@pytest.mark.parametrize(
    ("world", "text"),
    [(room(), "without a ground plane"), (open_world(10.0, [(-1, -1, 0)], [(1, 1, 2)]), "an obstacle stands at 0 0")],
)
def test_where_it_cannot_stand_is_refused(world, text):
    with pytest.raises(BadInputError, match=text):
        Grounded(world, scenario())


def test_it_is_put_to_a_pose_and_hovers_there():
    one = grounded()
    one.arm(True)
    one.place(np.array([3.0, 4.0, 5.0]), np.array([2.0 * SIDE, 0.0, 0.0, 2.0 * SIDE]))
    one.advance(one.time_us + 2_000_000)
    np.testing.assert_allclose(one.odometry[:3], (3.0, 4.0, 5.0), atol=1e-6)
    np.testing.assert_allclose(one.odometry[6:10], (SIDE, 0.0, 0.0, SIDE), atol=1e-6)
    for pose in ([np.nan, 0, 0], [1, 0, 0, 0]), ([0, 0, 0], [0, 0, 0, 0]):
        with pytest.raises(BadInputError, match="allowed: finite numbers"):
            one.place(*map(np.array, (pose[0], pose[1] if len(pose[1]) == 4 else [0, 0, 0, 0])))


def test_wind_at_run_time_pushes_it():
    one = grounded()
    one.arm(True)
    fly(one, (0.0, 0.0, 1.0), 3.0)
    one.set_wind((0.0, 8.0, 0.0))
    fly(one, (0.0, 0.0, 0.0), 2.0)
    assert one.odometry[1] > 0.05
    with pytest.raises(BadInputError, match="wind"):
        one.set_wind((100.0, 0.0, 0.0))


def test_an_obstacle_at_run_time_is_seen_and_met():
    one = grounded()
    one.arm(True)
    fly(one, (0.0, 0.0, 1.0), 2.0)
    before = one.odometry.copy()
    assert np.isinf(one.cast(np.array([[1.0, 0.0, 0.0]]), 50.0)[0])
    one.set_boxes(np.array(LOWER), np.array(UPPER))
    assert one.odometry.tobytes() == before.tobytes()
    assert one.cast(np.array([[1.0, 0.0, 0.0]]), 50.0)[0] == pytest.approx(5.0 - before[0], abs=1e-5)
    assert not one.is_free(one.odometry[:3].copy(), np.array([9.0, 0.0, 1.0]))
    assert one.is_free(one.odometry[:3].copy(), np.array([0.0, 9.0, 1.0]))
    fly(one, (2.0, 0.0, 0.0), 4.0)
    assert one.touched is not None and one.touched.obstacle == 0


def test_a_camera_of_any_size_and_mount_sees_what_is_there():
    one = Grounded(open_world(10.0), scenario(), on_ground=False)
    down = (0.0, 0.0, -0.2, SIDE, 0.0, SIDE, 0.0)
    ranges, rays = one.ranges(CameraConfig(width=31, height=21, field_of_view=1.0, range=100.0), down)
    assert ranges.shape == (31 * 21,) and rays.shape == (31 * 21, 3)
    np.testing.assert_allclose(ranges * rays[:, 0], 9.8, rtol=1e-5)  # the ground, seen from above


def test_rotor_commands_replace_the_controller():
    one = Grounded(open_world(), scenario(), on_ground=False)
    one.rotors = lambda time_us, odometry: np.array([np.nan, 1e9, -1.0, 0.0])
    one.advance(200_000)
    np.testing.assert_allclose(one.thrusts, (0.0, one.max_thrust, 0.0, 0.0), atol=1e-9)


def test_quaternions_multiply_like_rotations():
    half = (SIDE, 0.0, 0.0, SIDE)
    np.testing.assert_allclose(times(half, half), (0.0, 0.0, 0.0, 1.0), atol=1e-15)
    assert times((1.0, 0.0, 0.0, 0.0), half) == list(half)


def test_obstacles_change_with_a_controller_that_cannot_be_saved(monkeypatch):
    def refuse():
        raise BadInputError("cannot be saved")

    one = grounded()
    one.arm(True)
    fly(one, (0.0, 0.0, 1.0), 1.0)
    monkeypatch.setattr(one.controller, "save", refuse)
    before = one.odometry.copy()
    one.set_boxes(np.array(LOWER), np.array(UPPER))
    one.advance(one.time_us)
    assert one.odometry.tobytes() == before.tobytes() and len(one.world.lower) == 1
