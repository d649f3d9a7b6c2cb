"""Stages of a flight that are compiled in separate processes."""

from dataclasses import fields

import numpy as np
import pytest

from mavfi.flight.compiling import STAGES
from mavfi.flight.compose import new_loop, resolve
from mavfi.mission import MissionSpec
from mavfi.pipeline.functions import PLAIN

LATER = {"time_to_collision", "track", "shortcut_random"}
"""Short functions that need what a stage lacks: a flown trajectory, or a path with more than one way."""


def called(scenario, act):
    """Names of the kernel functions that are called while `act` is applied to a new loop."""
    seen = set()

    def recorded(name, function):
        def call(*arguments):
            seen.add(name)
            return function(*arguments)

        return call

    names = tuple(field.name for field in fields(PLAIN))
    loop = new_loop(scenario, functions=PLAIN.instrumented(names, recorded))
    with np.errstate(all="ignore"):
        act(loop)
    return seen


@pytest.mark.parametrize("autopilot", ["published", "hardened"])
def test_the_stages_call_what_a_flight_calls(autopilot):
    scenario = resolve(MissionSpec(environment="sparse", seed=7, autopilot=autopilot))
    by_stage = {name: called(scenario, stage) for name, stage in STAGES.items()}
    assert called(scenario, lambda loop: loop.fly()) - set().union(*by_stage.values()) <= LATER
    assert "plan_rrt_connect" in by_stage["plan_path"] and "insert_scan" in by_stage["see"]
    assert "insert_scan" not in by_stage["plan_path"] | by_stage["follow_path"]
