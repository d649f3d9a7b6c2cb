"""The scheme `recommended`: what a fault loses without it comes back, and nothing changes without a fault."""

import re

import pytest

import mavfi
from mavfi.cli import run
from mavfi.mission import MissionSpec, MissionStatus
from tests.core.architecture.source import ROOT
from tests.core.flights.missions import each_autopilot

pytestmark = pytest.mark.slow
DENSE = MissionSpec(environment="dense", seed=402)
TOUR = [
    "fly",
    "--environment",
    "dense",
    "--seed",
    "10007",
    "--fault",
    "state:perception.collision_status.collision",
    "--fault-seed",
    "1",
    "--detector",
    "recommended",
]
LOST = ("collision:bit=0@3.4", "future_collision_seq:bit=31@3.4")


@pytest.mark.parametrize("fault", LOST)
def test_a_mission_that_an_unheard_alarm_loses_comes_back(fault):
    fault = f"state:perception.collision_status.{fault}"
    result = mavfi.fly(DENSE, fault=fault, detector="recommended")
    assert result.unwatched.log.digest() == mavfi.fly(DENSE, fault=fault).log.digest()
    assert result.to_json()["without_detector"]["status"] == "collision"
    saved = result.log
    assert saved.status is MissionStatus.SUCCESS
    assert [(alarm.source, alarm.action, alarm.outcome) for alarm in saved.alarms] == [
        ("acceptance", "resend", "repaired")
    ]


def test_a_fault_that_strikes_the_copy_too_is_computed_again():
    log = mavfi.fly(
        DENSE, fault="state:perception.collision_status.collision:bit=0:times=2@3.4", detector="recommended"
    ).log
    assert log.status is MissionStatus.SUCCESS
    assert [(alarm.action, alarm.outcome) for alarm in log.alarms] == [
        ("resend", "rejected"),
        ("recompute", "repaired"),
    ]


@each_autopilot
def test_without_a_fault_there_is_no_alarm_and_no_other_flight(autopilot):
    alone, watched = (
        mavfi.fly(DENSE, autopilot=autopilot, detector=detector).log for detector in (None, "recommended")
    )
    assert watched.alarms == [] and watched.status is MissionStatus.SUCCESS
    assert (watched.rows == alone.rows).all()


def test_an_alarm_that_the_check_withdraws_restarts_no_planner():
    watched = mavfi.fly(environment="dense", seed=10_067, autopilot="hardened", detector="recommended").log
    assert watched.alarms == [] and watched.status is MissionStatus.SUCCESS


def test_the_tour_of_the_readme_tells_the_three_flights_apart(capsys, tmp_path):
    assert " ".join(TOUR) in (ROOT / "README.md").read_text(encoding="utf-8")
    picture = tmp_path / "flight.svg"
    assert run([*TOUR, "--picture", str(picture)]) == 0
    text = capsys.readouterr().out
    assert text.index("✓ Reached the goal.") < text.index("without the detector: ✗ Touched an obstacle")
    drawn = picture.read_text(encoding="utf-8")
    for label in ("golden run", "with the fault", "with the fault and detector recommended", "alarm at the fault"):
        assert f"<!-- {label} -->" in drawn
    ends = r"<!-- golden run: goal at (\S+) s · with the fault: collision at \S+ s · with the fault and detector "
    assert re.search(ends + r"recommended: goal at \1 s -->", drawn), "the title"
