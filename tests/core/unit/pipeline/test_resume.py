"""Nodes that died start where they stopped: what they read back is what an undisturbed node remembers."""

import numpy as np
import pytest

from mavfi.pipeline.control import Tracker
from mavfi.pipeline.estimation import StateEstimator
from mavfi.pipeline.perception import CollisionCheck
from mavfi.pipeline.planning import MotionPlanner
from mavfi.pipeline.ppc import build_pipeline
from mavfi.pipeline.trajectories import TrajectoryGenerator
from mavfi.pipeline.waypoints import SetpointGenerator
from mavfi.states import ODOMETRY, floats, new_state
from tests.core.reference.kernels.estimation import AIRSIM
from tests.core.unit.pipeline.parts import (
    AUTOPILOTS,
    config,
    map_update,
    odometry,
    same,
    status,
    tracking,
    trajectory,
    waypoint,
)
from tests.core.unit.pipeline.test_estimation import Flight, fix

TICK = 20_000


def last(*states):
    return {state.spec.name: state for state in states}


def period(autopilot):
    return 0.5 if autopilot == "published" else 0.02


@pytest.mark.parametrize("autopilot", AUTOPILOTS)
def test_a_kernel_that_published_nothing_starts_as_at_take_off(autopilot):
    for new, plain in zip(
        build_pipeline(config(autopilot)).values(), build_pipeline(config(autopilot)).values(), strict=True
    ):
        assert new.resume({}, TICK) == ()
        assert new.same(plain.save())


@pytest.mark.parametrize("autopilot", AUTOPILOTS)
def test_the_planner_knows_the_trajectory_and_which_alarms_it_has_answered(autopilot):
    flown = trajectory(seq=4, epoch=2, period=period(autopilot))
    undisturbed, back = MotionPlanner(config(autopilot)), MotionPlanner(config(autopilot))
    undisturbed.receive(status(seq=2, time=4.0, collision=True), 0)
    undisturbed.receive(flown, TICK)
    assert back.resume(last(flown), TICK) == ()
    before, after = undisturbed.memory, back.memory
    assert after.trajectory is before.trajectory and after.arc.tolist() == before.arc.tolist()
    back.receive(status(seq=2, time=4.0, collision=True), 2 * TICK)
    assert after.decisions.alarm < 0.0, "it has answered that one"
    back.receive(status(seq=3, time=4.0, collision=True), 3 * TICK)
    assert after.decisions.alarm == 4.0


def test_plans_of_the_node_continue_the_count():
    planner = MotionPlanner(config())
    back = TrajectoryGenerator(config(), planner.clearance_map)
    flown = trajectory(seq=4, epoch=2)
    assert back.resume(last(flown), TICK) == ()
    assert back.memory.flown is flown
    assert int(back.step(TICK)[0].header["trajectory_seq"][0]) == 5


def check(**rules):
    """A collision check with a map in which the trajectory of `flying` leads into a wall."""
    kernel = CollisionCheck(config(**rules))
    grid = kernel.clearance_map.grid
    wall = [(30 * grid.ny + iy) * grid.nz + iz for iy in range(grid.ny) for iz in range(grid.nz)]
    kernel.receive(map_update(np.arange(grid.size), -1.0), 0)
    kernel.receive(map_update(wall), 0)
    return kernel


def flying(kernel, epoch=0):
    in_force = waypoint()
    in_force.header["trajectory_seq"], in_force.header["future_collision_seq"] = 1, epoch
    for state in (odometry(), trajectory(epoch=epoch), in_force, tracking(0.3)):
        kernel.receive(state, 0)


def numbers(states):
    return [(int(state.header["future_collision_seq"][0]), bool(state.header["collision"][0])) for state in states]


def test_the_check_continues_counting():
    undisturbed, back, fresh = check(), check(), check()
    last_status = status(seq=6)
    undisturbed.receive(last_status, 0)
    assert back.resume(last(last_status), 0) == ()
    for kernel in (undisturbed, back, fresh):
        flying(kernel, epoch=6)
    assert same(undisturbed.step(0), back.step(0))
    assert numbers(back.step(0)) == [(7, True)] and numbers(fresh.step(0)) == [(1, True)]


@pytest.mark.parametrize(("alarm", "repeated"), [("one_shot", (1, False)), ("repeated", (1, True))])
def test_an_alarm_is_said_again_with_its_number_until_it_is_answered(alarm, repeated):
    kernel = check(alarm=alarm)
    flying(kernel)
    (first,) = kernel.step(0)
    assert numbers([first]) == [(1, True)]
    for _ in range(2):
        kernel.receive(first, 0)
        (first,) = kernel.step(0)
        assert numbers([first]) == [repeated]
    kernel.receive(first, 0)
    flying(kernel, epoch=1)
    assert numbers(kernel.step(0)) == [(2, True)]


def test_the_tracker_continues_with_the_way_point_in_force():
    undisturbed, back = Tracker(config()), Tracker(config())
    in_force = waypoint(position=(4.0, 5.0, 3.0))
    undisturbed.receive(in_force, 0)
    for _ in range(7):
        undisturbed.receive(odometry(), 0)
        _, left = undisturbed.step(0)
    assert back.resume(last(in_force, left), TICK) == ("planning.waypoint",)
    back.receive(odometry(), TICK)
    assert same(undisturbed.step(TICK), back.step(TICK))
    assert Tracker(config()).resume(last(in_force), TICK) == (), "it has tracked nothing yet"


def setpoint_generator(autopilot, *received):
    kernel = SetpointGenerator(config(autopilot))
    kernel.receive(odometry(), 0)
    published = kernel.step(0)
    for tick, states in enumerate(received, 1):
        for state in states:
            kernel.receive(state, tick * TICK)
        published = kernel.step(tick * TICK) or published
    return kernel, published[-1]


@pytest.mark.parametrize("autopilot", AUTOPILOTS)
def test_the_setpoint_generator_continues_along_its_trajectory(autopilot):
    flown = trajectory(seq=3, epoch=2, period=period(autopilot), count=100)
    undisturbed, in_force = setpoint_generator(autopilot, [flown], [tracking(0.0)], [tracking(0.0)])
    back = SetpointGenerator(config(autopilot))
    assert back.resume(last(flown, in_force), 4 * TICK) == ("planning.trajectory",)
    for kernel in (undisturbed, back):
        kernel.receive(odometry(), 4 * TICK)
        kernel.receive(tracking(0.0), 4 * TICK)
    (first,), (second,) = undisturbed.step(4 * TICK), back.step(4 * TICK)
    assert first.header["index"] == second.header["index"]
    np.testing.assert_allclose(floats(first.header, 3), floats(second.header, 3), atol=0.1)
    for seq, epoch in ((2, 2), (4, 1)):  # older than the one in force, and of an older epoch
        back.receive(trajectory(seq=seq, epoch=epoch, period=period(autopilot)), 5 * TICK)
        back.receive(tracking(0.0), 5 * TICK)
        assert {int(state.header["trajectory_seq"][0]) for state in back.step(5 * TICK)} <= {3}


def test_a_trajectory_that_was_given_up_is_not_flown_again():
    flown = trajectory(seq=3, epoch=2)
    _, hold = setpoint_generator("published", [flown], [status(seq=3, time=0.1, collision=True)])
    assert int(hold.header["index"][0]) == -1
    back = SetpointGenerator(config())
    assert back.resume(last(flown, hold), 3 * TICK) == ("planning.trajectory",)
    back.receive(odometry(), 3 * TICK)
    assert back.step(3 * TICK) == []
    assert SetpointGenerator(config()).resume(last(trajectory(seq=4, epoch=3), hold), 3 * TICK) == ()


def test_the_estimator_goes_on_from_its_last_estimate_and_takes_the_next_fix():
    flown = Flight()
    flown.hover(200)
    (estimate,) = flown.step(imu=None)
    back = Flight()
    back.time_us = flown.time_us + TICK
    assert back.kernel.resume(last(estimate, fix(x=50.0)), back.time_us) == ("sensor.position",), (
        "older than the estimate"
    )
    (again,) = back.step()
    np.testing.assert_array_equal(
        floats(again.header, 19)[[*range(10), *range(13, 19)]],
        floats(estimate.header, 19)[[*range(10), *range(13, 19)]],
    )
    (moved,) = back.step(fix(x=1.3))
    assert moved.header["x"][0] == pytest.approx(1.3, abs=0.01), "it may have moved meanwhile"
    assert np.abs(floats(moved.header, 6)[3:]).max() < 0.1
    assert back.hover(500)[0] == pytest.approx(1.0, abs=0.05)


def test_an_estimate_that_is_no_number_is_not_read_back():
    broken = new_state(ODOMETRY["estimator"])
    broken.header["vx"] = np.inf
    kernel = StateEstimator(AIRSIM)
    assert kernel.resume(last(broken), TICK) == () and kernel.same(StateEstimator(AIRSIM).save())
