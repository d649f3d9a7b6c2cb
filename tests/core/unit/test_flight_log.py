import io
import json
import math

import numpy as np
import pytest

from mavfi.errors import BadInputError
from mavfi.mission import MissionStatus
from mavfi.record import COLUMNS, AlarmRecord, Event, FlightLog, Injection


def log(**changes):
    rows = np.random.default_rng(1).normal(size=(20, len(COLUMNS)))
    rows[3, 4] = np.nan
    data = {
        "rows": rows,
        "status": MissionStatus.SUCCESS,
        "events": [Event(5, "plan", {"vertices": 3})],
        "injections": [Injection("state", "control.command.vx", 1.0, 62, 1.0, "inf", activated=True)],
        "alarms": [AlarmRecord(1.0, "gaussian", "control.command", "control", fields=("control.command.vx",))],
        "meta": {"course_m": 3.5},
    }
    return FlightLog(**data | changes)


def test_a_saved_log_is_the_same_when_it_is_read(tmp_path):
    path = tmp_path / "flight.npz"
    first = log()
    first.save(path)
    again = FlightLog.load(path)
    assert again.rows.tobytes() == first.rows.tobytes()
    assert (again.status, again.events) == (first.status, first.events)
    assert (again.injections, again.alarms) == (first.injections, first.alarms)
    assert (again.meta, again.digest()) == (first.meta, first.digest())


def test_numpy_alone_reads_columns_by_name(tmp_path):
    first = log()
    first.save(tmp_path / "flight.npz")
    with np.load(tmp_path / "flight.npz") as file:
        np.testing.assert_array_equal(file["x"], first.column("x"))
        assert set(file.files) == {*COLUMNS, "record"}
        assert json.loads(str(file["record"]))["status"] == "SUCCESS"


def test_infinite_values_in_events_survive(tmp_path):
    path = tmp_path / "flight.npz"
    log(events=[Event(1, "collision_predicted", {"time_to_collision": math.inf})]).save(path)
    assert FlightLog.load(path).events[0].data["time_to_collision"] == math.inf


@pytest.mark.parametrize("column", COLUMNS)
def test_the_digest_covers_vehicle_and_command_bit_by_bit(column):
    first = log()
    rows = first.rows.copy()
    index = COLUMNS.index(column)
    rows[7, index] = np.nextafter(rows[7, index], np.inf)
    covered = not column.startswith("reference")
    assert (log(rows=rows).digest() != first.digest()) == covered


def test_the_digest_covers_the_status_and_nothing_else():
    first = log().digest()
    assert log(status=MissionStatus.TIMEOUT).digest() != first
    assert log(events=[], injections=[], alarms=[], meta={}).digest() == first


def damaged():
    buffer = io.BytesIO()
    np.savez_compressed(buffer, rows=np.zeros(3))
    array = io.BytesIO()
    np.save(array, np.zeros(3))
    whole = buffer.getvalue()
    return {
        "empty": b"",
        "text": b"hello",
        "truncated": whole[: len(whole) // 2],
        "foreign": whole,
        "array": array.getvalue(),
        "header only": b"PK\x03\x04",
    }


@pytest.mark.parametrize("kind", damaged())
def test_a_file_that_is_no_flight_log_is_refused_in_one_line(tmp_path, kind):
    path = tmp_path / "flight.npz"
    path.write_bytes(damaged()[kind])
    with pytest.raises(BadInputError, match="flight.npz: is not a flight log"):
        FlightLog.load(path)


def test_absent_files_and_folders_are_named(tmp_path):
    with pytest.raises(BadInputError, match="is not a flight log"):
        FlightLog.load(tmp_path / "gone.npz")
    with pytest.raises(BadInputError, match="cannot be written"):
        log().save(tmp_path / "no" / "such" / "folder.npz")
