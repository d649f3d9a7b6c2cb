import base64
import math

import numpy as np
import pytest

from mavfi.campaign.divergence import TimedState
from mavfi.mission import MissionStatus
from mavfi.record import AlarmRecord, Injection
from mavfi.report.html.flight_page import (
    MAX_VOXELS,
    SAMPLES,
    Course,
    course_data,
    flight_data,
    time_lines,
    world_data,
)
from mavfi.report.html.page import AFTER, BEFORE
from mavfi.states import new_state
from tests.core.unit.report.html.made import scene, straight


def rows_of(data):
    return np.frombuffer(base64.b64decode(data["rows"]), "<f4").reshape(data["n"], 5)


def test_a_path_is_thinned_and_keeps_both_ends():
    data = course_data(Course("golden", "golden run", straight()))
    rows = rows_of(data)
    assert len(rows) <= SAMPLES + 1
    assert rows[0, 0] == 0.0 and rows[-1, 0] == pytest.approx(59.98)
    assert rows[:, 4] == pytest.approx(5.0)  # speed
    assert data["success"] is True and data["end"] == 59.98


def test_rows_that_are_not_finite_are_left_out():
    broken = straight(100, MissionStatus.INVALID_STATE)
    broken.rows[50:, 1] = np.nan
    data = course_data(Course("injected", "with the fault", broken))
    assert np.isfinite(rows_of(data)).all() and rows_of(data)[-1, 0] == pytest.approx(0.98)
    assert (data["success"], data["status"]) == (False, "invalid state")


def test_fault_and_alarms_are_marked():
    injection = Injection("state", "planning.waypoint.x", 10.0, 62, 1.0, 2.0, activated=True)
    alarms = [AlarmRecord(time_s, "gaussian", "planning.waypoint", "planning") for time_s in (2.0, 10.5)]
    flown = straight(injections=[injection], alarms=alarms)
    data = flight_data([Course("golden", "", straight()), Course("injected", "", flown)], scene())
    assert data["fault"] == 10.0
    assert [alarm[:2] for alarm in data["paths"][1]["alarms"]] == [[2.0, 0], [10.5, 1]]


def test_of_a_scan_only_the_surface_near_the_path_is_sent():
    occupied = np.zeros((60, 60, 12), bool)
    occupied[10:15, 28:33, 3:8] = True  # 5 x 5 x 5, of which 3 x 3 x 3 are buried
    occupied[50, 59, 11] = True  # far away
    scan = scene(occupied=occupied, origin=np.array([0.0, -30, 0]), resolution=1.0)
    data = world_data(scan, [Course("golden", "", straight(900))])
    cells = np.frombuffer(base64.b64decode(data["voxels"]), "<i2").reshape(-1, 3)
    assert len(cells) == 125 - 27 <= MAX_VOXELS
    assert occupied[tuple(cells.T)].all() and data["edge"] == 1.0


AT = 5.0
SITE = "planning.waypoint.x"


def waypoints(change=lambda time_s: 0.0, period_us=20_000):
    states = []
    for time_us in range(0, 12_000_000, period_us):
        state = new_state("planning.waypoint")
        state.header["x"], state.header["y"] = 1e-6 * time_us + change(1e-6 * time_us), 2.0
        states.append(TimedState(time_us, state))
    return states


def test_the_injected_field_comes_first_then_what_differs():
    golden, injected = waypoints(), waypoints(lambda time_s: 3.0 if time_s >= AT else 0.0)
    for publication in injected:
        publication.state.header["vz"] = 1.0 if publication.time_us > 5_100_000 else 0.0
    lines = time_lines({"golden": golden, "injected": injected}, AT, SITE)
    assert [line["label"] for line in lines] == ["planning.waypoint.x", "planning.waypoint.vz"]
    assert [line["site"] for line in lines] == [True, False]
    assert lines[0]["unit"] == "m"


@pytest.mark.parametrize(
    ("wrong", "shown"),
    [
        ("planning.waypoint.y", ["planning.waypoint.y", "planning.waypoint.x"]),
        ("planning.waypoint.elements", ["planning.waypoint.x"]),
        ("planning.waypoint.", ["planning.waypoint.x"]),
    ],
)
def test_the_first_wrong_field_of_an_injected_kernel_comes_first(wrong, shown):
    injected = waypoints(lambda time_s: 3.0 if time_s >= AT else 0.0)
    lines = time_lines({"golden": waypoints(), "injected": injected}, AT, "pid.track", wrong)
    assert [(line["label"], line["site"]) for line in lines] == [(label, False) for label in shown]


def test_an_element_of_a_list_is_followed():
    def trajectories(value):
        state = new_state("planning.trajectory", 3)
        state.elements["x"][2] = value
        return [TimedState(5_000_000, state)]

    published = {"golden": trajectories(1.0), "injected": trajectories(9.0)}
    (line,) = time_lines(published, AT, "planning.trajectory.x[2]")
    assert line["label"] == "planning.trajectory.x[2]" and line["data"]["injected"] == [[5.0], [9.0]]


def test_only_the_surroundings_of_the_fault_are_kept():
    lines = time_lines({"golden": waypoints(), "injected": waypoints()}, AT, SITE)
    times, values = lines[0]["data"]["golden"]
    assert AT - BEFORE - 0.05 < times[0] <= AT - BEFORE and AT + AFTER - 0.05 < times[-1] <= AT + AFTER
    assert values == pytest.approx(times)


def test_values_that_are_not_finite_can_be_written_as_json():
    values = {5.0: math.nan, 5.02: math.inf}
    injected = waypoints(lambda time_s: values.get(round(time_s, 3), 0.0))
    _, seen = time_lines({"golden": waypoints(), "injected": injected}, AT, SITE)[0]["data"]["injected"]
    assert None in seen and 1e300 in seen
