"""The story of a run, from records made by hand; the last tests fly runs of a campaign again."""

import numpy as np
import pytest

from mavfi.campaign.divergence import Departure, FirstDifference
from mavfi.campaign.plan import RunSpec
from mavfi.campaign.replay import Explanation, explain
from mavfi.campaign.store import Store
from mavfi.errors import BadInputError
from mavfi.faults.fault import NO_SITE, FaultSite, InstructionFault, StateFault
from mavfi.flight.host import Flight
from mavfi.mission import MissionStatus
from mavfi.record import COLUMNS, LIMITED, SILENCED, AlarmRecord, Event, FlightLog, Injection, KernelEffect
from mavfi.report.explain import MOST_ALARMS, alarm_lines, lines, to_json

SITE = FaultSite("planning.waypoint", "x")
FAULT = StateFault(SITE, 1_000_000, 62)
INJECTION = Injection("state", str(SITE), 1.0, 62, 3.5, float("inf"), activated=True)
ON_PATH = Departure(None, None, 0.0, 0.0, 0.0)
INSTRUCTION = {
    "kernel": "pid",
    "function": "track",
    "opcode": "fmul",
    "type": "double",
    "value_class": "floating_point",
    "variable": "rate",
    "inlined": ["mavfi/kernels/control/pid.py:12"],
    "call": 7,
    "index": 42,
    "model": "one_bit",
}


def log(*, seconds=10.0, status=MissionStatus.SUCCESS, **changes):
    rows = np.zeros((int(50 * seconds) + 1, len(COLUMNS)))
    rows[:, 0] = 0.02 * np.arange(len(rows))
    return FlightLog(rows, status, **changes)


def alarm(time_s, state="planning.waypoint", **changes):
    values = {"source": "gaussian", "stage": "planning", "score": 2.5, "fields": (f"{state}.x",)}
    return AlarmRecord(**({"time_s": time_s, "state": state} | values | changes))


def found(injected, golden=None, fault=FAULT, first=None, **changes):
    spec = RunSpec("injected", "fi", "sparse", 3, "key", target="planning", fault=fault, **changes)
    flights = (Flight(one) for one in (injected, golden or log()))
    return Explanation(spec, *flights, same=True, first=first, departure=ON_PATH)


def story_of(explanation):
    return dict(lines(explanation))


def test_the_verdict_comes_first_and_says_masked():
    heading, sentence = lines(found(log(injections=[INJECTION])))[0]
    assert heading == "verdict"
    assert sentence == (
        "masked: the flight is bit for bit the golden run; the mission succeeds after 10.00 s, as without the fault"
    )
    assert to_json(found(log(injections=[INJECTION])))["effect"] == "masked"


@pytest.mark.parametrize(
    ("injected", "golden", "verdict"),
    [
        (
            log(seconds=11.0, injections=[INJECTION]),
            log(),
            "silent data corruption; the mission succeeds after 11.00 s (+10.0 % against the golden run)",
        ),
        (
            log(seconds=4.0, status=MissionStatus.COLLISION, injections=[INJECTION]),
            log(),
            "silent data corruption; the mission is lost: collision after 4.00 s (golden run: success after 10.00 s)",
        ),
        (
            log(status=MissionStatus.COLLISION, injections=[INJECTION]),
            log(status=MissionStatus.TIMEOUT),
            "silent data corruption; the mission fails without the fault, too (timeout; with it collision)",
        ),
        (
            log(injections=[INJECTION]),
            log(status=MissionStatus.TIMEOUT),
            "silent data corruption; the mission succeeds after 10.00 s, which the golden run does not (timeout)",
        ),
    ],
)
def test_the_verdict_says_what_became_of_the_mission(injected, golden, verdict):
    assert story_of(found(injected, golden))["verdict"] == verdict


def test_a_fault_that_was_not_activated_is_no_masked_one():
    missed = Injection("state", str(SITE), 1.0, 62, None, None, activated=False)
    story = story_of(found(log(injections=[missed])))
    assert story["verdict"].startswith("not activated; the mission succeeds")
    assert story["fault"] == "planning.waypoint.x: not activated, no such publication came"
    nowhere = StateFault(SITE, NO_SITE, 62)
    assert (
        "no site, the golden run never published it"
        in story_of(found(log(injections=[missed]), fault=nowhere))["fault"]
    )


def test_a_fault_in_an_instruction_has_the_same_story_with_source_line_and_kernel():
    injection = Injection(
        "instruction", "pid.track", 2.5, 62, 1.0, -1.0, True, "mavfi/kernels/control/pid.py", 90, INSTRUCTION
    )
    first = {"state": "control.command", "field": "vx", "element": None, "before": 1.0, "after": 8.0}
    fault = InstructionFault("module:track", "0", 42, 7, kernel="pid", entry="track", stratum="exponent")
    story = story_of(found(log(injections=[injection], kernel=KernelEffect("sdc", "", first)), fault=fault))
    assert story["fault"] == "pid.track, bit 62 (exponent), at 2.500 s: 1 → -1"
    assert story["source line"] == (
        "mavfi/kernels/control/pid.py:90, inlined at mavfi/kernels/control/pid.py:12: fmul double of rate "
        "(floating point), call 7, instruction 42"
    )
    assert story["kernel"] == "pid: silent data corruption, first in control.command.vx: golden 1, here 8"
    assert "first difference" not in story
    crashed = log(injections=[injection], kernel=KernelEffect("crash", "SIGSEGV"))
    story = story_of(found(crashed, fault=fault))
    assert story["verdict"].startswith("crash (SIGSEGV) of a kernel, its node was restarted; the mission succeeds")
    assert story["kernel"] == "pid: crashed (SIGSEGV); its node was restarted"
    for policy, what in (("readback", "its node was restarted (readback)"), ("end", "the mission ended with it")):
        crashed.meta["scenario"] = {"dead_node": policy}
        assert story_of(found(crashed, fault=fault))["kernel"] == f"pid: crashed (SIGSEGV); {what}"


@pytest.mark.parametrize(
    ("first", "sentence"),
    [
        (None, "none: every published value is bit for bit that of the golden run"),
        (
            FirstDifference("control.command", "vx", 5_000, 5_000, 2.749570000000001, 2.749570000000002),
            "control.command.vx at 0.005 s: golden 2.749570000000001, here 2.749570000000002",
        ),
        (
            FirstDifference("planning.waypoint", "", 5_000, 9_000),
            "planning.waypoint at 0.005 s in the golden run: here held back, the same value came 4 ms later",
        ),
        (FirstDifference("planning.path", "", None, 7_000), "planning.path at 0.007 s: published here alone"),
        (
            FirstDifference("planning.path", "", 7_000, None),
            "planning.path at 0.007 s: published by the golden run alone",
        ),
    ],
)
def test_the_first_difference(first, sentence):
    assert story_of(found(log(injections=[INJECTION]), first=first))["first difference"] == sentence


def test_alarms_at_the_injection_come_before_earlier_ones_and_are_counted():
    early = [alarm(0.01 * place) for place in range(MOST_ALARMS + 2)]
    at_site = alarm(1.0, outcome="repaired")
    flight = log(injections=[INJECTION], alarms=[*early, at_site, alarm(2.5)])
    golden = log(alarms=early)
    heading, first, *_, last = alarm_lines(flight, golden)
    assert heading == ("alarms", "12 in all, 1 within 1 s of the injection, 10 also in the golden run")
    assert first[1] == "1.000 s, gaussian: planning.waypoint.x, score 2.5; recompute planning: repaired"
    assert last == ("", f"and {12 - MOST_ALARMS} more")
    assert alarm_lines(log(), golden) == []
    assert any("also in the golden run" in sentence for _, sentence in alarm_lines(flight, golden)[2:])


@pytest.mark.parametrize("kind", [LIMITED, SILENCED])
def test_alarms_without_a_response_are_mentioned(kind):
    flight = log(alarms=[alarm(1.0)], events=[Event(1_000_000, kind, {"alarms": 7}), Event(2_000_000, "plan")])
    heading, text = alarm_lines(flight, None)[-1]
    assert heading == "" and text.startswith("no response to further alarms") and " 7 " in text


def test_the_detector_is_named_with_its_profile_if_it_has_one():
    flight = log(injections=[INJECTION])
    story = story_of(found(flight, arm="gaussian", detector="gaussian", detector_profile="paper", model="sha"))
    assert story["run"].endswith("detector gaussian (paper)")
    assert story["golden run"].startswith("the same mission without the fault, with the detector on")
    assert story_of(found(flight, arm="idle", detector="own.module:Mine"))["run"].endswith("detector own.module:Mine")


@pytest.fixture(scope="module")
def injected(flown):
    with Store.open(flown) as store:
        return next(
            run.spec.run_id
            for run in store.runs()
            if run.spec.setting == "fi" and run.spec.target == "control" and run.spec.fault.has_site
        )


@pytest.mark.slow
def test_a_run_is_explained_from_the_fault_on(flown, injected):
    explanation = explain(flown, injected)
    assert explanation.same
    injection = explanation.flight.log.injections[0]
    assert f"{explanation.first.state}.{explanation.first.field}" == injection.site
    assert 1e-6 * explanation.first.time_us == pytest.approx(injection.time_s)
    headings = [heading for heading, _ in lines(explanation)]
    once = [heading for heading in dict.fromkeys(headings) if heading]
    assert once == ["verdict", "run", "fault", "first difference", "spread", "path", "alarms", "golden run", "end"]
    assert to_json(explanation)["first_difference"]["state"] == explanation.first.state


@pytest.mark.slow
def test_golden_runs_have_nothing_to_explain(flown):
    with pytest.raises(BadInputError, match="is a golden run; explain needs a run with a fault"):
        explain(flown, "sparse-10000-golden-")
