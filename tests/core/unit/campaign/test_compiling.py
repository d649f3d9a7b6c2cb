"""Stages of a flight that are compiled in separate processes."""

from dataclasses import fields
from functools import partial

import numpy as np
import pytest

from mavfi.campaign import compiling
from mavfi.campaign.compiling import STAGES
from mavfi.flight.compose import new_loop, resolve
from mavfi.mission import MissionSpec
from mavfi.pipeline.functions import PLAIN

LATER = {"time_to_collision", "track", "shortcut_random"}
"""Short functions that need what a stage lacks: a flown trajectory, or a path with more than one way."""


def called(scenario, act, monkeypatch):
    """Names of the kernel functions that are called while `act` builds a loop of the scenario and runs it."""
    seen = set()

    def recorded(name, function):
        def call(*arguments):
            seen.add(name)
            return function(*arguments)

        return call

    names = tuple(field.name for field in fields(PLAIN))
    recording = partial(new_loop, functions=PLAIN.instrumented(names, recorded))
    monkeypatch.setattr("mavfi.campaign.compiling.new_loop", recording)
    with np.errstate(all="ignore"):
        act(scenario)
    return seen


@pytest.mark.parametrize("autopilot", ["published", "hardened"])
def test_the_stages_call_what_a_flight_calls(autopilot, monkeypatch):
    scenario = resolve(MissionSpec(environment="sparse", seed=7, autopilot=autopilot))
    by_stage = {name: called(scenario, stage, monkeypatch) for name, stage in STAGES.items()}
    assert (
        called(scenario, lambda mission: compiling.new_loop(mission).fly(), monkeypatch)
        - set().union(*by_stage.values())
        <= LATER
    )
    assert "plan_rrt_connect" in by_stage["plan_path"] and "insert_scan" in by_stage["see"]
    assert "insert_scan" not in by_stage["plan_path"] | by_stage["follow_path"]
