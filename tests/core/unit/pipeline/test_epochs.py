import numpy as np
import pytest

from mavfi.pipeline.waypoints import SetpointGenerator
from mavfi.states import floats, rows
from tests.core.unit.pipeline.parts import config, odometry, status, tracking, trajectory

TICK = 20_000


def setpoint_generator(autopilot="published", **rules):
    kernel = SetpointGenerator(config(autopilot, **rules))
    kernel.receive(odometry(), 0)
    kernel.step(0)
    return kernel


def give(kernel, *states, at=TICK):
    for state in states:
        kernel.receive(state, at)
    return kernel.step(at)


def seq_of(states):
    return [int(state.header["trajectory_seq"][0]) for state in states]


def test_without_a_trajectory_the_vehicle_holds_where_it_is():
    kernel = SetpointGenerator(config())
    kernel.receive(odometry((4.0, 5.0, 2.0)), 0)
    (held,) = kernel.step(0)
    assert floats(held.header, 3).tolist() == [4.0, 5.0, 2.0]
    assert int(held.header["index"][0]) == -1
    assert kernel.step(TICK) == []


@pytest.mark.parametrize("autopilot", ["published", "hardened"])
@pytest.mark.parametrize(("seq", "epoch", "taken"), [(4, 2, False), (6, 1, False), (6, 2, True)])
def test_an_older_trajectory_or_one_of_an_older_epoch_is_rejected(autopilot, seq, epoch, taken):
    kernel = setpoint_generator(autopilot)
    assert seq_of(give(kernel, trajectory(seq=5, epoch=2)))[-1:] == [5]
    late = give(kernel, trajectory(seq=seq, epoch=epoch, start=(2.0, 5.5, 3.0)), tracking(0.3), at=2 * TICK)
    assert set(seq_of(late)) == {seq} if taken else set(seq_of(late)) <= {5}


@pytest.mark.parametrize(("autopilot", "freed"), [("published", False), ("hardened", True)])
def test_only_hardened_frees_itself_from_an_epoch_that_nobody_can_reach(autopilot, freed):
    kernel = setpoint_generator(autopilot)
    give(kernel, trajectory(seq=1, epoch=1 << 30))
    taken = []
    for k in range(300):
        at = (k + 2) * TICK
        state = trajectory(seq=2 + k, epoch=1)
        taken += seq_of(give(kernel, state, tracking(0.3), at=at))
    assert (max(taken, default=0) > 1) == freed
    if freed:
        assert min(seq for seq in taken if seq > 1) >= 2 + 3.0 / 0.02  # epoch_liveness


def test_a_collision_is_acted_on_only_when_its_number_grows():
    kernel = setpoint_generator()
    give(kernel, trajectory())
    (stop,) = give(kernel, status(seq=1, time=0.1, collision=True), tracking(0.3), at=2 * TICK)
    assert int(stop.header["index"][0]) == -1
    give(kernel, trajectory(seq=2, epoch=1), at=3 * TICK)
    for number in (1, 0, -5):
        assert give(kernel, status(seq=number, time=0.1, collision=True), tracking(0.3), at=4 * TICK) == []
    assert give(kernel, status(seq=2, time=0.1), tracking(0.3), at=5 * TICK) == []  # without the flag
    (stop,) = give(kernel, status(seq=2, time=0.1, collision=True), tracking(0.3), at=6 * TICK)
    assert int(stop.header["index"][0]) == -1


@pytest.mark.parametrize(("time", "at_once"), [(0.0, True), (1.6, True), (1.61, False), (np.nan, True)])
def test_a_far_collision_gives_the_planner_the_grace_period(time, at_once):
    kernel = setpoint_generator()
    give(kernel, trajectory())
    first = give(kernel, status(seq=1, time=time, collision=True), tracking(0.3), at=2 * TICK)
    assert bool(first) == at_once
    just_before = give(kernel, tracking(0.3), at=2 * TICK + 980_000)
    after = give(kernel, tracking(0.3), at=2 * TICK + 1_000_000)
    assert just_before == [] and bool(after) != at_once


def test_held_points_are_handed_over_one_by_one():
    kernel = setpoint_generator()
    assert [int(s.header["index"][0]) for s in give(kernel, trajectory(count=3))] == [0]
    indices = []
    for k in range(4):
        assert give(kernel, tracking(0.1), at=(2 * k + 2) * TICK) == []
        indices += [int(s.header["index"][0]) for s in give(kernel, tracking(0.0), at=(2 * k + 3) * TICK)]
    assert indices == [1, 2, -1]


@pytest.mark.parametrize(
    ("column", "value"), [(0, np.nan), (2, 1e300), (4, 9.0), (10, 0.0), (10, 5.0), (1, -20.0), (0, 9.0)]
)
def test_hardened_refuses_a_trajectory_that_makes_no_sense_and_stops(column, value):
    kernel = setpoint_generator("hardened")
    give(kernel, trajectory(period=0.02))
    bad = trajectory(seq=2, period=0.02)
    rows(bad.elements, 11)[4, column] = value
    (stop,) = give(kernel, bad, at=2 * TICK)
    assert int(stop.header["index"][0]) == -1
    assert np.isfinite(floats(stop.header, 11)).all()


def test_hardened_stops_when_it_has_left_the_reference():
    kernel = setpoint_generator("hardened")
    give(kernel, trajectory(period=0.02))
    (on,) = give(kernel, odometry((2.0, 7.0, 3.0)), at=2 * TICK)
    assert int(on.header["index"][0]) >= 0
    (stop,) = give(kernel, odometry((2.0, 8.0, 3.0)), at=3 * TICK)
    assert int(stop.header["index"][0]) == -1


def speed(states):
    return float(np.linalg.norm(floats(states[-1].header, 11)[4:7]))


@pytest.mark.parametrize(("blocked", "slower"), [(np.inf, False), (0.5, True)])
def test_what_is_said_of_a_trajectory_before_it_is_in_force_holds_from_its_first_point_on(blocked, slower):
    kernel = setpoint_generator("hardened")
    flown = trajectory(seq=1, period=0.02, count=100)
    give(kernel, flown, status(blocked=blocked, trajectory_seq=1))
    assert (speed([give(kernel, at=k * TICK)[-1] for k in range(2, 12)]) < 1.5) == slower


@pytest.mark.parametrize("autopilot", ["published", "hardened"])
def test_only_hardened_flies_on_when_a_plan_has_failed_and_stops_where_the_way_is_blocked(autopilot):
    kernel = setpoint_generator(autopilot)
    flown = trajectory(seq=1, period=0.5 if autopilot == "published" else 0.02, count=100)
    give(kernel, flown)
    after = give(kernel, trajectory(seq=2, count=0), tracking(0.3), at=2 * TICK)
    assert int(after[-1].header["index"][0]) == (-1 if autopilot == "published" else 1)
    if autopilot == "hardened":
        give(kernel, status(blocked=0.0, trajectory_seq=1), at=3 * TICK)
        for k in range(4, 60):
            give(kernel, at=k * TICK)
        held = give(kernel, trajectory(seq=3, count=0), at=60 * TICK)
        assert int(held[-1].header["index"][0]) == -1
