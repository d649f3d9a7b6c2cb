import struct

import pytest
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_typestore

from mavfi.errors import BadInputError
from mavfi.flight.log_readers import open_flight_log


@pytest.fixture
def bag(tmp_path):
    store = get_typestore(Stores.ROS1_NOETIC)
    path = tmp_path / "flight.bag"
    with Writer(path) as writer:
        links = {topic: writer.add_connection(topic, "std_msgs/msg/Float64", typestore=store) for topic in ("/a", "/b")}
        for number in range(6):
            writer.write(links["/b" if number % 3 else "/a"], 1_000_000 * number, struct.pack("<d", 0.5 * number))
    return path


def test_messages_of_the_wanted_topics_come_in_their_order_with_what_they_hold(bag):
    found = list(open_flight_log(bag).messages(["/b"]))
    assert [(message.topic, message.time_us) for message in found] == [("/b", 1000 * number) for number in (1, 2, 4, 5)]
    first = found[0]
    assert (first.layout.kind, first.layout.numbers(first.data, 16)) == ("std_msgs/Float64", ["data"])
    assert [m.layout.locate(m.data, "data").value(m.data) for m in found] == [0.5, 1.0, 2.0, 2.5]
    assert all(message.layout == first.layout for message in open_flight_log(bag).messages(["/a", "/b"]))


def test_a_topic_that_is_not_there_is_refused(bag):
    with pytest.raises(BadInputError, match="holds no topic /c; allowed: /"):
        list(open_flight_log(bag).messages(["/c"]))


@pytest.mark.parametrize(
    ("name", "message"),
    [("x.bag", "is not a ROS 1 bag that can be read"), ("x.txt", "allowed: .bag"), ("x", "allowed")],
)
def test_what_is_no_flight_log_is_refused(tmp_path, name, message):
    (tmp_path / name).write_text("nothing")
    with pytest.raises(BadInputError, match=message):
        list(open_flight_log(tmp_path / name).messages(["/a"]))
