"""Every format gives the numbers of the flight back; damaged files are refused in one line."""

import sqlite3
from contextlib import closing

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from mavfi.errors import BadInputError, MavfiError
from mavfi.extras.airsim.calls import RecordedCall, read_calls
from mavfi.extras.logs.table import RosReader
from mavfi.flight.log_readers import open_flight_log
from tests.extras.logs.conftest import make_log

X = {
    "ulg": ("vehicle_local_position", "x"),
    "tlog": ("LOCAL_POSITION_NED", "x"),
    "csv": ("row", "x"),
    "jsonl": ("state(return)", "x"),
    "bag": ("/odometry", "pose.pose.position.x"),
    "mcap": ("/odometry", "pose.pose.position.x"),
}


def read(path, topic, field):
    found = list(open_flight_log(path).messages([topic]))
    return [m.time_us for m in found], [m.layout.locate(m.data, field).value(m.data) for m in found], found


@pytest.mark.parametrize("ending", X)
def test_numbers_and_times_are_those_of_the_flight(files, ending):
    topic, field = X[ending]
    times, values, found = read(files(ending, "a"), topic, field)
    log = make_log(0.0)
    assert times == np.rint(1e6 * log.column("time")).astype(int).tolist()
    kind = np.float32 if ending in ("ulg", "tlog") else np.float64
    assert np.array_equal(np.array(values), log.column("x").astype(kind))
    assert found[0].layout.check(field) == np.dtype(kind).name
    assert field in found[0].layout.numbers(found[0].data, 16)


@pytest.mark.parametrize("ending", X)
def test_a_topic_or_a_field_that_is_not_there_is_refused(files, ending):
    with pytest.raises(BadInputError, match="holds no topic none; allowed: "):
        list(open_flight_log(files(ending, "a")).messages(["none"]))
    message = next(iter(open_flight_log(files(ending, "a")).messages([X[ending][0]])))
    with pytest.raises(BadInputError, match="allowed: "):
        message.layout.check("no_such_field")


@pytest.mark.parametrize("ending", [*X])
def test_what_is_no_log_is_refused(tmp_path, ending):
    if ending == "ulg":
        pytest.importorskip("pyulog")
    if ending == "tlog":
        pytest.importorskip("pymavlink")
    path = tmp_path / f"x.{ending}"
    path.write_bytes(b"\xff\xfenothing" * 20)
    with pytest.raises(BadInputError, match=f"x.{ending}"):
        list(open_flight_log(path).messages([]))


@pytest.mark.parametrize(
    ("head", "cell", "time_us"),
    [
        ("time", "2.5", 2_500_000),
        ("t [ms]", "2500", 2_500_000),
        ("#timestamp", "1403715524907143168", 1403715524907143),
        ("time (us)", "12", 12),
    ],
)
def test_times_of_tables(tmp_path, head, cell, time_us):
    path = tmp_path / "x.csv"
    path.write_text(f"{head}, x, name\n{cell},1.5,a\n")
    (message,) = open_flight_log(path).messages([])
    assert message.time_us == time_us and message.layout.numbers(message.data, 16) == ["x"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a,b\n1,2\n", "no column of time"),
        ("time,a\n1\n", "line 2: 1 values; allowed: 2"),
        ("time,a,a\n1,2,3\n", "columns"),
        ("time,a\n", "has no rows"),
        ("time,a\nx,2\n", "column time: is not a time"),
    ],
)
def test_tables_that_cannot_be_read(tmp_path, text, message):
    path = tmp_path / "x.csv"
    path.write_text(text)
    with pytest.raises(BadInputError, match=message):
        list(open_flight_log(path).messages([]))


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ('{"time_us": 1, "topic": "a"}', "line 2: is not a call .call: key 'numbers'"),
        ("", "line 2: is not a call"),
        ("[" * 100_000, "line 2"),
        ('{"time_us": 1, "topic": "a", "numbers": {"x": "far"}}', "line 2: .* 'far'"),
        ('{"time_us": 1, "topic": "a", "numbers": {}}', "one or more"),
    ],
)
def test_lines_that_are_no_calls(tmp_path, line, message):
    path = tmp_path / "x.jsonl"
    path.write_text(f"{RecordedCall(0, 'a', {'x': 1.0}).line()}{line}\n")
    with pytest.raises(BadInputError, match=message):
        read_calls(path)


@pytest.mark.parametrize("ending", X)
def test_damaged_files_are_read_or_refused_in_one_line_and_nothing_is_printed(files, tmp_path, ending, capfd):
    random, content = np.random.default_rng(7), files(ending, "a").read_bytes()[:40_000]
    path = tmp_path / f"x.{ending}"
    refused = 0
    for _ in range(25):
        damaged = bytearray(content)
        for place in random.integers(len(damaged), size=random.integers(1, 20)):
            damaged[place] ^= 1 << int(random.integers(8))
        path.write_bytes(damaged[: random.integers(len(damaged) // 2, len(damaged))])
        try:
            for message in open_flight_log(path).messages([]):
                assert message.layout.numbers(message.data, 16) is not None
        except MavfiError as error:
            refused += 1
            assert "\n" not in str(error)
    assert refused > 0 or ending == "tlog"  # whose damaged packets are skipped, by their checksums
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("is_humble", [False, True])
def test_recordings_of_rosbag2_are_read_with_and_without_definitions_of_their_messages(tmp_path, is_humble):
    types = get_typestore(Stores.ROS2_HUMBLE)
    kind = "std_msgs/msg/Float64"
    folder = tmp_path / "recording"
    with Writer(folder, version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        connection = writer.add_connection("/height", kind, typestore=types)
        for number in range(3):
            writer.write(connection, 1000 * number, types.serialize_cdr(types.types[kind](0.5 * number), kind))
    (file,) = folder.glob("*.db3")
    if is_humble:  # whose files have no definitions
        with closing(sqlite3.connect(file)) as database, database:
            database.execute("DROP TABLE message_definitions")
            database.execute("DROP TABLE schema")
    for reader in (open_flight_log(folder), RosReader(folder), RosReader(file)):
        messages = list(reader.messages(["/height"]))
        assert [message.time_us for message in messages] == [0, 1, 2]
        assert [message.layout.locate(message.data, "data").value(message.data) for message in messages] == [0, 0.5, 1]
