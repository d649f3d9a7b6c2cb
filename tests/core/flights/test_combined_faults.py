"""Several faults in one flight: each as alone, after its event, and each in the process in which it belongs."""

from dataclasses import replace

import pytest

import mavfi
from mavfi.campaign.config import Campaign
from mavfi.campaign.store import Store
from mavfi.faults.changes import parse_text
from mavfi.faults.combined import Start
from mavfi.faults.fault import FaultSite
from mavfi.flight.fly import fly
from mavfi.flight.from_take_off import fly_instruction_faults
from mavfi.flight.mission_flights import fly_recorded
from mavfi.levels.combined.fault import CombinedFault
from mavfi.levels.instruction.drawing import InstructionRequest, draw_instruction_faults
from mavfi.levels.memory.fault import MemoryFault
from mavfi.levels.message.fault import MessageFault
from mavfi.levels.sensor.fault import SensorFault
from mavfi.levels.state.fault import StateFault
from mavfi.pipeline.waypoints import SetpointGenerator
from tests.campaigns import run_campaign
from tests.core.flights.missions import GOAL, fault, golden, mission

pytestmark = pytest.mark.slow
LATE_S = 1e3
"""After the end of every flight (s)."""


def combined(*faults, **starts):
    """Several faults; `starts` by number, e.g. `f1`."""
    return CombinedFault(faults, tuple(starts.get(f"f{number}") for number in range(len(faults))))


def test_faults_are_injected_as_each_of_them_alone():
    speed = fault("control.command", "vx", 3.0, 52)
    never = fault("control.command", "vy", LATE_S, 52)
    alone = fly(mission(), speed).log
    for several in (combined(speed, never), combined(never, speed), combined(speed)):
        log = fly(mission(), several).log
        assert log.digest() == alone.digest() != golden().log.digest()
        assert [injection for injection in log.injections if injection.activated] == alone.injections
        assert len(log.injections) == len(several.faults)


def test_the_second_fault_receives_what_the_first_one_leaves():
    speed = fault("control.command", "vx", 3.0, 51)
    log = fly(mission(), combined(speed, replace(speed, bit=50))).log
    first, second = log.injections
    assert second.before == first.after and first.time_s == second.time_s
    assert fly(mission(), combined(speed, speed)).log.digest() == golden().log.digest()


def test_a_fault_at_the_alarm_is_in_what_is_published_again():
    sign = fault("planning.waypoint", "x", 3.0, 62)
    both = combined(sign, replace(sign, where=FaultSite("planning.waypoint", "y")), f1=Start("alarm"))
    log = mavfi.fly(environment="dense", seed=1, goal=GOAL, detector="recommended", fault=both).log
    first, second = log.injections
    assert first.activated and second.activated
    assert second.time_s >= log.alarms[0].time_s == pytest.approx(first.time_s)
    assert len(log.alarms) == 2
    # Without an alarm it never comes.
    silent = fly(mission(), combined(sign, sign, f1=Start("alarm"))).log
    assert [injection.activated for injection in silent.injections] == [True, False]


@pytest.mark.parametrize(
    "later",
    [
        StateFault(FaultSite("control.command", "vy"), 0, 62),
        MemoryFault("pid", "waypoint.x", None, "f8", 0, 52),
        SensorFault("position", "off", 0, 0.5),
        MessageFault("control.command", change=parse_text("drop:times=5@0")),
    ],
    ids=lambda later: later.level,
)
def test_faults_of_all_levels_wait_for_an_injection(later):
    speed = fault("control.command", "vx", 3.0, 52)
    log = fly(mission(), combined(speed, later, f1=Start("injection", 1.0))).log
    first, second = log.injections
    assert second.activated and first.time_s + 1.0 <= second.time_s <= first.time_s + 1.6


def test_a_fault_in_memory_lasts_over_the_restart_of_its_node(monkeypatch):
    deaths = []

    def watch(kernel, time_us):
        if kernel.memory.now.epoch >= 1 << 20:
            deaths.append(time_us)
            raise ZeroDivisionError("of such a number")

    monkeypatch.setattr(SetpointGenerator, "_check_deviation", watch)
    kills = MemoryFault("waypoint", "now.epoch", None, "i4", 4_000_000, 20)
    fly(mission(), kills)
    assert len(deaths) == 1
    log = fly(mission(), replace(kills, lasts_s=1.5)).log
    assert len(deaths) > 2
    assert deaths[-1] <= 5_500_000 + 100_000
    assert log.injections[0].details["periods"] > 1


def test_a_stuck_bit_is_the_same_in_every_period_and_a_set_value_stays():
    stuck = MemoryFault("pid", "waypoint.x", None, "f8", 3_000_000, 62, lasts_s=0.5)
    held = replace(stuck, bit=None, lasts_s=0.0, change=parse_text("set=0:times=26"))
    for several in (stuck, held):
        log = fly(mission(), several).log
        (injection,) = log.injections
        assert injection.details["periods"] == 26
        assert log.digest() != golden().log.digest()


@pytest.fixture(scope="module")
def instruction_faults():
    """Faults in addresses of the planner, some of which kill it, and in any value of the tracker."""
    planner = draw_instruction_faults(mission(), InstructionRequest({"rrt_connect": 6}, "address"), seed=3)
    tracker = draw_instruction_faults(mission(), InstructionRequest({"pid": 2}), seed=3)
    return planner.faults["rrt_connect"] + tracker.faults["pid"]


def test_one_fault_in_an_instruction_is_as_in_a_flight_of_its_own(instruction_faults):
    never = fault("control.command", "vy", LATE_S, 52)
    flights = fly_instruction_faults(mission(), instruction_faults).flights
    ends = set()
    for single, flight in zip(instruction_faults, flights, strict=True):
        serial, published = fly_recorded(mission(), combined(single, never))
        ends.add(flight.log.kernel.effect)
        assert serial.log.digest() == flight.log.digest()
        assert serial.log.injections[-1].before == flight.log.injections[0].before
        assert serial.log.injections[-1].details["died"] == (flight.log.kernel.effect not in ("masked", "sdc"))
        assert published
    assert {"crash", "sdc"} <= ends | {"sdc"} and "crash" in ends


def test_a_node_dies_in_each_call_of_a_fault_that_lasts(instruction_faults):
    flights = fly_instruction_faults(mission(), instruction_faults).flights
    deadly = next(
        single
        for single, flight in zip(instruction_faults, flights, strict=True)
        if flight.log.kernel.effect == "crash"
    )
    log = fly_recorded(mission(), replace(deadly, times=3))[0].log
    (injection,) = log.injections
    assert injection.details["died"] and injection.details["calls"] >= 1
    assert log.digest() == fly_recorded(mission(), replace(deadly, times=3))[0].log.digest()


CAMPAIGN = {
    "name": "joint",
    "environments": ["dense"],
    "missions": 2,
    "faults": 4,
    "mission": {"goal": [22.0, -4.0, 3.0]},
    "sampling": {
        "level": "combined",
        "faults_per_mission": 3,
        "of": [{"level": "state"}, "memory:planner:bit=3@3"],
    },
}


@pytest.mark.long
def test_a_campaign_draws_several_faults_jointly_and_its_first_ones_as_without_the_others(tmp_path):
    several = Campaign.model_validate(CAMPAIGN)
    single = Campaign.model_validate({**CAMPAIGN, "sampling": {"level": "state"}, "null_runs": 0})
    for name, campaign in (("several", several), ("single", single)):
        run_campaign(campaign, tmp_path / name)
    with Store.open(tmp_path / "several") as store:
        drawn = [run.spec.fault for run in store.runs() if run.spec.fault is not None]
    with Store.open(tmp_path / "single") as store:
        alone = [run.spec.fault for run in store.runs() if run.spec.fault is not None]
    assert [fault.faults[0] for fault in drawn] == alone
    for fault_of_mission in drawn:
        first, second, third = fault_of_mission.faults
        assert first != third and first.level == third.level == "state"
        assert second.kernel == "planner" and second.time_us == 3_000_000
