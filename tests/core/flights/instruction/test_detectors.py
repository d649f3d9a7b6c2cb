"""Faults in instructions while a detector watches: it never sees them, and what it asks for heals what it can."""

from dataclasses import replace

import numpy as np
import pytest

from mavfi.flight.compose import resolve
from mavfi.flight.decide import RecoveryPolicy
from mavfi.flight.fly import fly
from mavfi.flight.from_take_off import FromTakeOff, fly_instruction_faults
from mavfi.ir.injection.variant import Profiling
from mavfi.levels.instruction.drawing import InstructionRequest, draw_instruction_faults
from mavfi.mission import MissionSpec
from mavfi.pipeline.functions import PLAIN
from tests.core.flights.missions import Scripted


def scenario():
    return resolve(MissionSpec(environment="sparse", seed=7, start=(2.0, 0.0, 3.0), goal=(9.0, 0.0, 3.0)))


@pytest.fixture(scope="module")
def faults():
    return draw_instruction_faults(
        scenario(), InstructionRequest({"pid": 6, "octomap": 2}, which="data"), seed=3
    ).faults


def effects(flights):
    return [
        (flight.log.digest(), flight.log.kernel, [i.to_json() for i in flight.log.injections]) for flight in flights
    ]


@pytest.mark.slow
@pytest.mark.parametrize("coupling", ["inline", "observer"])
def test_a_detector_that_never_alarms_changes_nothing(faults, coupling):
    both = [*faults["pid"], *faults["octomap"]]
    detector = Scripted("control.command", n=10**9)
    watched = fly_instruction_faults(scenario(), both, detector, recovery=RecoveryPolicy(coupling)).flights
    assert effects(watched) == effects(fly_instruction_faults(scenario(), both).flights)


def test_what_is_computed_again_is_without_the_fault(faults):
    """The alarm is at the injected command: the flight becomes the golden one of this detector."""
    alone = fly_instruction_faults(scenario(), faults["pid"])
    harmful = [
        fault
        for fault, flight in zip(faults["pid"], alone.flights, strict=True)
        if flight.log.digest() != alone.golden.log.digest()
    ]
    assert harmful, "else there is no proof"
    for fault in harmful[:3]:
        detector = Scripted("control.command", n=fault.call + 1)
        healed = fly_instruction_faults(scenario(), [fault], detector)
        (flight,) = healed.flights
        assert flight.log.injections[0].activated
        assert [alarm.outcome for alarm in flight.log.alarms] == ["repaired"]
        assert [alarm.outcome for alarm in healed.golden.log.alarms] == ["accepted"]
        assert flight.log.digest() == healed.golden.log.digest()


@pytest.mark.slow
def test_an_observer_sees_the_fault_when_its_consumers_do(faults):
    """What it asks for comes one step later, so the command with the fault has been flown."""
    for fault in faults["pid"]:
        detector = Scripted("control.command", n=fault.call + 1)
        observed = fly_instruction_faults(scenario(), [fault], detector, recovery=RecoveryPolicy("observer"))
        (flight,) = observed.flights
        assert flight.log.injections[0].activated
        assert [alarm.action for alarm in flight.log.alarms] == ["recompute"]
        if flight.log.kernel.effect == "sdc" and flight.log.digest() != observed.golden.log.digest():
            return
    raise AssertionError("no fault reached the vehicle")


@pytest.fixture(scope="module")
def counts():
    counting = Profiling(PLAIN.insert_scan)
    fly(scenario(), functions=replace(PLAIN, insert_scan=counting))
    return counting.counts


@pytest.mark.slow
def test_a_call_that_is_too_short_is_passed_by_where_a_detector_may_have_shifted_calls(faults, counts):
    later = int(np.argmax(counts))
    assert later > 0, "the first scan is the longest one: nothing to pass by"
    index = max(counts[:later])
    fault = faults["octomap"][0]
    shifted = replace(fault, call=0, index=index, bits=(0,))
    (watched,) = fly_instruction_faults(scenario(), [shifted], Scripted()).flights
    (record,) = watched.log.injections
    assert (record.activated, record.details["call"]) == (True, later)
    (alone,) = fly_instruction_faults(scenario(), [shifted]).flights
    assert not alone.log.injections[0].activated
    assert alone.log.kernel.effect == "masked"


@pytest.mark.slow
@pytest.mark.parametrize("kernel", ["octomap", "collision_check"])
def test_a_node_that_is_there_again_can_be_asked_to_compute_again(kernel):
    wish = InstructionRequest({kernel: 2}, which="opcode:getelementptr", restart_s=0.2)
    drawn = draw_instruction_faults(scenario(), wish, seed=1).faults[kernel]
    injected = [replace(fault, bits=(46,)) for fault in drawn]
    flown = fly_instruction_faults(
        scenario(), injected, Scripted("perception.collision_status", 1, "perception", times=10**9)
    )
    died = [flight.log for flight in flown.flights if flight.log.kernel.effect in ("crash", "hang", "exception")]
    assert died, "else nothing was started again"
    for log in died:
        times = np.array([alarm.time_s for alarm in log.alarms])
        assert (times > log.injections[0].time_s + 0.2).any(), "no alarm after the restart"
        assert log.status.label == "success"


def test_a_recomputation_does_not_take_back_what_a_node_was_sent_when_it_started_again():
    loop = FromTakeOff(scenario(), [], Scripted()).loop
    loop.begin()
    loop.run(until=150)
    loop.restart(loop.now, "collision_check", "fresh")
    kernel = loop.kernels["collision_check"]
    cells = kernel.clearance_map.cells.copy()
    assert len(np.unique(cells)) > 1, "it knows the map"
    kernel.rollback()
    assert np.array_equal(kernel.clearance_map.cells, cells)
