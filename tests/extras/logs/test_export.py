"""Exported files hold the flight; independent readers say so."""

import csv

import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from mavfi.cli.commands import run
from mavfi.extras.logs.files import write_bag, write_csv, write_mcap
from mavfi.extras.logs.timeline import FIRST_STAMP_NS, PublishedStates, timeline
from mavfi.flight.compose import resolve
from mavfi.flight.mission_flights import fly_recorded
from mavfi.mission import MissionSpec
from mavfi.record import COLUMNS, FlightLog

pytestmark = pytest.mark.slow

TICKS = {"/clock", "/tf", "/odometry", "/command", "/reference"}
ONCE = {"/obstacles", "/goal", "/flown", "/golden"}
PUBLISHED = {"/points", "/map", "/path", "/trajectory"}
TOPICS = TICKS | ONCE | PUBLISHED | {"/log"}


@pytest.fixture(scope="module")
def recorded():
    return fly_recorded(resolve(MissionSpec(environment="sparse", seed=3, start=(2.0, 0.0, 3.0), goal=(9.0, 0.0, 3.0))))


@pytest.fixture(scope="module")
def flight(recorded):
    return recorded[0]


@pytest.fixture(scope="module")
def published(recorded):
    flight, seen = recorded
    return PublishedStates([(time_us, state) for state, time_us in seen], flight.pipeline["octomap"].grid)


@pytest.fixture(scope="module")
def bag(flight, published, tmp_path_factory):
    path = tmp_path_factory.mktemp("bag") / "flight.bag"
    return path, write_bag(timeline(flight.log, flight.world, published, flight.log), path)


@pytest.fixture(scope="module")
def mcap(flight, published, tmp_path_factory):
    path = tmp_path_factory.mktemp("mcap") / "flight.mcap"
    return path, write_mcap(timeline(flight.log, flight.world, published, flight.log), path)


def read_bag(path):
    store = get_typestore(Stores.ROS1_NOETIC)
    store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms\n", "tf2_msgs/msg/TFMessage"))
    with AnyReader([path], default_typestore=store) as reader:
        return [(c.topic, time, reader.deserialize(raw, c.msgtype)) for c, time, raw in reader.messages()]


def read_mcap(path):
    reading = pytest.importorskip("mcap_ros2.reader", reason="mcap-ros2-support is not installed")
    return [(m.channel.topic, m.log_time_ns, m.ros_msg) for m in reading.read_ros2_messages(str(path))]


@pytest.fixture(scope="module", params=["bag", "mcap"])
def messages(request):
    path, written = request.getfixturevalue(request.param)
    read_messages = read_bag(path) if request.param == "bag" else read_mcap(path)
    assert len(read_messages) == written
    return read_messages


def of(messages, topic):
    return [message for name, _, message in messages if name == topic]


def test_every_topic_is_there(messages):
    assert {topic for topic, _, _ in messages} == TOPICS


def test_stamps_are_the_flight_s_and_do_not_go_back(flight, messages):
    times = [time for _, time, _ in messages]
    assert times == sorted(times)
    stamps = [m.header.stamp.sec + 1e-9 * m.header.stamp.nanosec for m in of(messages, "/odometry")]
    np.testing.assert_allclose(stamps, np.maximum(flight.log.column("time"), 1e-9 * FIRST_STAMP_NS), atol=1e-10)


def test_publications_are_there_to_the_bit(published, messages):
    clouds = [state for _, state in published.states if state.spec.name == "perception.point_cloud"]
    read = of(messages, "/points")
    assert [bytes(m.data) for m in read] == [state.elements.tobytes() for state in clouds]
    assert {(m.width, m.point_step, tuple(f.name for f in m.fields)) for m in read} == {(3072, 12, ("x", "y", "z"))}
    plans = [state for _, state in published.states if state.spec.name == "planning.path"]
    for message, state in zip(of(messages, "/path"), plans, strict=True):
        points = [p.pose.position for p in message.poses]
        assert np.array_equal([(p.x, p.y, p.z) for p in points], np.array(state.elements.tolist()).reshape(-1, 3))


def test_the_map_has_the_obstacles_that_were_seen(flight, messages):
    """Every occupied voxel lies at an obstacle or the ground, within one diagonal of a voxel of 0.5 m."""
    last = of(messages, "/map")[-1]
    centres = np.frombuffer(bytes(last.data), np.float32).reshape(-1, 3)
    assert len(centres) == last.width > 100
    assert flight.world.clearance(centres.astype(float)).max() < 0.5 * 3**0.5


def test_the_vehicle_is_where_it_was_to_the_bit(flight, messages):
    flown = flight.log.columns("x", "y", "z", "qw", "qx", "qy", "qz", "wx", "wy", "wz")
    poses = [(m.pose.pose.position, m.pose.pose.orientation, m.twist.twist.angular) for m in of(messages, "/odometry")]
    read = [(p.x, p.y, p.z, q.w, q.x, q.y, q.z, w.x, w.y, w.z) for p, q, w in poses]
    assert np.array_equal(flown, np.array(read))
    transforms = [m.transforms[0].transform.translation for m in of(messages, "/tf")]
    assert np.array_equal(flown[:, :3], np.array([(t.x, t.y, t.z) for t in transforms]))


def test_velocity_is_in_the_frame_of_the_vehicle(flight, messages):
    """REP-103 and nav_msgs/Odometry: the twist is in the child frame; flying ahead is x."""
    twists = [m.twist.twist.linear for m in of(messages, "/odometry")]
    velocity = np.array([(v.x, v.y, v.z) for v in twists])
    np.testing.assert_allclose(
        np.linalg.norm(velocity, axis=1), np.linalg.norm(flight.log.columns("vx", "vy", "vz"), axis=1), atol=1e-12
    )
    assert np.median(velocity[:, 0]) > 0.9 * np.median(np.linalg.norm(velocity, axis=1))


def test_commands_and_reference(flight, messages):
    commands = [(m.twist.linear, m.twist.angular.z) for m in of(messages, "/command")]
    read = np.array([(v.x, v.y, v.z, yaw_rate) for v, yaw_rate in commands])
    wanted = flight.log.columns("command_vx", "command_vy", "command_vz", "command_yaw_rate")
    assert np.array_equal(wanted, read)
    points = np.array([(m.point.x, m.point.y, m.point.z) for m in of(messages, "/reference")])
    assert np.array_equal(flight.log.columns("reference_x", "reference_y", "reference_z"), points)


def test_the_log_tells_the_end(flight, messages):
    last = of(messages, "/log")[-1]
    assert last.name == "mission" and flight.log.status.label in last.msg


def test_a_table_gives_the_same_bits_back(flight, tmp_path):
    path = tmp_path / "flight.csv"
    assert write_csv(flight.log, path) == len(flight.log.rows)
    with path.open(newline="") as file:
        head, *rows = csv.reader(file)
    assert tuple(head) == COLUMNS
    assert np.array_equal(np.array(rows, float), flight.log.rows)


@pytest.mark.parametrize("ending", ["bag", "mcap", "ulg", "tlog", "csv"])
def test_the_command_writes_what_the_ending_says(flight, tmp_path, ending, capsys):
    saved = tmp_path / "flight.npz"
    flight.log.save(saved)
    to = tmp_path / f"out.{ending}"
    assert run(["export", str(saved), "--to", str(to)]) == 0
    assert to.stat().st_size > 10_000
    assert str(to) in capsys.readouterr().out.replace("\n", "")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["flight.npz", to.name]


def test_a_saved_flight_with_a_fault_is_flown_again_with_its_golden_run(tmp_path, capsys):
    saved, to = tmp_path / "flight.npz", tmp_path / "flight.bag"
    fault = "state:planning.waypoint.x:bit=62@10.0"
    assert run(["fly", "--seed", "3", "--fault", fault, "--detector", "gaussian", "--save", str(saved)]) == 0
    assert run(["export", str(saved), "--to", str(to)]) == 0
    assert capsys.readouterr().err == ""
    exported = read_bag(to)
    assert PUBLISHED <= {topic for topic, _, _ in exported}
    (golden,), (flown,) = of(exported, "/golden"), of(exported, "/flown")
    assert golden.poses[0].pose.position == flown.poses[0].pose.position
    names = [m.name for m in of(exported, "/log")]
    assert names[names.index("injection") + 1] == "alarm"


def test_a_flight_that_cannot_be_repeated_is_exported_without_publications(flight, tmp_path, capsys):
    saved, to = tmp_path / "flight.npz", tmp_path / "flight.bag"
    changed = FlightLog(flight.log.rows.copy(), flight.log.status, meta=flight.log.meta)
    changed.rows[5, 1] += 1e-9
    changed.save(saved)
    assert run(["export", str(saved), "--to", str(to)]) == 0
    err = capsys.readouterr().err
    assert "cannot be flown again (another flight resulted" in err and err.count("\n") == 1
    assert not PUBLISHED & {topic for topic, _, _ in read_bag(to)}


def test_a_saved_request_of_a_wrong_type_is_one_line(flight, tmp_path, capsys):
    saved = tmp_path / "flight.npz"
    meta = {**flight.log.meta, "request": {"mission": {"seed": 3}, "detector": None}}
    FlightLog(flight.log.rows, flight.log.status, meta=meta).save(saved)
    assert run(["export", str(saved), "--to", str(tmp_path / "flight.bag")]) == 0
    err = capsys.readouterr().err
    assert "cannot be flown again (request: key 'detector'" in err and err.count("\n") == 1


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["{}/flight.npz", "--to", "x.txt"], "--to: x.txt: allowed"),
        (["{}", "--to", "{}/x.bag"], "holds no campaign"),
        (["{}/flight.npz", "some-run", "--to", "{}/x.bag"], "not the folder of a campaign"),
        (["{}/absent.npz", "--to", "{}/x.bag"], "is not a flight log"),
        (["{}/flight.npz", "--to", "{}/absent/x.bag"], "cannot be written"),
    ],
)
def test_bad_input_is_one_line(flight, tmp_path, arguments, message, capsys):
    flight.log.save(tmp_path / "flight.npz")
    assert run(["export", *(text.format(tmp_path) for text in arguments)]) == 2
    err = capsys.readouterr().err
    assert message in err and err.count("\n") == 1
