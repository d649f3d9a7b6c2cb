"""The scheme `recommended`: what a fault loses without it comes back, and nothing changes without a fault."""

import pytest

import mavfi
from mavfi.mission import MissionSpec, MissionStatus

pytestmark = pytest.mark.slow
DENSE = MissionSpec(environment="dense", seed=402)
LOST = ("collision:bit=0@3.4", "future_collision_seq:bit=31@3.4")


@pytest.mark.parametrize("fault", LOST)
def test_a_mission_that_an_unheard_alarm_loses_comes_back(fault):
    fault = f"state:perception.collision_status.{fault}"
    assert mavfi.fly(DENSE, fault=fault).log.status is MissionStatus.COLLISION
    saved = mavfi.fly(DENSE, fault=fault, detector="recommended").log
    assert saved.status is MissionStatus.SUCCESS
    assert [(alarm.source, alarm.action, alarm.outcome) for alarm in saved.alarms] == [
        ("acceptance", "recompute", "repaired")
    ]


@pytest.mark.parametrize("autopilot", ["published", "hardened"])
def test_without_a_fault_there_is_no_alarm_and_no_other_flight(autopilot):
    alone, watched = (
        mavfi.fly(DENSE, autopilot=autopilot, detector=detector).log for detector in (None, "recommended")
    )
    assert watched.alarms == [] and watched.status is MissionStatus.SUCCESS
    assert (watched.rows == alone.rows).all()
