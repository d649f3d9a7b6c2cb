"""Faults in instructions while a detector watches: it never sees them, and what it asks for heals what it can."""

from dataclasses import replace

import numpy as np
import pytest

from mavfi.faults.instruction import Counting
from mavfi.hosts.compose import make_scenario
from mavfi.hosts.inprocess import fly
from mavfi.hosts.instruction import StrikingHost, fly_struck
from mavfi.hosts.kernel_faults import Wish, draw_kernel_faults
from mavfi.pipeline.functions import PLAIN
from tests.hosts.missions import Scripted


def scenario():
    return make_scenario("sparse", 7, start=(2.0, 0.0, 3.0), goal=(9.0, 0.0, 3.0))


@pytest.fixture(scope="module")
def faults():
    return draw_kernel_faults(scenario(), Wish({"pid": 6, "octomap": 2}, which="data"), seed=3).faults


def outcomes(flights):
    return [(flight.log.digest(), flight.log.meta["kernel_outcome"], flight.log.injections) for flight in flights]


@pytest.mark.slow
def test_a_detector_that_never_alarms_changes_nothing(faults):
    both = [*faults["pid"], *faults["octomap"]]
    detector = Scripted("control.command", n=10**9)
    assert outcomes(fly_struck(scenario(), both, detector).flights) == outcomes(fly_struck(scenario(), both).flights)


def test_what_is_computed_again_is_without_the_fault(faults):
    """The alarm is at the struck command: the flight becomes the golden one of this detector."""
    alone = fly_struck(scenario(), faults["pid"])
    harmful = [
        fault
        for fault, flight in zip(faults["pid"], alone.flights, strict=True)
        if flight.log.digest() != alone.golden.log.digest()
    ]
    assert harmful, "else there is no proof"
    for fault in harmful[:3]:
        detector = Scripted("control.command", n=fault.instruction["call"] + 1)
        healed = fly_struck(scenario(), [fault], detector)
        (flight,) = healed.flights
        assert flight.log.injections[0]["hit"]
        assert [alarm["outcome"] for alarm in flight.log.alarms] == ["repaired"]
        assert [alarm["outcome"] for alarm in healed.golden.log.alarms] == ["accepted"]
        assert flight.log.digest() == healed.golden.log.digest()


@pytest.fixture(scope="module")
def counts():
    twin = Counting(PLAIN.insert_scan)
    fly(scenario(), functions=replace(PLAIN, insert_scan=twin))
    return twin.counts


@pytest.mark.slow
def test_a_call_that_is_too_short_is_passed_by_where_a_detector_may_have_shifted_calls(faults, counts):
    later = int(np.argmax(counts))
    assert later > 0, "the first scan is the longest one: nothing to pass by"
    index = max(counts[:later])
    fault = faults["octomap"][0]
    shifted = replace(fault, bit=0, instruction={**fault.instruction, "call": 0, "index": index, "bits": [0]})
    (watched,) = fly_struck(scenario(), [shifted], Scripted()).flights
    (record,) = watched.log.injections
    assert (record["hit"], record["call"]) == (True, later)
    (alone,) = fly_struck(scenario(), [shifted]).flights
    assert not alone.log.injections[0]["hit"]
    assert alone.log.meta["kernel_outcome"]["outcome"] == "masked"


def test_an_instruction_that_never_comes_is_not_hit(faults, counts):
    fault = faults["octomap"][0]
    beyond = {**fault.instruction, "call": len(counts) - 3, "index": 2 * max(counts)}
    flown = fly_struck(scenario(), [replace(fault, instruction=beyond)], Scripted())
    (flight,) = flown.flights
    assert not flight.log.injections[0]["hit"]
    assert flight.log.meta["kernel_outcome"]["outcome"] == "not_reached"
    assert flight.log.digest() == flown.golden.log.digest()


@pytest.mark.slow
@pytest.mark.parametrize("kernel", ["octomap", "collision_check"])
def test_a_node_that_is_there_again_can_be_asked_to_compute_again(kernel):
    wish = Wish({kernel: 2}, which="opcode:getelementptr", restart_s=0.2)
    drawn = draw_kernel_faults(scenario(), wish, seed=1).faults[kernel]
    struck = [replace(fault, bit=46, instruction={**fault.instruction, "bits": [46]}) for fault in drawn]
    flown = fly_struck(scenario(), struck, Scripted("perception.collision_status", 1, "perception", times=10**9))
    died = [flight.log for flight in flown.flights if "due_end" in flight.log.meta]
    assert died, "else nothing was started again"
    for log in died:
        times = np.array([alarm["time_s"] for alarm in log.alarms])
        assert (times > log.injections[0]["time_s"] + 0.2).any(), "no alarm after the restart"
        assert log.status.label == "success"


def test_a_recomputation_does_not_take_back_what_a_node_was_sent_when_it_started_again():
    host = StrikingHost(scenario(), [], Scripted())
    host.begin()
    host.run(until=150)
    host.restarted(host.now, "collision_check")
    kernel = host.kernels["collision_check"]
    cells = kernel.room.cells.copy()
    assert len(np.unique(cells)) > 1, "it knows the map"
    kernel.rollback()
    assert np.array_equal(kernel.room.cells, cells)
