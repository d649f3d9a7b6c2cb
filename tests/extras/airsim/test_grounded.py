"""The vehicle on the ground, armed and not; contacts; pose, wind, obstacles and cameras at run time."""

import numpy as np
import pytest

from mavfi.config import CameraConfig
from mavfi.errors import BadInputError
from mavfi.extras.airsim.grounded import GROUND, Grounded
from mavfi.sim.engine import GRAVITY
from mavfi.sim.simulator import Simulator
from tests.core.unit.sim.flights import open_world, room, scenario


def grounded(lower=(), upper=(), **changes):
    return Grounded(open_world(10.0, lower, upper), scenario(**changes))


def fly(vehicle, velocity, seconds):
    vehicle.command(np.array([*velocity, 0.0]), seconds)
    vehicle.advance(vehicle.time_us + round(1e6 * seconds))


def test_it_stands_still_until_its_motors_run():
    vehicle = grounded()
    before = vehicle.odometry.copy()
    vehicle.advance(1_000_000)
    assert vehicle.odometry.tobytes() == before.tobytes() and vehicle.resting and not vehicle.armed
    np.testing.assert_allclose(vehicle.odometry[:3], (0.0, 0.0, 0.35))
    np.testing.assert_allclose(vehicle.imu()[:3], (0.0, 0.0, GRAVITY), atol=0.2)
    vehicle.arm(True)
    vehicle.advance(1_200_000)
    assert vehicle.odometry.tobytes() == before.tobytes() and vehicle.resting  # idle
    fly(vehicle, (0.0, 0.0, 1.0), 3.0)
    assert (
        not vehicle.resting and vehicle.height > 2.0 and vehicle.landed_at.time_us < 1_300_000
    )  # the last contact was that of the lift-off


def test_a_landing_is_no_collision_and_ends_at_rest():
    vehicle = grounded()
    vehicle.arm(True)
    fly(vehicle, (0.0, 0.0, 1.0), 3.0)
    fly(vehicle, (0.5, 0.0, -0.5), 8.0)
    assert vehicle.touched is None and vehicle.landed_at is not None and vehicle.landed_at.obstacle == GROUND
    np.testing.assert_allclose(vehicle.landed_at.normal, (0.0, 0.0, 1.0), atol=1e-9)
    vehicle.arm(False)
    vehicle.advance(vehicle.time_us + 200_000)
    assert vehicle.resting and not vehicle.odometry[3:6].any() and vehicle.odometry[2] == 0.35


def test_in_the_air_it_is_the_vehicle_of_missions():
    grounded_vehicle, other = Grounded(open_world(), scenario(), on_ground=False), Simulator(open_world(), scenario())
    for vehicle in (grounded_vehicle, other):
        vehicle.command(np.array([2.0, -1.0, 0.3, 0.4]), 0.7)
        vehicle.advance(1_000_000)
    assert grounded_vehicle.odometry.tobytes() == other.odometry.tobytes()
    assert grounded_vehicle.ranges(CameraConfig())[0].tobytes() == other.depth()[0].tobytes()


@pytest.mark.parametrize(
    ("world", "text"),
    [(room(), "without a ground plane"), (open_world(10.0, [(-1, -1, 0)], [(1, 1, 2)]), "an obstacle stands at 0 0")],
)
def test_where_it_cannot_stand_is_refused(world, text):
    with pytest.raises(BadInputError, match=text):
        Grounded(world, scenario())
