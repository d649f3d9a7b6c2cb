"""Fields of messages are found in their bytes; the oracle is rosbags, which decodes whole messages."""

import struct

import numpy as np
import pytest

from mavfi.errors import BadInputError, MavfiError
from mavfi.extras.logs.files import Maker
from mavfi.extras.logs.timeline import Message
from mavfi.extras.shared.message_definition import AbsentError, Definition, flip_bit, steps

MAKER = Maker(is_ros1=True)
STAMP = {"seq": 7, "stamp": {"sec": 5, "nanosec": 6}, "frame_id": "a frame"}
MESSAGES = {
    "sensor_msgs/JointState": {"header": STAMP, "name": ["one", "two"], "position": [0.5, -3.25], "effort": [1e300]},
    "nav_msgs/Odometry": {
        "header": STAMP,
        "child_frame_id": "body",
        "twist": {"twist": {"angular": {"z": -2.5}}},
        "pose": {"covariance": [float(number) for number in range(36)], "pose": {"position": {"x": 1.5}}},
    },
    "trajectory_msgs/MultiDOFJointTrajectory": {
        "header": STAMP,
        "joint_names": ["a", ""],
        "points": [
            {"transforms": [{"translation": {"x": 1.0}}, {"rotation": {"w": 1.0}}], "time_from_start": {"sec": -3}},
            {"velocities": [{"linear": {"y": 2.0}}], "time_from_start": {"nanosec": 9}},
        ],
    },
    "sensor_msgs/PointCloud2": {
        "header": STAMP,
        "height": 1,
        "width": 2,
        "fields": [{"name": "x", "offset": 4, "datatype": 7, "count": 1}],
        "is_bigendian": False,
        "point_step": 4,
        "row_step": 8,
        "data": [1, 2, 3, 255],
        "is_dense": True,
    },
    "diagnostic_msgs/DiagnosticArray": {"status": [{"level": 2, "values": [{"key": "k", "value": "v"}]}, {"level": 1}]},
}


def made(kind):
    """The definition of a type, and its message as on the wire."""
    text, _ = MAKER.store.generate_msgdef(MAKER.name(kind), ros_version=1)
    message = MAKER.make(Message("/topic", kind, 0, MESSAGES[kind]))
    return Definition(kind, text), bytes(MAKER.serialize(message, MAKER.name(kind)))


def oracle(kind, message, path):
    """What rosbags finds there."""
    decoded = MAKER.store.deserialize_ros1(message, MAKER.name(kind))
    for member, index in steps(path):
        member = {"secs": "sec", "nsecs": "nanosec"}.get(member, member)
        decoded = getattr(decoded, member)
        decoded = decoded if index is None else decoded[index]
    return decoded


@pytest.mark.parametrize("kind", MESSAGES)
def test_every_number_is_where_the_decoder_finds_it(kind):
    definition, message = made(kind)
    paths = definition.numbers(message, 64)
    assert paths
    for path in paths:
        assert definition.check(path)
        assert definition.locate(message, path).value(message) == oracle(kind, message, path), path


@pytest.mark.parametrize(
    ("kind", "path", "value"),
    [
        ("sensor_msgs/JointState", "position[1]", -3.25),
        ("sensor_msgs/JointState", "header.stamp.nsecs", 6),
        ("nav_msgs/Odometry", "pose.covariance[35]", 35.0),
        ("nav_msgs/Odometry", "twist.twist.angular.z", -2.5),
        ("trajectory_msgs/MultiDOFJointTrajectory", "points[1].velocities[0].linear.y", 2.0),
        ("trajectory_msgs/MultiDOFJointTrajectory", "points[0].time_from_start.secs", -3),
        ("sensor_msgs/PointCloud2", "data[3]", 255),
        ("sensor_msgs/PointCloud2", "is_dense", 1),
    ],
)
def test_a_flip_changes_one_bit_of_the_one_number(kind, path, value):
    definition, message = made(kind)
    leaf = definition.locate(message, path)
    assert leaf.value(message) == value
    for bit in range(leaf.bits):
        changed = flip_bit(message, leaf, bit)
        difference = int.from_bytes(message, "little") ^ int.from_bytes(changed, "little")
        assert difference == 1 << (8 * leaf.offset + bit)
        after = bool(leaf.value(changed)) if leaf.kind == "bool" else leaf.value(changed)
        assert oracle(kind, changed, path) == after or np.isnan(after)


def test_a_list_that_is_too_short_is_no_error_of_the_user():
    definition, message = made("sensor_msgs/JointState")
    assert definition.check("velocity[0]") == "float64"
    with pytest.raises(AbsentError, match="velocity has 0 elements"):
        definition.locate(message, "velocity[0]")


@pytest.mark.parametrize("size", [0, 3, 20, 40])
def test_bytes_of_another_type_are_refused(size):
    definition, message = made("nav_msgs/Odometry")
    with pytest.raises(MavfiError, match="too short"):
        definition.locate(message[:size], "twist.twist.angular.z")


@pytest.mark.parametrize(
    ("path", "message"),
    [
        ("", "allowed: names with dots"),
        ("position[-1]", "allowed: names with dots"),
        ("position.x", "is a list; allowed: position[0]"),
        ("position[0].x", "a float64 has no member 'x'"),
        ("header[0].seq", "is no list; allowed: header"),
        ("frame", "member of sensor_msgs/JointState 'frame': not known; allowed: "),
        ("name[0]", "is text; allowed: a number"),
        ("header.stamp", "is a time, no number; allowed: header.stamp.secs, header.stamp.nsecs"),
    ],
)
def test_a_path_that_leads_nowhere_is_refused_with_what_is_allowed(path, message):
    definition, _ = made("sensor_msgs/JointState")
    with pytest.raises(BadInputError) as error:
        definition.check(path)
    assert message in str(error.value)


def test_constants_and_comments_are_not_on_the_wire():
    text = (
        "uint8 KIND=3\nstring WORD=a # b\n# float64 none\nint16 x # metres\n\nfloat32[2] y\nOwn[] z\n"
        + 80 * "="
        + ("\nMSG: some_pkg/Own\nbool deep")
    )
    definition = Definition("some_pkg/Thing", text)
    data = struct.pack("<hffI??", -5, 1.5, 2.5, 2, True, False)
    assert definition.numbers(data, 9) == ["x", "y[0]", "y[1]", "z[0].deep", "z[1].deep"]
    assert definition.locate(data, "z[1].deep").value(data) == 0 and definition.locate(data, "y[1]").value(data) == 2.5


def test_a_definition_that_lacks_a_type_is_refused():
    with pytest.raises(BadInputError, match="lacks other_pkg/Gone"):
        Definition("some_pkg/Thing", "other_pkg/Gone gone")
