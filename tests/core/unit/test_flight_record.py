import json
import math
from dataclasses import fields, replace

import numpy as np
import pytest

from mavfi.mission import MissionStatus
from mavfi.record import (
    AFTERMATH,
    COLUMNS,
    INSTANT,
    MOST_ALARMS,
    MOST_GOLDEN_ALARMS,
    AlarmRecord,
    End,
    EnergyTerms,
    Event,
    FlightLog,
    FlightRecord,
    Injection,
    KernelEffect,
    plain,
    record_of,
)

INJECTION = Injection("state", "planning.waypoint.x", 4.0, 62, 1.0, "inf", activated=True, details={"element": 3})
ALARM = AlarmRecord(4.1, "gaussian", "planning.waypoint", "planning", 3.5, ("planning.waypoint.x",), outcome="repaired")
FULL = FlightRecord(
    End.FLOWN,
    "success",
    "ab" * 32,
    44.0,
    99.5,
    EnergyTerms(44.0, 1, 2, 3, 4, 5, 6),
    100.0,
    150.0,
    (INJECTION,),
    (ALARM,),
    7,
    {"gaussian/recompute/repaired": 7},
    {"plan": 3},
    {"pid": 460},
    {"control": 289},
    {"planning.path": 2},
    {"planning.path": 1},
    2,
    KernelEffect("sdc", "", {"field": "vx"}),
    {"pid": {"instructions": 9, "calls": 1, "lines": [["pid.py", 3, 9]]}},
    {"outputs": [1, 2]},
    "",
)


def flight(**changes):
    rows = np.zeros((30, len(COLUMNS)))
    rows[:, 0] = np.linspace(0.0, 58.0, 30)
    rows[:, 1] = np.linspace(0.0, 100.0, 30)
    rows[:, 4] = 100.0 / 58.0
    meta = {
        "compute_us": {"pid": 460},
        "recompute_us": {"control": 0},
        "publications": {"planning.path": 2},
        "course_m": 100.0,
        "time_limit_s": 150.0,
        "rejected_commands": 1,
        "scenario": {"not": "kept"},
    }
    events = [Event(0, "plan"), Event(5, "plan"), Event(9, "stop")]
    return FlightLog(**{"rows": rows, "status": MissionStatus.SUCCESS, "events": events, "meta": meta, **changes})


def alarms(count, pitch=0.1):
    return [replace(ALARM, time_s=pitch * k, score=math.inf) for k in range(count)]


@pytest.mark.parametrize("name", [f.name for f in fields(FlightRecord) if f.name != "end"])
def test_every_field_is_kept_and_left_out_only_where_it_says_nothing(name):
    assert getattr(FULL, name) != getattr(FlightRecord(End.FLOWN), name) or name == "error"
    alone = replace(FlightRecord(End.FLOWN), **{name: getattr(FULL, name)})
    assert set(alone.to_json()) - {"end"} == ({name} if name != "error" else set())
    assert FlightRecord.from_json(alone.to_json()) == alone


def test_what_is_kept_of_a_flight():
    log = flight(injections=[INJECTION], kernel=FULL.kernel)
    record = record_of(log)
    assert (record.end, record.status, record.digest) == (End.FLOWN, "success", log.digest())
    assert record.flight_time_s == pytest.approx(58.0)
    assert record.distance_m == pytest.approx(100.0)
    assert (record.course_m, record.time_limit_s, record.rejected_commands) == (100.0, 150.0, 1)
    assert record.events == {"plan": 2, "stop": 1} and record.replans == 1
    assert record.compute_us == {"pid": 460} and record.publications == {"planning.path": 2}
    assert record.injections == (INJECTION,) and record.kernel == FULL.kernel
    assert record.flown and not FlightRecord(End.DUE).flown
    assert "not" not in json.dumps(record.to_json())


def test_the_first_alarms_are_kept_and_all_in_the_aftermath_of_an_injection():
    record = record_of(flight(injections=[INJECTION], alarms=alarms(90)))
    alarm_times = [round(alarm.time_s, 6) for alarm in record.alarms]
    first = [0.1 * k for k in range(MOST_ALARMS)]
    assert alarm_times == pytest.approx([*first, *(4 + 0.1 * k for k in range(11))])
    assert record.alarms_total == 90
    assert record.alarm_counts == {"gaussian/recompute/repaired": 90}
    json.dumps(record.to_json(), allow_nan=False)


@pytest.mark.parametrize(
    ("offset", "is_stored"),
    [(-2 * INSTANT, False), (-0.5 * INSTANT, True), (AFTERMATH, True), (AFTERMATH + 1e-3, False)],
)
def test_the_aftermath_starts_with_the_injection_and_has_an_end(offset, is_stored):
    early = [replace(ALARM, time_s=0.0)] * MOST_ALARMS
    record = record_of(flight(injections=[INJECTION], alarms=[*early, replace(ALARM, time_s=4.0 + offset)]))
    assert len(record.alarms) == MOST_ALARMS + is_stored


def test_an_injection_that_was_not_activated_has_no_aftermath():
    missed = replace(INJECTION, activated=False)
    assert len(record_of(flight(injections=[missed], alarms=alarms(90))).alarms) == MOST_ALARMS


def test_golden_flights_keep_what_others_are_compared_with():
    assert len(record_of(flight(alarms=alarms(90))).alarms) == 90
    record = record_of(flight(alarms=alarms(MOST_GOLDEN_ALARMS + 5)))
    assert (len(record.alarms), record.alarms_total) == (MOST_GOLDEN_ALARMS, MOST_GOLDEN_ALARMS + 5)


def test_plain_data():
    data = {"a": np.float64(1.5), "b": np.array([1, 2]), "c": (float("nan"), np.bool_(True)), 3: None}
    assert plain(data) == {"a": 1.5, "b": [1, 2], "c": ["nan", True], "3": None}
    assert plain([np.float32("inf"), -math.inf]) == ["inf", "-inf"]
