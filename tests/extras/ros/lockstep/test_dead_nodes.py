"""Nodes that are killed: what each policy makes of the mission, bit for bit as in one process."""

import pytest

from mavfi.flight.compose import new_loop, resolve, watch
from mavfi.flight.decide import INLINE, RecoveryPolicy
from mavfi.flight.fly import fly as fly_here
from mavfi.flight.loop import Listener
from mavfi.flight.restarts import Restarts
from mavfi.mission import MissionSpec
from tests.core.flights.missions import Scripted
from tests.extras.ros.lockstep.flights import same, short, there
from tests.extras.ros.lockstep.needs import any_ros

ANSWERING_US = 2_920_000
"""The planner of this mission has begun to answer an alarm, and its path is not there yet."""
AWAY_US = 1_000_000
ESCALATING = RecoveryPolicy("inline", "kernel", "escalate", 0.6)


def alarming(policy):
    return MissionSpec(environment="dense", seed=6002, goal=(30.0, 0.0, 3.0), dead_node=policy)


def died_here(scenario, node, detector=None, recovery=INLINE):
    """The flight in one process whose node dies at that instant."""
    loop = new_loop(scenario)
    restarts = Restarts(loop, scenario.dead_node)
    watch(loop, detector, recovery)
    killer = Listener()
    killer.before_tick = lambda now: restarts.die(node, now, AWAY_US) if now == ANSWERING_US else None
    loop.listeners.append(killer)
    return loop.fly().log


def died_there(scenario, node, **options):
    return there(scenario, kills=((node, ANSWERING_US),), **options)


def same_but_for_notes(log, other):
    """As `same`, but on ROS the lives of nodes are events."""
    log.events = [event for event in log.events if not event.kind.startswith("node_")]
    same(log, other)


class TestFlights:
    pytestmark = [*any_ros, pytest.mark.slow]

    def test_a_planner_that_is_killed_at_its_answer_reads_back_and_saves_the_mission(self):
        """What it has to know comes from the world: the alarm, the way-point in force, the trajectory, the map."""
        assert died_here(resolve(alarming("fresh")), "planner").status.label == "timeout"
        scenario = resolve(alarming("readback"))
        log = died_there(scenario, "planner")
        assert log.status.label == "success"
        lives = [(event.kind, event.time_us) for event in log.events if event.kind.startswith("node_")]
        assert lives == [("node_lost", ANSWERING_US), ("node_back", ANSWERING_US + AWAY_US)]
        same_but_for_notes(log, died_here(scenario, "planner"))

    def test_a_mission_that_ends_with_its_node(self):
        scenario = resolve(alarming("end"))
        log = died_there(scenario, "octomap")
        assert log.status.label == "node_died"
        same_but_for_notes(log, died_here(scenario, "octomap"))

    def test_a_rule_that_is_broken_twice_restarts_the_memory_of_a_node(self):
        def watching():
            return Scripted("perception.collision_status", n=5, stage="perception", times=2, hard=True)

        log = there(short(), None, watching(), recovery=ESCALATING)
        same(log, fly_here(short(), None, watching(), recovery=ESCALATING).log)
        assert [alarm.outcome for alarm in log.alarms] == ["rejected", "restarted"]
