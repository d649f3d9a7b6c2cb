"""The fault in the same instruction in other calls, as `mavfi shrink` tries it."""

from dataclasses import replace

import pytest

from mavfi.campaign.samplers.instruction import draw_instruction_faults, in_other_calls
from mavfi.campaign.samplers.smaller import elsewhere
from mavfi.faults.instruction import Resolving
from mavfi.faults.spec import InstructionRequest
from mavfi.hosts.host import ArmSetup
from mavfi.hosts.local import fly
from mavfi.hosts.local.forks import fly_instruction_faults
from mavfi.pipeline.functions import PLAIN
from tests.hosts.missions import mission

pytestmark = pytest.mark.slow


def test_other_calls_execute_the_same_instruction():
    scenario = mission()
    [fault] = draw_instruction_faults(scenario, InstructionRequest({"pid": 1}), seed=2).faults["pid"]
    found = in_other_calls(fault, ArmSetup(scenario), 4)
    calls = [one.call for one in found]
    assert len(found) == 4 and calls == sorted({*calls} - {fault.call})
    changed = [replace(one, call=fault.call, index=fault.index, budget=fault.budget) for one in found]
    assert changed == [fault] * 4
    places = {one.call: [one.index] for one in (fault, *found)}
    resolving = Resolving(getattr(PLAIN, fault.entry), places)
    golden = fly(scenario, functions=PLAIN.instrumented((fault.entry,), lambda *_: resolving))
    assert len(set(resolving.sites.values())) == 1 and len(resolving.sites) == 5
    flights = list(fly_instruction_faults(scenario, found, None, golden).flights)
    assert all(flight.log.injections[0].activated for flight in flights)
    assert elsewhere(fault, golden, 0, ArmSetup(scenario)) == []
