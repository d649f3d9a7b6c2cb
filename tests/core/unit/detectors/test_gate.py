import numpy as np
import pytest

from mavfi.detectors.detector import Chain, NoDetector
from mavfi.detectors.gate import PhysicsGate
from mavfi.states import new_state
from tests.core.unit.detectors.streams import command, flight, fly, status, waypoint

ARENA = ((-10.0, -40.0, 0.0), (130.0, 40.0, 12.0))


def gate():
    detector = PhysicsGate(3.0, ARENA)
    detector.accept(status(30.0, 4), 0)
    detector.accept(waypoint([10, 0, 3], [1, 0, 0]), 0)
    return detector


@pytest.mark.parametrize(
    ("state", "field"),
    [
        (status(np.nan, 4), "perception.collision_status.time_to_collision"),
        (status(1e9, 4), "perception.collision_status.time_to_collision"),
        (status(30.0, 6), "perception.collision_status.future_collision_seq"),
        (waypoint([np.inf, 0, 3], [1, 0, 0]), "planning.waypoint.x"),
        (waypoint([10, 41, 3], [1, 0, 0], trajectory=2), "planning.waypoint.y"),
        (waypoint([14, 0, 3], [1, 0, 0]), "planning.waypoint.x"),
        (waypoint([10, 0, 3], [0, 0, 5]), "planning.waypoint.vz"),
        (waypoint([10, 0, 3], [1, 0, 0], yaw=7.0), "planning.waypoint.yaw"),
        (command([0, -1e300, 0]), "control.command.vy"),
        (command([0, 0, 0], np.nan), "control.command.yaw_rate"),
    ],
)
def test_what_cannot_be_is_an_alarm_for_its_stage(state, field):
    alarm = gate().check(state, 500_000)
    assert (alarm.source, alarm.fields, alarm.stage) == ("physics_gate", (field,), field.split(".")[0])


def free():
    state = status(30.0, 4)
    state.header["distance_to_blocked"] = np.inf  # nothing in the way
    return state


@pytest.mark.parametrize(
    "state",
    [
        free(),
        status(0.0, 4),
        status(30.0, 5),
        waypoint([11.5, 0, 3], [3, 0, 0]),
        waypoint([100, 0, 3], [3, 0, 0], trajectory=2),
        command([3, 2, 0], -9.0),
        new_state("planning.path"),
        new_state("sensor.odometry"),
    ],
)
def test_what_can_be_is_none(state):
    assert gate().check(state, 500_000) is None


def test_golden_flights_pass():
    assert fly(PhysicsGate(3.0), flight(600)) == []


def test_in_a_chain_the_first_alarm_counts_and_all_take_note():
    first, second = gate(), gate()
    chain = Chain(NoDetector(), first, second)
    assert chain.check(status(30.0, 9), 0).source == "physics_gate"
    chain.accept(status(30.0, 9), 0)
    assert chain.check(status(30.0, 10), 0) is None
    chain.start()
    assert chain.memory() == Chain(NoDetector(), PhysicsGate(3.0), PhysicsGate(3.0)).memory()
