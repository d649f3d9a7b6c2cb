"""The story of a run, from records made by hand; the last test flies a run of a campaign again."""

import numpy as np
import pytest

from mavfi.campaign.divergence import Departure, FirstDifference
from mavfi.campaign.plan import RunSpec
from mavfi.campaign.replay import Explanation, explain
from mavfi.campaign.store import Store
from mavfi.faults.fault import NO_SITE, FaultSite
from mavfi.flight.host import Flight
from mavfi.levels.instruction.fault import InstructionFault
from mavfi.levels.state.fault import StateFault
from mavfi.mission import MissionStatus
from mavfi.record import COLUMNS, LIMITED, SILENCED, AlarmRecord, Event, FlightLog, Injection, KernelEffect
from mavfi.report.explain import alarm_lines, lines, to_json

SITE = FaultSite("planning.waypoint", "x")
FAULT = StateFault(SITE, 1_000_000, 62)
INJECTION = Injection("state", str(SITE), 1.0, 62, 3.5, float("inf"), activated=True)
FAILURE = Injection("sensor", "gyro stuck", 1.0, None, 0.1, 0.2, True, details={"model": "to the end"})
MISSED = Injection("state", str(SITE), 1.0, 62, None, None, activated=False)
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


def explained(injected, golden=None, fault=FAULT, first=None, **changes):
    spec = RunSpec("injected", "fi", "sparse", 3, "key", target="planning", fault=fault, **changes)
    flights = (Flight(one) for one in (injected, golden or log()))
    return Explanation(spec, *flights, same=True, first=first, departure=ON_PATH)


def story_of(explanation):
    return dict(lines(explanation))


@pytest.mark.parametrize(
    ("injected", "golden", "parts"),
    [
        (log(injections=[INJECTION]), log(), ("masked", "10.00 s, as without the fault")),
        (log(seconds=11.0, injections=[INJECTION]), log(), ("silent data corruption", "11.00 s", "+10.0 %")),
        (log(seconds=4.0, status=MissionStatus.COLLISION, injections=[INJECTION]), log(), ("lost: collision", "4.00")),
        (
            log(status=MissionStatus.COLLISION, injections=[INJECTION]),
            log(status=MissionStatus.TIMEOUT),
            ("fails without the fault, too", "timeout", "collision"),
        ),
    ],
)
def test_the_verdict_comes_first_with_effect_and_end_of_the_mission(injected, golden, parts):
    heading, sentence = lines(explained(injected, golden))[0]
    assert heading == "verdict" and all(part in sentence for part in parts)


def test_a_fault_says_what_it_changed_or_why_it_did_not():
    assert (
        story_of(explained(log(injections=[INJECTION])))["fault"]
        == "planning.waypoint.x, bit 62 (exponent), at 1.000 s: 3.5 → inf"
    )
    assert "not activated" in story_of(explained(log(injections=[MISSED])))["fault"]
    nowhere = StateFault(SITE, NO_SITE, 62)
    assert "no site" in story_of(explained(log(injections=[MISSED]), fault=nowhere))["fault"]


def test_a_fault_in_an_instruction_has_the_same_story_with_source_line_and_kernel():
    injection = Injection(
        "instruction", "pid.track", 2.5, 62, 1.0, -1.0, True, "mavfi/kernels/control/pid.py", 90, INSTRUCTION
    )
    first = {"state": "control.command", "field": "vx", "element": None, "before": 1.0, "after": 8.0}
    fault = InstructionFault("module:track", "0", 42, 7, kernel="pid", entry="track", stratum="exponent")
    story = story_of(explained(log(injections=[injection], kernel=KernelEffect("sdc", "", first)), fault=fault))
    for part in ("pid.py:90", "pid.py:12", "fmul double of rate", "call 7", "instruction 42"):
        assert part in story["source line"]
    assert "control.command.vx" in story["kernel"] and "first difference" not in story
    crashed = log(injections=[injection], kernel=KernelEffect("crash", "SIGSEGV"))
    for policy, what in (("fresh", "restarted"), ("readback", "(readback)"), ("end", "the mission ended")):
        crashed.meta["scenario"] = {"dead_node": policy}
        story = story_of(explained(crashed, fault=fault))
        assert story["verdict"].startswith("crash (SIGSEGV)") and what in story["kernel"]


@pytest.mark.parametrize(
    ("first", "parts"),
    [
        (
            FirstDifference("control.command", "vx", 5_000, 5_000, 2.749570000000001, 2.749570000000002),
            ("control.command.vx at 0.005 s", "2.749570000000001", "2.749570000000002"),
        ),
        (
            FirstDifference("planning.waypoint", "", 5_000, 9_000),
            ("planning.waypoint at 0.005 s", "held back", "4 ms later"),
        ),
        (FirstDifference("planning.path", "", None, 7_000), ("0.007 s", "here alone")),
    ],
)
def test_the_first_difference_is_a_value_or_an_instant(first, parts):
    sentence = story_of(explained(log(injections=[INJECTION]), first=first))["first difference"]
    assert all(part in sentence for part in parts)


@pytest.mark.parametrize("kind", [LIMITED, SILENCED])
def test_alarms_without_a_response_are_mentioned(kind):
    flight = log(alarms=[alarm(1.0)], events=[Event(1_000_000, kind, {"alarms": 7}), Event(2_000_000, "plan")])
    assert "no response" in alarm_lines(flight, None)[-1][1] and " 7 " in alarm_lines(flight, None)[-1][1]


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
