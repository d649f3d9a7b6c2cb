"""PX4 ULog and MAVLink telemetry logs hold the flight; independent readers say so."""

import numpy as np
import pytest

from mavfi.extras.logs.tlog import write_tlog
from mavfi.extras.logs.ulog import FAULT_TOPIC, write_ulog
from mavfi.extras.shared.frames import local
from mavfi.record import AlarmRecord, Event, Injection
from tests.extras.logs.conftest import make_log

SECONDS = 4.0


def noted_log():
    """A flight with a plan, one fault and one alarm."""
    log = make_log(0.0, SECONDS)
    log.events = [Event(0, "plan", {"vertices": 3})]
    log.injections = [Injection("state", "planning.waypoint.x", 2.0, 62, 1.5, 1e300, True)]
    log.alarms = [AlarmRecord(2.02, "gaussian", "planning.waypoint", "planning", 3.0, ("planning.waypoint.x",))]
    return log


def read_ulog(log, path):
    pyulog = pytest.importorskip("pyulog", reason="pyulog is not installed")
    count = write_ulog(log, path)
    found = pyulog.ULog(str(path))
    assert not found.has_data_appended and not found.file_corruption
    assert sum(len(d.data["timestamp"]) for d in found.data_list) + len(found.logged_messages) == count
    return found, {d.name: d.data for d in found.data_list}


def test_pyulog_reads_the_trajectory_in_ned(tmp_path):
    log = noted_log()
    found, data = read_ulog(log, tmp_path / "flight.ulg")
    position = data["vehicle_local_position"]
    assert np.array_equal(position["timestamp"], np.rint(1e6 * log.column("time")).astype(np.uint64))
    for name, column, sign in (("x", "x", 1), ("y", "y", -1), ("z", "z", -1), ("vy", "vy", -1), ("vz", "vz", -1)):
        assert np.array_equal(position[name], (sign * log.column(column)).astype(np.float32))
    attitude = data["vehicle_attitude"]
    assert np.array_equal(attitude["q[3]"], -log.column("qz").astype(np.float32))
    setpoint = data["trajectory_setpoint"]
    assert np.array_equal(setpoint["position[1]"], -log.column("reference_y").astype(np.float32))
    assert np.array_equal(setpoint["yawspeed"], -log.column("command_yaw_rate").astype(np.float32))
    assert found.msg_info_dict["sys_name"] == "mavfi" and found.msg_info_dict["mavfi_status"] == "success"


def test_pyulog_reads_fault_alarm_and_end(tmp_path):
    found, data = read_ulog(noted_log(), tmp_path / "flight.ulg")
    texts = [(message.log_level_str(), message.timestamp, message.message) for message in found.logged_messages]
    assert texts == [
        ("INFO", 0, "plan vertices=3"),
        ("ERROR", 2_000_000, "fault: planning.waypoint.x bit 62: 1.5 -> 1e+300"),
        ("WARNING", 2_020_000, "alarm: gaussian planning.waypoint, recompute, replaced"),
        ("INFO", 3_980_000, "success: Reached the goal."),
    ]
    assert data[FAULT_TOPIC]["timestamp"].tolist() == [0, 2_000_000] and data[FAULT_TOPIC]["active"].tolist() == [0, 1]


def read_tlog(log, path):
    mavutil = pytest.importorskip("pymavlink.mavutil", reason="pymavlink (extra logs) is not installed")
    count = write_tlog(log, path)
    link, found = mavutil.mavlink_connection(str(path)), []
    while (message := link.recv_match()) is not None:
        found.append(message)
    link.close()
    assert len(found) == count and not any(m.get_type() == "BAD_DATA" for m in found)
    return found


def test_pymavlink_reads_every_message(tmp_path):
    log = noted_log()
    found = read_tlog(log, tmp_path / "flight.tlog")
    positions = [m for m in found if m.get_type() == "LOCAL_POSITION_NED"]
    read = np.array([(m.x, m.y, m.z, m.vx, m.vy, m.vz) for m in positions])
    wanted = log.columns("x", "y", "z", "vx", "vy", "vz") * [1, -1, -1, 1, -1, -1]
    assert np.array_equal(read, wanted.astype(np.float32))
    assert [m._timestamp for m in positions] == pytest.approx(log.column("time"), abs=1e-9)
    yaw = [m.yaw for m in found if m.get_type() == "ATTITUDE"]
    np.testing.assert_allclose(np.unwrap(yaw), -0.6 * log.column("time"), atol=1e-6)
    last = [m for m in found if m.get_type() == "GLOBAL_POSITION_INT"][-1]
    north, east, down = local(1e-7 * last.lat, 1e-7 * last.lon, 1e-3 * last.alt)
    np.testing.assert_allclose((north, east, down), wanted[-5, :3], atol=0.02)
    assert sum(m.get_type() == "HEARTBEAT" for m in found) == SECONDS


def test_numbers_that_are_not_finite_or_too_large_are_written(tmp_path):
    log = noted_log()
    log.rows[5, 1], log.rows[6, 4], log.rows[10, 2], log.rows[20, 7:11] = np.nan, 1e300, 1e30, np.nan
    _, data = read_ulog(log, tmp_path / "flight.ulg")
    assert np.isnan(data["vehicle_local_position"]["x"][5]) and np.isinf(data["vehicle_local_position"]["vx"][6])
    found = read_tlog(log, tmp_path / "flight.tlog")
    assert sum(m.get_type() == "GLOBAL_POSITION_INT" for m in found) == len(log.rows) / 5 - 2
