"""Faults drawn from a mission: of their class, the same twice, and injected where they were drawn."""

import json

import pytest

from mavfi.campaign.samplers.instruction import draw_instruction_faults
from mavfi.faults.fault import fault_from_json
from mavfi.faults.instruction import budget_for
from mavfi.faults.spec import InstructionRequest
from mavfi.hosts.instruction import fly_instruction_faults
from mavfi.hosts.loop.compose import resolve
from mavfi.mission import MissionSpec


def scenario():
    return resolve(MissionSpec(environment="sparse", seed=7, start=(2.0, 0.0, 3.0), goal=(9.0, 0.0, 3.0)))


def test_faults_are_of_their_class_and_model():
    request = InstructionRequest({"pid": 20}, which="floating_point", model="zero")
    drawn = draw_instruction_faults(scenario(), request, seed=3)
    assert len({(fault.call, fault.index) for fault in drawn.faults["pid"]}) > 15
    for fault in drawn.faults["pid"]:
        assert (fault.which, fault.masks, fault.weight) == ("floating_point", (0, 0), 1.0)
        assert (fault.kernel, fault.entry, fault.site) == ("pid", "track", "pid.track")
        assert fault.budget < budget_for(drawn.counts["pid"]["instructions"])
        assert fault_from_json(json.loads(json.dumps(fault.to_json()))) == fault
    for flight in fly_instruction_faults(scenario(), drawn.faults["pid"][:3], golden=drawn.golden).flights:
        (injection,) = flight.log.injections
        assert injection.after == 0 and injection.details["type"] in ("double", "float")


@pytest.mark.slow
def test_stratified_faults_are_injected_where_they_were_drawn():
    request = InstructionRequest({"pid": 10, "point_cloud": 3}, which="data", sampling="stratified")
    drawn = draw_instruction_faults(scenario(), request, seed=3)
    assert drawn.faults == draw_instruction_faults(scenario(), request, seed=3).faults
    faults = [*drawn.faults["pid"], *drawn.faults["point_cloud"]]
    assert [len(own) for own in drawn.faults.values()] == [10, 3]
    assert all(0.0 < fault.weight <= 2.0 for fault in faults) and len({fault.weight for fault in faults}) > 3
    injections = [flight.log.injections[0] for flight in fly_instruction_faults(scenario(), faults).flights]
    assert all(injection.activated for injection in injections)
    assert len({(injection.line, injection.details["value_class"]) for injection in injections[:10]}) > 6
