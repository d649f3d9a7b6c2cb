"""Faults drawn from a mission: of their class, the same twice, and injected where they were drawn."""

import json

from mavfi.faults.fault import fault_from_json
from mavfi.flight.compose import resolve
from mavfi.flight.forks import fly_instruction_faults
from mavfi.levels.instruction import budget_for
from mavfi.levels.instruction.drawing import InstructionRequest, draw_instruction_faults
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
