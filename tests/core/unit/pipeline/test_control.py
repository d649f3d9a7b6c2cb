import numpy as np
import pytest

from mavfi.pipeline.control import Tracker
from tests.core.unit.pipeline.parts import config, odometry, waypoint


def tracker(autopilot="published", **options):
    kernel = Tracker(config(autopilot, **options))
    kernel.receive(odometry(), 0)
    return kernel


def test_the_time_left_of_a_point_runs_down_and_its_overrun_is_taken_from_the_next():
    kernel = tracker()
    kernel.receive(waypoint(duration=0.05), 0)
    left = [float(kernel.step(0)[1].header["remaining"][0]) for _ in range(3)]
    assert left == pytest.approx([0.03, 0.01, -0.01])
    kernel.receive(waypoint(duration=0.05), 0)
    assert float(kernel.step(0)[1].header["remaining"][0]) == pytest.approx(0.05 - 0.01 - 0.02)


@pytest.mark.parametrize("axis", ["x", "y", "z", "vx", "vy", "vz"])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_corrupted_point_is_still_handed_over_in_finite_time(axis, value):
    kernel = tracker()
    point = waypoint()
    point.header[axis] = value
    kernel.receive(point, 0)
    for _ in range(300):
        _, tracking = kernel.step(0)
    assert float(tracking.header["remaining"][0]) <= 0.0


def test_a_way_point_that_comes_between_step_and_rollback_still_counts():
    kernel = tracker()
    kernel.receive(waypoint(duration=0.5), 0)
    kernel.step(0)
    kernel.mark()
    kernel.step(0)
    kernel.receive(waypoint(duration=0.2), 0)
    kernel.rollback()
    assert float(kernel.step(0)[1].header["remaining"][0]) == pytest.approx(0.18)


def test_the_gains_of_the_autopilot_reach_the_tracker_and_a_command_lasts_one_control_period():
    kernel = tracker(gain_p=(0.0, 0.0, 0.0), gain_i=(2.0, 0.0, 0.0), gain_d=(0.0, 0.5, 0.0), integral_limit=0.03)
    kernel.receive(waypoint(position=(3.0, 6.0, 3.0)), 0)
    first, *others = [kernel.step(0)[0].header[0] for _ in range(3)]
    assert first["vx"] == pytest.approx(2.0 * 0.02) and first["vy"] == 0.0 and first["duration"] == 0.02
    assert [command["vx"] for command in others] == pytest.approx([2.0 * 0.03] * 2)
    kernel.receive(waypoint(position=(3.0, 6.1, 3.0)), 0)
    assert kernel.step(0)[0].header["vy"][0] == pytest.approx(0.5 * 0.1 / 0.02)
