import json
from dataclasses import replace

import numpy as np
import pytest

from mavfi.campaign.plan import RunSpec
from mavfi.campaign.worker import MOST_ALARMS, Task, plain, record_of, run_task
from mavfi.faults.fault import Fault, FaultSite
from tests.unit.campaign import fakes
from tests.unit.campaign.fakes import FAKE, MODEL

SCENARIO = FAKE.make_scenario(
    "sparse", 10_000, stack="published", platform="i9-9940x", planner="rrt_connect", v_max=None
)
GOLDEN = RunSpec(1, "golden", "sparse", 10_000, "key")
FAULT = Fault("state", FaultSite("planning.waypoint", "x"), 4_000_000, 62)
INJECTED = RunSpec(2, "fi", "sparse", 10_000, "key", "planning", 0, FAULT)
RECOVERED = replace(INJECTED, setting="dr_g", arm="g", detector="fake", profile="paper", model=MODEL)


def test_golden_run():
    result = run_task(Task(GOLDEN, SCENARIO, FAKE))
    record = result.record
    assert (record["end"], record["status"], record["success"]) == ("flown", "success", True)
    assert record["flight_time_s"] == pytest.approx(44)
    assert record["distance_m"] == pytest.approx(100)
    assert record["replans"] == 1
    assert record["events"] == {"plan": 2}
    assert record["meta"]["publications"]["planning.path"] == 12
    assert result.profile is not None
    assert result.wall_s > 0
    assert "wall" not in json.dumps(record)


def test_injected_run_proves_the_hit():
    result = run_task(Task(INJECTED, SCENARIO, FAKE))
    [injection] = result.record["injections"]
    assert injection["hit"]
    assert injection["site"] == "planning.waypoint.x"
    assert result.profile is None


def test_alarms_are_summed_up():
    record = run_task(Task(RECOVERED, SCENARIO, FAKE)).record
    assert record["alarms_total"] == len(record["alarms"]) == 1
    assert record["alarm_counts"] == {"fake/recompute/repaired": 1}
    log = fakes.fly(SCENARIO, FAULT, fakes.FakeDetector(), want_profile=False).log
    log.alarms = [{**log.alarms[0], "time_s": 0.1 * k, "score": float("inf")} for k in range(90)]
    record = record_of(log)
    assert log.injections[0]["time_s"] == 4.0
    kept = [round(alarm["time_s"], 6) for alarm in record["alarms"]]
    first = [0.1 * k for k in range(MOST_ALARMS)]
    assert kept == pytest.approx([*first, *(4 + 0.1 * k for k in range(11))]), "the first, and all after the fault"
    assert record["alarms_total"] == 90
    log.injections = []
    assert len(record_of(log)["alarms"]) == 90, "golden flights are what others are compared with"
    json.dumps(record, allow_nan=False)


def test_an_exception_of_ours_is_unknown_and_keeps_its_traceback(monkeypatch):
    monkeypatch.setattr(fakes.TROUBLE, "raises", 10_000)
    result = run_task(Task(INJECTED, SCENARIO, FAKE))
    assert result.record == {"end": "unknown", "error": "ZeroDivisionError"}
    assert "a mistake of ours" in result.note


def test_another_model_than_planned_is_not_flown_with():
    result = run_task(Task(replace(RECOVERED, model="another"), SCENARIO, FAKE))
    assert result.record["error"] == "SpecMismatchError"


def test_plain_data():
    data = {"a": np.float64(1.5), "b": np.array([1, 2]), "c": (float("nan"), np.bool_(True)), 3: None}
    assert plain(data) == {"a": 1.5, "b": [1, 2], "c": ["nan", True], "3": None}
