"""A planner that dies while it answers an alarm: what each policy makes of the mission."""

from functools import cache

import pytest

from mavfi.hosts.local import fly
from mavfi.hosts.loop.assemble import new_loop
from mavfi.hosts.loop.compose import resolve
from mavfi.hosts.loop.restarts import TAKE_OVER_US, Restarts
from mavfi.mission import MissionSpec
from tests.hosts.missions import AUTOPILOTS, golden, mission

AWAY_US = 570_000
UNHEARD, REFUSED = (6002, 1), (6005, 2)
"""Missions, and the alarm at whose answer the planner dies: the first one, which nobody repeats; one after which a
planner that begins to count at 0 is refused."""


@cache
def died(policy, seed, place):
    """The log of a flight whose planner dies at its answer to the alarm of that place."""
    scenario = resolve(MissionSpec(environment="dense", seed=seed, dead_node=policy))
    loop = new_loop(scenario)
    restarts = Restarts(loop, scenario.dead_node)
    numbers = [0]

    def stepped(kernel, states, now):
        if kernel.name == "planner" and int(states[0].header["future_collision_seq"][0]) > numbers[-1]:
            numbers.append(int(states[0].header["future_collision_seq"][0]))
            if len(numbers) == place + 1:
                restarts.die(kernel.name, now, AWAY_US, states)

    loop.after_step.append(stepped)
    return loop.fly().log


def duration(log):
    return log.column("time")[-1]


@pytest.mark.parametrize(("where", "status"), [(UNHEARD, "collision"), (REFUSED, "timeout")])
def test_a_fresh_planner_loses_the_mission(where, status):
    assert died("fresh", *where).status.label == status


@pytest.mark.parametrize("policy", ["latched", "readback", "recompute", "checkpoint", "standby"])
@pytest.mark.parametrize("where", [UNHEARD, REFUSED])
def test_a_planner_that_hears_the_alarm_again_saves_it(policy, where):
    assert died(policy, *where).status.label == "success"


def test_a_planner_that_continues_counting_is_not_late():
    assert duration(died("readback", *REFUSED)) < duration(died("latched", *REFUSED)) - 2.0


@pytest.mark.parametrize("where", [UNHEARD, REFUSED])
def test_a_planner_that_keeps_its_memory_answers_after_its_down_time(where):
    plans = {
        policy: [event.time_us for event in died(policy, *where).events if event.kind == "plan"]
        for policy in ("recompute", "standby", "checkpoint")
    }
    late = next(
        at for at, both in enumerate(zip(plans["recompute"], plans["standby"], strict=False)) if len(set(both)) > 1
    )
    first = plans["recompute"][late]
    assert (plans["standby"][late] - first, plans["checkpoint"][late] - first) == (TAKE_OVER_US, AWAY_US)


def test_a_repeated_step_is_charged_and_arrives_later():
    log, without = died("recompute", *REFUSED), died("fresh", *REFUSED)
    assert log.meta["recompute_us"]["planning"] > 0 == sum(without.meta["recompute_us"].values())


def test_a_mission_that_ends_with_its_node_ends_there():
    log = died("end", *REFUSED)
    assert log.status.label == "node_died"
    assert (log.rows == died("fresh", *REFUSED).rows[: len(log.rows)]).all()


@pytest.mark.parametrize("autopilot", AUTOPILOTS)
def test_a_golden_flight_with_repeated_alarms_is_the_same_flight(autopilot):
    flown, plain = fly(mission(autopilot, alarm="repeated")).log, golden(autopilot).log
    assert flown.digest() == plain.digest() and flown.meta["publications"] == plain.meta["publications"]
    rest, others = ([event for event in log.events if event.kind != "collision_predicted"] for log in (flown, plain))
    assert rest == others and flown.count("collision_predicted") >= plain.count("collision_predicted") > 0
