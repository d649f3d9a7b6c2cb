"""Campaigns of a program: records of its runs, golden repeats, plans that resume."""

import importlib.util
from dataclasses import replace
from pathlib import Path

import pytest

from mavfi.campaign.config import Campaign
from mavfi.campaign.mission import MissionPlan, fly_mission
from mavfi.campaign.plan import CompletedRun
from mavfi.config import parse
from mavfi.errors import BadInputError
from mavfi.extras.airsim import host as module
from mavfi.extras.airsim.boundary import Boundary, Passed
from mavfi.extras.airsim.config import ProgramConfig
from mavfi.extras.airsim.host import AirsimProgramHost, Ended, record_of_program
from mavfi.faults.fault import MessageFault
from mavfi.flight.host import ArmSetup, find_host
from mavfi.mission import MissionSpec
from mavfi.outcomes import Effect, effect_of
from mavfi.record import End, Injection

BOX = Path(__file__).parents[3] / "examples" / "airsim" / "box.py"
PROGRAM = ProgramConfig(script=str(BOX))
HIT = Boundary(injection=Injection("message", "moveToZ.z", 1.0, 1, 0.0, 1.0, True))
ENDED = Ended("ended", "", False, "aa", 12.0, {"moveToZ": 1}, {}, "", Boundary(passed=[Passed("moveToZ", 8, 1)]))


@pytest.mark.parametrize(
    ("changes", "effect", "status"),
    [
        ({}, Effect.MASKED, "success"),
        ({"digest": "bb"}, Effect.SDC, "success"),
        ({"digest": "bb", "collided": True}, Effect.SDC, "collision"),
        ({"how": "program crash", "reason": "ValueError: no"}, Effect.EXCEPTION, ""),
        ({"how": "hang"}, Effect.HANG, ""),
        ({"how": "time is up"}, Effect.HANG, ""),
    ],
)
def test_the_record_of_a_run_has_its_effect(changes, effect, status):
    record = record_of_program(replace(ENDED, boundary=HIT, **changes), ENDED)
    assert effect_of(record_of_program(ENDED, ENDED), record) is effect
    assert record.status == status and record.injections == (HIT.injection,)


def test_a_program_that_never_ends_by_itself_does_not_hang_at_its_time_limit():
    endless = replace(ENDED, how="time is up")
    assert record_of_program(endless, endless).end is End.FLOWN


def test_a_program_that_crashes_without_a_fault_is_compared_with_that_crash():
    golden = replace(ENDED, how="program crash", code=1, reason="ValueError: no")
    assert record_of_program(golden, golden).end is End.FLOWN
    for changes, effect in (
        ({}, Effect.MASKED),
        ({"digest": "bb"}, Effect.SDC),
        ({"code": -11, "digest": "cc"}, Effect.EXCEPTION),
    ):
        record = record_of_program(replace(golden, boundary=HIT, **changes), golden)
        assert effect_of(record_of_program(golden, golden), record) is effect


def test_a_program_that_hangs_without_a_fault_is_refused(monkeypatch):
    hanging = replace(ENDED, how="hang", code=None, reason="still running after 2 s of wall-clock time")
    with pytest.raises(BadInputError, match="still running after 2 s of wall-clock time without a fault; allowed: "):
        runs_of(monkeypatch, [hanging, hanging]).golden("")


def runs_of(monkeypatch, results):
    left = iter(results)
    monkeypatch.setattr(module, "run_program", lambda program, spec, boundary: next(left))
    host = AirsimProgramHost(PROGRAM)
    return host.mission({"": ArmSetup(host.resolve(MissionSpec(seed=3)))})


def test_golden_runs_come_first_and_must_be_the_same(monkeypatch):
    runs = runs_of(monkeypatch, [ENDED, ENDED, replace(ENDED, boundary=HIT, digest="bb")])
    assert runs.golden("").passed == (Passed("moveToZ", 8, 1),)
    ((place, found),) = runs.injected([("", MessageFault("moveToZ", "z", 1))])
    assert place == 0 and found.record().digest == "bb"
    with pytest.raises(BadInputError, match="2 error-free runs differ"):
        runs_of(monkeypatch, [ENDED, replace(ENDED, digest="bb")]).golden("")


def test_a_replay_without_its_golden_run_knows_a_hang_all_the_same(monkeypatch):
    late = replace(ENDED, boundary=HIT, how="time is up")
    runs = runs_of(monkeypatch, [late, ENDED, ENDED])
    ((_, found),) = runs.injected([("", MessageFault("moveToZ", "z", 1))])
    assert found.record().kernel.effect == "hang"


def test_a_run_that_fails_ends_alone(monkeypatch):
    def failing(program, spec, boundary):
        raise RuntimeError("no memory")

    runs = runs_of(monkeypatch, [])
    monkeypatch.setattr(module, "run_program", failing)
    ((_, found),) = runs.injected([("", MessageFault("moveToZ", "z", 1))])
    assert isinstance(found, RuntimeError)


def test_another_text_of_the_program_is_another_mission(tmp_path):
    script = tmp_path / "p.py"
    script.write_text("pass\n")
    host = find_host("airsim_program", ProgramConfig(script=str(script)))
    first = host.resolve(MissionSpec()).key()
    script.write_text("pass  # changed\n")
    assert host.resolve(MissionSpec()).key() != first
    with pytest.raises(BadInputError, match="allowed: with the key program"):
        find_host("airsim_program")


@pytest.mark.slow
@pytest.mark.skipif(importlib.util.find_spec("cosysairsim") is None, reason="needs the package cosysairsim (extra dev)")
def test_a_campaign_of_a_program_resumes_where_it_stopped():
    program = {"script": str(BOX), "golden_runs": 1}
    own = {"host": "airsim_program", "sampling": {"level": "message"}, "name": "c", "program": program}
    campaign = parse(
        Campaign, {**own, "environments": ["sparse"], "missions": 1, "faults": 1, "null_runs": 1}, "c.yaml"
    )
    flown = [one for one in fly_mission(MissionPlan(campaign, "sparse", 10_000)) if isinstance(one, CompletedRun)]
    assert len(flown) == 4  # golden, one fault on each side, null
    done = frozenset(one.run_id for one in flown[:-1])
    rest = [
        one for one in fly_mission(MissionPlan(campaign, "sparse", 10_000, done=done)) if isinstance(one, CompletedRun)
    ]
    assert [(one.run_id, one.record) for one in rest] == [(one.run_id, one.record) for one in flown[-1:]]
