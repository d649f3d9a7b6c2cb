"""Campaigns of a program: records of its runs, golden repeats, plans that resume."""

from dataclasses import replace
from pathlib import Path

import pytest

from mavfi.errors import BadInputError
from mavfi.extras.airsim import host as module
from mavfi.extras.airsim.boundary import Boundary, PassedCall
from mavfi.extras.airsim.config import ProgramConfig
from mavfi.extras.airsim.host import AirsimProgramHost, ProgramResult, record_of_program
from mavfi.flight.host import ArmSetup, find_host
from mavfi.levels.message.fault import MessageFault
from mavfi.mission import MissionSpec
from mavfi.outcomes import Effect, effect_of
from mavfi.record import Injection

BOX = Path(__file__).parents[3] / "examples" / "airsim" / "box.py"
PROGRAM = ProgramConfig(script=str(BOX))
HIT = Boundary(injection=Injection("message", "moveToZ.z", 1.0, 1, 0.0, 1.0, True))
ENDED = ProgramResult(
    "ended", "", False, "aa", 12.0, {"moveToZ": 1}, {}, "", Boundary(passed=[PassedCall("moveToZ", 8, 1)])
)


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
    assert runs.golden("").calls == (PassedCall("moveToZ", 8, 1),)
    ((index, outcome),) = runs.injected([("", MessageFault("moveToZ", "z", 1))])
    assert index == 0 and outcome.record().digest == "bb"
    with pytest.raises(BadInputError, match="2 error-free runs differ"):
        runs_of(monkeypatch, [ENDED, replace(ENDED, digest="bb")]).golden("")


def test_another_text_of_the_program_is_another_mission(tmp_path):
    script = tmp_path / "p.py"
    script.write_text("pass\n")
    host = find_host("airsim_program", ProgramConfig(script=str(script)))
    first = host.resolve(MissionSpec()).key()
    script.write_text("pass  # changed\n")
    assert host.resolve(MissionSpec()).key() != first
    with pytest.raises(BadInputError, match="allowed: with the key program"):
        find_host("airsim_program")
