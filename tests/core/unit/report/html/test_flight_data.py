import base64

import numpy as np
import pytest

from mavfi.mission import MissionStatus
from mavfi.record import AlarmRecord, Injection
from mavfi.report.html.flight_page import MOST_VOXELS, SAMPLES, Course, course_data, flight_data, world_data
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
    assert len(cells) == 125 - 27 <= MOST_VOXELS
    assert occupied[tuple(cells.T)].all() and data["edge"] == 1.0
