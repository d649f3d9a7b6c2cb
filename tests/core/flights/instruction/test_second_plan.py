"""Calls from the second plan of a mission on, in golden flights with and without checkpoints."""

import numpy as np
import pytest

from mavfi.flight.compose import resolve
from mavfi.flight.fly import fly
from mavfi.flight.host import ArmSetup
from mavfi.flight.mission_flights import LocalHost
from mavfi.levels.instruction.drawing import InstructionRequest, draw_instruction_faults
from mavfi.levels.instruction.second_plan import SecondPlan
from mavfi.mission import MissionSpec
from mavfi.pipeline.functions import PLAIN


class CountedCalls:
    """A compiled function, called in its place; `order` has the names of all calls."""

    def __init__(self, name, order):
        self.name, self.order, self.counts = name, order, []

    def __call__(self, *args):
        self.counts.append(1)
        self.order.append(self.name)
        return getattr(PLAIN, self.name)(*args)


@pytest.fixture(scope="module")
def scenario():
    return resolve(MissionSpec(environment="dense", seed=10000))


@pytest.mark.parametrize("fast_forward", [False, True])
def test_the_first_call_is_that_of_the_second_plan(scenario, fast_forward):
    order = []
    counters = {name: CountedCalls(name, order) for name in ("track", "plan_rrt_connect")}
    second_plan = SecondPlan(counters)
    flights = LocalHost().mission({"": ArmSetup(scenario)}, fast_forward=fast_forward)
    golden = flights.count_instructions("", counters, [second_plan])
    plain = fly(scenario, profile=True)
    assert golden.log.digest() == plain.log.digest()
    first = second_plan.first_calls()
    # the path is published after the planner's latency, of less than 0.1 s
    commands = plain.profile.times_us["control.command"]
    path = plain.profile.times_us["planning.path"][1]
    assert np.sum(commands < path - 100_000) <= first["track"] <= np.sum(commands < path)
    # in the order of all calls, that of the planner follows, and its last one before was in the first plan
    plans = [index for index, name in enumerate(order) if name == "plan_rrt_connect"]
    tracked = [order[:index].count("track") for index in plans]
    assert tracked[first["plan_rrt_connect"]] == first["track"]
    assert tracked[first["plan_rrt_connect"] - 1] == tracked[0]


def test_faults_are_drawn_from_these_calls_and_have_no_site_without_a_second_plan():
    short = resolve(MissionSpec(environment="sparse", seed=7, start=(2.0, 0.0, 3.0), goal=(9.0, 0.0, 3.0)))
    drawn = draw_instruction_faults(short, InstructionRequest({"pid": 4}, when="second_plan"), seed=3)
    assert [fault.has_site for fault in drawn.faults["pid"]] == [False] * 4
