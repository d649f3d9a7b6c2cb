"""Nodes that are started again: what they are sent, and what follows for the mission."""

from dataclasses import replace

import pytest

from mavfi.flight.compose import resolve
from mavfi.flight.from_take_off import fly_instruction_faults
from mavfi.levels.instruction.drawing import InstructionRequest, draw_instruction_faults
from mavfi.mission import MissionSpec

pytestmark = pytest.mark.slow

SEED = 500
"""A mission of Sparse in which the planner answers two predicted collisions."""


def spec(**changes):
    return resolve(MissionSpec(environment="sparse", seed=SEED, autopilot="published", **changes))


@pytest.fixture(scope="module")
def faults():
    """Faults in calls of the planner that answer a predicted collision."""
    wish = InstructionRequest({"rrt_connect": 40}, which="opcode:getelementptr", restart_s=0.57)
    faults = [
        replace(fault, bits=(46,))
        for fault in draw_instruction_faults(spec(), wish, seed=1).faults["rrt_connect"]
        if fault.call > 0
    ]
    return faults[:4]


def crashed(faults, policy):
    logs = [flight.log for flight in fly_instruction_faults(spec(dead_node=policy), faults).flights]
    return [log for log in logs if log.kernel.effect == "crash"]


@pytest.fixture(scope="module")
def died(faults):
    """Flights whose planner died while it answered a predicted collision."""
    return crashed(faults, "fresh")


def test_no_old_path_is_flown_again_after_a_restart(died):
    """Path and trajectory pass within the node; sent to it again, a path from the start would become a trajectory."""
    assert died
    for log in died:
        published = log.meta["publications"]
        assert published["planning.trajectory"] <= published["planning.path"]


def test_plans_of_a_fresh_planner_have_old_counters_and_are_refused(died):
    """What costs most of these missions, as in the published code: they refuse a sequence number below the last one."""
    hovering = [log for log in died if log.status.label == "timeout"]
    assert hovering
    for log in hovering:
        assert log.count("collision_predicted") > 0
        plans = [event.time_us for event in log.events if event.kind == "plan"]
        assert len(plans) > 10, "it plans, again and again, and none of its plans is flown"


@pytest.mark.parametrize(
    ("policy", "label"),
    [
        ("readback", "success"),
        ("end", "node_died"),
    ],
)
def test_other_policies_have_the_same_deaths_and_other_ends(faults, died, policy, label):
    logs = crashed(faults, policy)
    assert len(logs) == len(died) and {log.status.label for log in logs} == {label}
