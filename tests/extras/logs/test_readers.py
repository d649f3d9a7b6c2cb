"""Every format gives the numbers of the flight back; damaged files are refused in one line."""

import sqlite3
import struct
from contextlib import closing

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from mavfi.cli.commands import run
from mavfi.errors import BadInputError, MavfiError
from mavfi.extras.airsim.calls import RecordedCall, read_calls
from mavfi.extras.logs.bags import RosReader
from mavfi.extras.logs.dataflash import DataFlashReader
from mavfi.extras.logs.files import write_mcap
from mavfi.extras.logs.recording import read_recording
from mavfi.extras.logs.timeline import Message
from mavfi.extras.shared.log_readers import open_flight_log
from tests.extras.logs.conftest import make_log
from tests.extras.logs.dataflash import definitions, record, text_definitions

X = {
    "ulg": ("vehicle_local_position", "x"),
    "tlog": ("LOCAL_POSITION_NED", "x"),
    "csv": ("row", "x"),
    "jsonl": ("state(return)", "x"),
    "bag": ("/odometry", "pose.pose.position.x"),
    "mcap": ("/odometry", "pose.pose.position.x"),
}


def read(path, topic, field):
    messages = list(open_flight_log(path).messages([topic]))
    return [m.time_us for m in messages], [m.layout.locate(m.data, field).value(m.data) for m in messages], messages


@pytest.mark.parametrize("ending", X)
def test_numbers_and_times_are_those_of_the_flight(files, ending):
    topic, field = X[ending]
    times, values, messages = read(files(ending, "a"), topic, field)
    log = make_log(0.0)
    assert times == np.rint(1e6 * log.column("time")).astype(int).tolist()
    kind = np.float32 if ending in ("ulg", "tlog") else np.float64
    assert np.array_equal(np.array(values), log.column("x").astype(kind))
    assert messages[0].layout.check(field) == np.dtype(kind).name
    assert field in messages[0].layout.numbers(messages[0].data, 16)


@pytest.mark.parametrize("ending", X)
def test_a_topic_or_a_field_that_is_not_there_is_refused(files, ending):
    with pytest.raises(BadInputError, match="topic 'none': not known"):
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
        for position in random.integers(len(damaged), size=random.integers(1, 20)):
            damaged[position] ^= 1 << int(random.integers(8))
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
    readers = [open_flight_log(folder), open_flight_log(folder / "metadata.yaml"), RosReader(folder), RosReader(file)]
    for reader in readers:
        messages = list(reader.messages(["/height"]))
        assert [message.time_us for message in messages] == [0, 1, 2]
        assert [message.layout.locate(message.data, "data").value(message.data) for message in messages] == [0, 0.5, 1]


# ---- what users bring ------------------------------------------------------------------------------------------------
def test_a_column_without_a_name_is_left_out(tmp_path):
    path = tmp_path / "pandas.csv"
    path.write_text(",time,x\n0,0.0,1.5\n1,0.02,1.6\n")
    reader = open_flight_log(path)
    message = next(iter(reader.messages([])))
    assert list(message.layout.numbers(message.data, 16)) == ["x"]
    assert reader.notices == ["columns without numbers or a name: column 1"]


@pytest.mark.parametrize(
    ("head", "cells", "second_us"),
    [
        ("%time,field.x", ("1600000000000000000", "1600000000020000000"), 1600000000020000),
        ("TimeUS,Roll", ("1000000", "1020000"), 1020000),
        ("x,timestamp (us)", ("0", "20000"), 20000),
        ("header.stamp.sec,header.stamp.nanosec,x", ("5,0", "5,20000000"), 5020000),
        ("sep=;\r\ntime;x", ("0.0", "0.02"), 20000),
        ("date_time,x", ("2024-05-01T12:00:00", "2024-05-01T12:00:00.020"), 1714564800020000),
    ],
)
def test_columns_of_time_that_other_programs_write(tmp_path, head, cells, second_us):
    separator = next(mark for mark in ",;\t" if mark in head)
    rows = [f"{cell}{separator}1.5" for cell in cells]
    if head.startswith("x"):
        rows = [f"1.5{separator}{cell}" for cell in cells]
    path = tmp_path / "LOG.CSV"
    path.write_text("\n".join([head, *rows]), encoding="utf-8")
    messages = list(open_flight_log(path).messages([]))
    assert messages[1].time_us == second_us and len(messages[0].layout.numbers(messages[0].data, 16)) == 1


@pytest.mark.parametrize(
    ("period", "rows", "unit_us", "is_doubtful"),
    [
        (5, 400, 1_000_000, True),  # 33 minutes with a row each 5 s, not 2 s with a row each 5 ms
        (5, 12_000, 1000, False),
        (20, 200, 1000, True),
        (5000, 400, 1, True),
        (2, 20_000, 1000, True),  # 500 Hz for 40 s, in ms, us and ns: not some seconds a row for half a day
        (2000, 20_000, 1, True),
        (2_000_000, 20_000, 0.001, True),
        (1, 3600, 1_000_000, False),  # an hour at 1 Hz
        (1000, 3600, 1000, False),
    ],
)
def test_whole_times_without_a_unit_are_those_of_a_flight(tmp_path, period, rows, unit_us, is_doubtful):
    path = tmp_path / "x.csv"
    path.write_text("time,x\n" + "".join(f"{period * row},1.5\n" for row in range(rows)))
    recording = read_recording(path)
    assert recording.messages[1].time_us == period * unit_us
    assert (
        any("if wrong, put the unit in its name, like time_" in notice for notice in recording.notices) == is_doubtful
    )


def test_rows_that_go_back_in_time_and_gaps_are_named(tmp_path):
    path = tmp_path / "x.csv"
    times = [517, 502, 489, *range(33_900_000, 73_900_000, 2000)]
    path.write_text("loop,time,x\n" + "".join(f"{i},{time},{i % 7}\n" for i, time in enumerate(times)))
    recording = read_recording(path)
    assert recording.messages[0].time_us == 517 and recording.messages[-1].time_us == 73_898_000
    assert recording.notices == [
        "x.csv: time: taken for us (500 rows/s, 0.7 min); if wrong, put the unit in its name, like time_ms",
        "x.csv: time goes back in 2 of 20003 rows, first in line 3",
        "x.csv: gaps without rows, not counted as flight: 1; the longest 33.9 s from 0.000 s",
    ]


@pytest.mark.parametrize("name", ["log.bbl", "LOG0001.BFL"])
def test_raw_logs_of_a_flight_controller_name_their_decoder(tmp_path, name):
    with pytest.raises(BadInputError, match="allowed: the .csv that its decoder blackbox_decode writes"):
        read_recording(tmp_path / name)


def test_cells_without_a_number_are_nan_and_a_cut_row_is_left_out(tmp_path):
    path = tmp_path / "x.csv"
    path.write_text("time,a,mode,ok\n1,2.5,hover,true\n2,,hover,false\n3,4.5,land,true\n4,5.5,la")
    reader = open_flight_log(path)
    rows = [
        {name: m.layout.locate(m.data, name).value(m.data) for name in m.layout.numbers(m.data, 16)}
        for m in reader.messages([])
    ]
    assert [row["ok"] for row in rows] == [1.0, 0.0, 1.0] and np.isnan(rows[1]["a"]) and rows[2]["a"] == 4.5
    assert reader.is_cut() and reader.notices == ["columns without numbers or a name: mode"]


def test_rows_of_several_vehicles_are_told_apart(tmp_path):
    path = tmp_path / "x.csv"
    path.write_text("time,drone_id,x\n" + "".join(f"{n},{k},{k * n}\n" for n in range(5) for k in (1, 2)))
    assert {m.topic for m in read_recording(path).messages} == {"row[1]", "row[2]"}


def test_a_folder_of_tables_has_a_topic_for_each(tmp_path):
    folder = tmp_path / "flight"
    folder.mkdir()
    (folder / "log7_attitude_0.csv").write_text("timestamp,roll\n1000000,0.5\n1020000,0.6\n")
    (folder / "log7_position_0.csv").write_text("timestamp,x\n1010000,3.0\n1030000,4.0\n")
    (folder / "log7_parameters.csv").write_text("name,value\nA,1\n")
    recording = read_recording(folder)
    assert [(m.topic, m.time_us) for m in recording.messages] == [
        ("attitude_0", 1_000_000),
        ("position_0", 1_010_000),
        ("attitude_0", 1_020_000),
        ("position_0", 1_030_000),
    ]
    assert recording.notices == [
        "flight: parameters: not read, no column of time; allowed: a name like time, timestamp or t"
    ]


def write_mcap_file(path, channels):
    """An mcap file with one message of each (topic, schema's name, encoding, definition, message encoding, data)."""
    from mcap.writer import Writer as McapWriter

    with path.open("wb") as file:
        writer = McapWriter(file)
        writer.start()
        for topic, name, encoding, definition, message_encoding, data in channels:
            schema = writer.register_schema(name, encoding, definition.encode())
            channel = writer.register_channel(topic, message_encoding, schema)
            for number in range(3):
                writer.add_message(channel, 20_000_000 * number, data, 20_000_000 * number)
        writer.finish()


def test_a_definition_that_cannot_be_read_costs_only_its_topic(tmp_path):
    types = get_typestore(Stores.ROS2_HUMBLE)
    data = bytes(types.serialize_cdr(types.types["std_msgs/msg/Float64"](0.5), "std_msgs/msg/Float64"))
    path = tmp_path / "X.MCAP"
    channels = [
        ("/good", "std_msgs/msg/Float64", "ros2msg", "float64 data", "cdr", data),
        ("/lacking", "a_msgs/msg/A", "ros2msg", "b_msgs/B inner", "cdr", data),
        ("/damaged", "a_msgs/msg/C", "ros2msg", "float64 [[ x", "cdr", data),
        ("/other", "foxglove.Log", "protobuf", "\x00\x01", "protobuf", data),
        ("/ros1", "std_msgs/Float64", "ros1msg", "float64 data", "ros1", np.float64(0.5).tobytes()),
    ]
    write_mcap_file(path, channels)
    recording = read_recording(path)
    assert {(m.topic, m.layout.locate(m.data, "data").value(m.data)) for m in recording.messages} == {
        ("/good", 0.5),
        ("/ros1", 0.5),
    }
    assert len(recording.notices) == 3
    for notice, topic in zip(sorted(recording.notices), ("/damaged", "/lacking", "/other"), strict=True):
        assert notice.startswith(f"X.MCAP: {topic}: not read, ") and "\n" not in notice
    # a folder whose recorder ended before it wrote metadata.yaml, and a file that is cut
    folder = tmp_path / "bag"
    folder.mkdir()
    (folder / "bag_0.mcap").write_bytes(path.read_bytes())
    assert len(read_recording(folder).messages) == 6
    content = path.read_bytes()
    (folder / "bag_0.mcap").write_bytes(content[: content.rfind(b"/good")])
    assert read_recording(folder).cut


def test_transforms_and_frames_of_a_topic_are_told_apart(tmp_path):
    path = tmp_path / "x.mcap"
    rotation = {"rotation": {"w": 1.0}}

    def transform(child, x):
        return {"child_frame_id": child, "transform": {"translation": {"x": x}, **rotation}}

    messages = []
    for number in range(3):
        time_ns = 20_000_000 * (number + 1)
        children = [transform("base", 1.0), transform("arm", 2.0)]
        messages.append(Message("/tf", "tf2_msgs/TFMessage", time_ns, {"transforms": children[number % 2 :]}))
        for frame, x in (("map", 3.0), ("odom", 4.0)):
            point = {"header": {"frame_id": frame}, "point": {"x": x}}
            messages.append(Message("/at", "geometry_msgs/PointStamped", time_ns, point))
    write_mcap(messages, path)
    values = {}
    for message in read_recording(path).messages:
        name = next(name for name in message.layout.numbers(message.data, 16) if name.endswith("x"))
        values.setdefault(message.topic, set()).add(message.layout.locate(message.data, name).value(message.data))
    assert values == {"/tf[base]": {1.0}, "/tf[arm]": {2.0}, "/at": {3.0}, "/at[odom]": {4.0}}


def test_systems_components_and_instances_of_a_tlog_are_told_apart(tmp_path):
    mavlink = pytest.importorskip("pymavlink.dialects.v20.common")
    path = tmp_path / "X.TLOG"
    content = b""
    for number in range(3):
        for system, component in ((7, 1), (9, 1), (7, 191), (255, 190)):
            link = mavlink.MAVLink(None, srcSystem=system, srcComponent=component)
            attitude = mavlink.MAVLink_attitude_message(0, 0.1 * system, 0.0, 0.0, 0.0, 0.0, 0.0)
            battery = mavlink.MAVLink_battery_status_message(component % 2, 0, 0, 0, [0] * 10, 0, 0, 0, 0)
            for message in (attitude, battery):
                content += struct.pack(">Q", 20_000 * number) + message.pack(link)
    path.write_bytes(content)
    messages = read_recording(path).messages
    topics = {m.topic for m in messages}
    assert topics == {
        *("ATTITUDE", "ATTITUDE.9", "ATTITUDE.7.191"),
        *("BATTERY_STATUS[1]", "BATTERY_STATUS.9[1]", "BATTERY_STATUS.7.191[1]"),
    }
    (roll,) = {round(m.layout.locate(m.data, "roll").value(m.data), 3) for m in messages if m.topic == "ATTITUDE.9"}
    assert roll == 0.9 and messages[0].layout.units["roll"] == "rad"


@pytest.mark.parametrize("name", ["00000001.BIN", "x.log"])
def test_logs_of_ardupilot(tmp_path, name):
    pytest.importorskip("pymavlink")
    path = tmp_path / name
    rows = [(20_000 * n, 0, 0, 17_000 + n) for n in range(5)]
    if name.endswith("BIN"):
        records = [record("ATT", *row) + record("IMU", row[0], 1, 0.25, 0.0, 0.0) for row in rows]
        path.write_bytes(definitions() + b"".join(records))
    else:
        lines = [f"ATT, {t}, {r / 100}, {p / 100}, {y / 100}\nIMU, {t}, 1, 0.25, 0, 0" for t, r, p, y in rows]
        path.write_text("\n".join([*text_definitions(), *lines]) + "\n")
    messages = list(DataFlashReader(path).messages([]))
    assert {m.topic for m in messages} == {"ATT", "IMU[1]"}
    yaws = [m.layout.locate(m.data, "Yaw").value(m.data) for m in messages if m.topic == "ATT"]
    assert yaws == pytest.approx([170.0 + 0.01 * n for n in range(5)]) and messages[-1].time_us == 80_000
    assert messages[0].layout.units["Yaw"] == "degheading"
    path.write_bytes(b"\x00nothing" * 40)
    with pytest.raises(BadInputError, match="is not a log of ArduPilot that can be read"):
        list(DataFlashReader(path).messages([]))


@pytest.mark.parametrize(("landed", "flown"), [([1, 1], 0), ([1, 0], 50), ([0, 1], 50)])
def test_what_a_ulog_holds_on_the_ground_is_no_flight(tmp_path, landed, flown):
    pytest.importorskip("pyulog")
    path = tmp_path / "x.ulg"
    formats = {"vehicle_land_detected": "uint64_t timestamp;bool landed;", "a": "uint64_t timestamp;float x;"}
    parts = [b"ULog\x01\x12\x35\x01" + bytes(8), ulog_message("B", bytes(40))]
    parts += [ulog_message("F", f"{name}:{fields}".encode()) for name, fields in formats.items()]
    parts += [ulog_message("A", struct.pack("<BH", 0, n) + name.encode()) for n, name in enumerate(formats)]
    for number in range(100):
        if number % 50 == 0:
            parts.append(ulog_message("D", struct.pack("<HQ?", 0, 20_000 * number, landed[number // 50])))
        parts.append(ulog_message("D", struct.pack("<HQf", 1, 20_000 * number, 0.5)))
    path.write_bytes(b"".join(parts))
    recording = read_recording(path)
    assert len([m for m in recording.messages if m.topic == "a"]) == flown
    assert bool(recording.notices) == (flown == 0)
    if not flown:
        assert run(["watch", str(path), "--split", "0.5"]) == 2


def ulog_message(kind, body):
    return struct.pack("<HB", len(body), ord(kind)) + body
