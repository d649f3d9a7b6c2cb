"""A planner that dies while it answers an alarm: what each policy makes of the mission."""

from functools import cache

import pytest

from mavfi.flight.compose import new_loop, resolve
from mavfi.flight.fly import fly
from mavfi.flight.loop import Listener
from mavfi.flight.restarts import Restarts
from mavfi.mission import MissionSpec
from tests.core.flights.missions import each_autopilot, golden, mission

AWAY_US = 570_000
UNHEARD, REFUSED = (6002, 1), (6005, 2)
"""Missions, and the alarm at whose answer the planner dies: the first one, which nobody repeats; one after which a
planner that begins to count at 0 is refused."""


@cache
def died(policy, seed, detector_place):
    """The log of a flight whose planner dies at its answer to the alarm of that place."""
    scenario = resolve(MissionSpec(environment="dense", seed=seed, dead_node=policy))
    loop = new_loop(scenario)
    restarts = Restarts(loop, scenario.dead_node)
    numbers = [0]

    def stepped(kernel, states, now):
        if kernel.name == "planner" and int(states[0].header["future_collision_seq"][0]) > numbers[-1]:
            numbers.append(int(states[0].header["future_collision_seq"][0]))
            if len(numbers) == detector_place + 1:
                restarts.die(kernel.name, now, AWAY_US)

    killer = Listener()
    killer.after_step = stepped
    loop.listeners.append(killer)
    return loop.fly().log


@pytest.mark.parametrize(("where", "status"), [(UNHEARD, "collision"), (REFUSED, "timeout")])
def test_a_fresh_planner_loses_the_mission(where, status):
    assert died("fresh", *where).status.label == status


@pytest.mark.parametrize("where", [UNHEARD, REFUSED])
def test_a_planner_that_hears_the_alarm_again_saves_it(where):
    assert died("readback", *where).status.label == "success"


def test_a_mission_that_ends_with_its_node_ends_there():
    log = died("end", *REFUSED)
    assert log.status.label == "node_died"
    assert (log.rows == died("fresh", *REFUSED).rows[: len(log.rows)]).all()


@each_autopilot
def test_a_golden_flight_with_repeated_alarms_is_the_same_flight(autopilot):
    flown, plain = fly(mission(autopilot, alarm="repeated")).log, golden(autopilot).log
    assert flown.digest() == plain.digest() and flown.meta["publications"] == plain.meta["publications"]
    rest, others = ([event for event in log.events if event.kind != "collision_predicted"] for log in (flown, plain))
    assert rest == others and flown.count("collision_predicted") >= plain.count("collision_predicted") > 0
