"""The rules to copy raise nothing on error-free flights, and find the faults that they are for."""

import numpy as np
import pytest
from examples.five_rules import (
    Numbering,
    RepeatedAlarm,
    numbering_of_a_restarted_node,
    response,
    wrong_alarm,
    wrong_copy,
    wrong_path,
    wrong_step,
)

from mavfi.flight.compose import limits_of, resolve
from mavfi.flight.fly import fly
from mavfi.mission import MissionSpec
from mavfi.sim.environments import build_world

DETOUR = 8.0


class Seen:
    """Publications of a flight, by state, each with the vehicle's position at that time."""

    def __init__(self):
        self.states = []
        self.vehicle = (0.0, 0.0, 0.0)

    def __call__(self, state, time_us):
        if state.spec.name == "sensor.odometry":
            self.vehicle = tuple(float(state.header[axis][0]) for axis in "xyz")
        self.states.append((state.spec.name, state, self.vehicle, 1e-6 * time_us))


@pytest.fixture(scope="module", params=["dense", "factory"])
def flight(request):
    scenario = resolve(MissionSpec(environment=request.param, seed=10007))
    world = build_world(scenario.environment, scenario.seed, scenario.start, scenario.goal)
    seen = Seen()
    fly(scenario, recorders=[seen])
    return seen.states, limits_of(scenario, world)


def of(states, name):
    return [publication for publication in states if publication[0] == name]


def vertices(state):
    return list(zip(*(state.elements[axis].tolist() for axis in "xyz"), strict=True))


def path_check(path, vehicle, limits):
    limit_row = limits.numbers()[0]
    lower, upper, goal = (tuple(limit_row[key].tolist()) for key in ("lower", "upper", "goal"))
    return wrong_path(path, lower, upper, vehicle, goal, float(limit_row["near"]), DETOUR)


def numbers(flight):
    """Number of the status and of the trajectory last published, before each status."""
    last = answered = 0
    for name, state, _, _ in flight[0]:
        if name == "perception.collision_status":
            header = state.header[0]
            yield int(header["future_collision_seq"]), bool(header["collision"]), last, answered
            last = int(header["future_collision_seq"])
        elif name == "planning.trajectory":
            answered = int(state.header[0]["future_collision_seq"])


def test_alarms(flight):
    every = list(numbers(flight))
    assert any(flag for _, flag, _, _ in every)
    for counter, flag, last, answered in every:
        assert wrong_alarm(counter, flag, last, answered) == ""
        assert wrong_alarm(counter, not flag, last, answered) == "flag"
        for bit in range(1, 31):
            assert wrong_alarm(counter ^ (1 << bit), flag, last, answered)


def test_answers(flight):
    numbering, newest, checked = Numbering(), 0, 0
    for name, state, _, now in flight[0]:
        if name == "perception.collision_status":
            newest = int(state.header[0]["future_collision_seq"])
        elif name == "planning.path":
            number = int(state.header[0]["future_collision_seq"])
            assert numbering.wrong_answer(number | 1 << 20, newest, now) == "number"
            assert numbering.wrong_answer(number, newest, now) == ""
            checked += 1
    assert checked


def test_a_new_numbering_is_accepted_after_a_second_of_rejections():
    corrupted = Numbering(last=1 << 20)
    assert [corrupted.wrong_answer(3, 4, now) for now in (10.0, 10.9, 11.0, 11.1)] == ["number", "number", "", ""]
    assert corrupted.last == 3
    assert [Numbering(2).wrong_answer(9, 4, now) for now in (0.0, 2.0)] == ["number"] * 2, "nobody asked this"


def test_paths(flight):
    for _, state, vehicle, _ in of(flight[0], "planning.path"):
        path = vertices(state)
        assert path_check(path, vehicle, flight[1]) == ""
        for vertex, point in enumerate(path):
            path[vertex] = (point[0], point[1] + 1e3, point[2])
            assert path_check(path, vehicle, flight[1])
            path[vertex] = point


def test_a_spike_is_no_path():
    limits = ((-50.0, -50.0, 0.0), (50.0, 50.0, 20.0), (0.0, 0.0, 2.0), (20.0, 0.0, 2.0), 1.0, DETOUR)
    assert wrong_path([(0, 0, 2), (10, 0, 2), (20, 0, 2)], *limits) == ""
    assert wrong_path([(0, 0, 2), (10, 40, 2), (20, 0, 2)], *limits) == "spike"
    assert wrong_path([(0, 0, 2), (10, float("nan"), 2), (20, 0, 2)], *limits) == "outside the flight volume"
    assert wrong_path([(3, 0, 2), (20, 0, 2)], *limits) == "does not begin at the vehicle"
    assert wrong_path([(0, 0, 2), (15, 0, 2)], *limits) == "does not end at the goal"


def test_steps(flight):
    limit_row = flight[1].numbers()[0]
    limits = float(limit_row["speed"]), float(limit_row["change"]), float(limit_row["step"])
    for _, state, _, _ in of(flight[0], "planning.trajectory"):
        rows = state.elements[["x", "y", "z", "vx", "vy", "vz", "duration"]].tolist()
        for before, row in zip(rows, rows[1:-1], strict=False):  # the last one is at rest
            step_limits = (before[:3], before[3:6], row[6], *limits)
            assert wrong_step(row[:3], row[3:6], *step_limits) == ""
            assert wrong_step(row[:3], (row[3], row[4] + 5.0, row[5]), *step_limits) != ""
    still = ((0.0, 0.0, 2.0), (1.0, 0.0, 0.0), (0.0, 0.0, 2.0), (1.0, 0.0, 0.0), 0.1, 3.0, 0.5, 0.01)
    assert wrong_step(*still) == "not where its velocity leads"
    assert wrong_step((0.4, 0.0, 2.0), (4.0, 0.0, 0.0), *still[2:]) == "too fast"
    assert wrong_step((0.3, 0.0, 2.0), (3.0, 0.0, 0.0), *still[2:]) == "velocity changes too fast"


def test_copies(flight):
    points, checked = {}, 0
    for name, state, _, _ in flight[0]:
        if name == "planning.trajectory":
            points = {int(state.header[0]["trajectory_seq"]): state.elements, **points}
        elif name == "planning.waypoint":
            header = state.header[0]
            source = points.get(int(header["trajectory_seq"]))
            if source is not None and header["index"] >= 0 and len(source):
                values = [float(header[key]) for key in source.dtype.names]
                copied = source[int(header["index"])].tolist()
                assert wrong_copy(values, copied) == ""
                assert wrong_copy([*values[:-1], np.nextafter(values[-1], 9.0)], copied) == "copy"
                checked += 1
    assert checked


def test_an_alarm_is_repeated_until_it_is_answered():
    alarm = RepeatedAlarm()
    sent = [alarm.message(obstacle, answered) for obstacle, answered in ((False, 0), (True, 0), (True, 0), (False, 1))]
    assert sent == [(0, False), (1, True), (1, True), (1, False)]
    assert [wrong_alarm(*now, before[0], 0) for before, now in zip(sent, sent[1:3], strict=False)] == ["", ""]


def test_a_restarted_node_continues_its_numbers():
    assert numbering_of_a_restarted_node(7).wrong_answer(3, 9, 0.0) == "number"
    assert numbering_of_a_restarted_node(7).wrong_answer(8, 9, 0.0) == ""
    assert numbering_of_a_restarted_node(None).wrong_answer(0, 0, 0.0) == ""


def test_responses_escalate():
    assert [response(n) for n in (1, 2, 3, 4)] == ["send it again", "compute it again", *["restart the node"] * 2]
