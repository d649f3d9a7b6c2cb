"""Instruction faults forked off checkpoints give the records of flights from take-off, bit for bit."""

from dataclasses import replace
from functools import cache

import pytest

from mavfi.faults.fault import NO_SITE
from mavfi.flight import from_checkpoints, mission_flights
from mavfi.flight.decide import INLINE, RecoveryPolicy
from mavfi.flight.fast_forward import FastForward
from mavfi.flight.fly import fly
from mavfi.flight.from_checkpoints import fly_from_checkpoints
from mavfi.flight.from_take_off import fly_instruction_faults
from mavfi.flight.host import ArmSetup
from mavfi.flight.known_flights import FlownArm
from mavfi.flight.loop import Loop
from mavfi.flight.mission_flights import LocalHost
from mavfi.levels.instruction.drawing import InstructionRequest, draw_instruction_faults
from mavfi.levels.instruction.fault import InstructionFault
from tests.core.flights.missions import FAR_GOAL, Scripted, mission
from tests.core.flights.test_checkpoints import Nervous, detector_of
from tests.night import at_night

KERNELS = ("point_cloud", "octomap", "collision_check", "rrt_connect", "pid")
ARMS = {"": lambda: None, "gaussian": lambda: detector_of("gaussian", "paper", mission()), "nervous": Nervous}
pytestmark = pytest.mark.slow


def autoencoder():
    return detector_of("autoencoder", "paper", mission())


def scenario(**options):
    return mission(**{"dead_node": "fresh", **options})


@cache
def drawn(which, seed, number=3, **options):
    request = InstructionRequest(dict.fromkeys(KERNELS, number), which, restart_s=0.3)
    drawn_faults = draw_instruction_faults(scenario(**options), request, "test", seed=seed)
    return [fault for faults in drawn_faults.faults.values() for fault in faults]


def records(flights):
    return [flight.record() for flight in flights]


def both_ways(faults, arm="", make=lambda: None, **options):
    """Records from checkpoints, and from take-off."""
    flown, detector = scenario(**options), make()
    golden = fly(flown, None, detector)
    forward = FastForward(flown, scratch=True)
    fast = records(fly_from_checkpoints(forward, faults, golden, FlownArm(arm, detector)).flights)
    return fast, records(fly_instruction_faults(flown, faults, detector, golden).flights)


@pytest.mark.parametrize(
    ("which", "arm"),
    [
        ("address", "gaussian"),
        *at_night(("all", ""), ("all", "gaussian"), ("address", ""), ("all", "nervous"), ("address", "nervous")),
    ],
)
def test_records_are_those_of_flights_from_take_off(which, arm):
    fast, slow = both_ways(drawn(which, 4), arm, ARMS[arm])
    assert fast == slow
    assert len({record.kernel.effect for record in slow}) >= 3


@pytest.mark.slow
@pytest.mark.long
def test_faults_in_a_flight_with_an_estimator_start_at_checkpoints_too():
    fast, slow = both_ways(drawn("all", 4, 1, localization="estimator"), localization="estimator")
    assert fast == slow
    assert len({record.kernel.effect for record in slow}) >= 2


@pytest.mark.parametrize("which", ["all", *at_night("address")])
def test_runs_with_detectors_that_follow_from_those_without_are_the_same(which):
    faults, flown, makers = drawn(which, 4), scenario(), {**ARMS, "autoencoder": autoencoder}
    del makers[""]
    forward, golden = (
        FastForward(flown, scratch=True),
        {name: fly(flown, None, make()) for name, make in makers.items()},
    )
    watched = [FlownArm(name, make()) for name, make in makers.items()]
    followed = fly_from_checkpoints(forward, faults, fly(flown), watched=watched).watched
    for name, make in makers.items():
        slow = records(fly_instruction_faults(flown, faults, make(), golden[name]).flights)
        assert {index: flight.record() for index, flight in followed[name].items()} == {
            n: slow[n] for n in followed[name]
        }
    assert len(followed["autoencoder"]) >= 0.8 * len(faults)
    assert any(flight.log.alarms for of_arm in followed.values() for flight in of_arm.values()) or which == "address"
    assert {flight.record().kernel.effect for flight in followed["autoencoder"].values()} >= {"masked", "sdc"}


def test_instructions_are_counted_and_resolved_in_the_flight_that_takes_checkpoints(monkeypatch):
    request = InstructionRequest(dict.fromkeys(KERNELS, 3), restart_s=0.3)
    alone = draw_instruction_faults(scenario(), request, "test", seed=4)
    flights = LocalHost().mission({"": ArmSetup(scenario())})
    monkeypatch.setattr(mission_flights, "fly", None)
    monkeypatch.setattr(Loop, "fly_until", None)
    shared = draw_instruction_faults(scenario(), request, "test", seed=4, flights=flights)
    assert (shared.faults, shared.counts) == (alone.faults, alone.counts)
    assert shared.golden.record() == alone.golden.record()


def test_what_earlier_scans_left_in_work_arrays_is_there_after_a_jump(monkeypatch):
    request = InstructionRequest({"octomap": 24}, "all", restart_s=0.3)
    drawn = draw_instruction_faults(scenario(goal=FAR_GOAL), request, "test", seed=4).faults["octomap"]
    reading = [drawn[8], drawn[17], drawn[20]]  # their wrong instructions read it
    fast, slow = both_ways(reading, goal=FAR_GOAL)
    assert fast == slow
    monkeypatch.setattr(from_checkpoints, "fill", lambda *_: None)
    assert both_ways(reading, goal=FAR_GOAL)[0] != slow


@pytest.mark.parametrize("policy", ["readback", *at_night("end")])
def test_nodes_that_die_come_back_as_after_a_flight_from_take_off(policy):
    dying = [fault for fault in drawn("address", 4) if fault.kernel in ("rrt_connect", "collision_check", "pid")]
    fast, slow = both_ways(dying, dead_node=policy)
    assert fast == slow
    assert "crash" in {record.kernel.effect for record in slow}


def test_a_fault_without_a_site_or_beyond_the_last_call_is_not_activated():
    faults = [InstructionFault("", "", 0, NO_SITE, kernel="pid"), replace(drawn("all", 4)[-1], call=10**6)]
    fast, slow = both_ways(faults)
    assert fast == slow
    assert [record.kernel.effect for record in fast] == ["not_activated"] * 2


@pytest.mark.parametrize("case", ["restarts", *at_night("octree", "rrt_star", "no fast-forward")])
def test_what_cannot_be_forwarded_is_flown_from_take_off(case, monkeypatch):
    monkeypatch.setattr(mission_flights, "fly_from_checkpoints", None)
    options = {"octree": {"map": "octree"}, "rrt_star": {"planner": "rrt_star"}}.get(case, {})
    watched = ArmSetup(scenario(**options), Scripted, RecoveryPolicy(answer_s=0.6) if case == "restarts" else INLINE)
    flights = LocalHost().mission({"arm": watched}, fast_forward=case != "no fast-forward")
    flights.count_instructions("arm", {})
    ((_, flight),) = flights.injected([("arm", drawn("all", 4, 1)[-1])])
    assert flight.log.injections
