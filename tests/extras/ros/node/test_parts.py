"""What attaches to ROS, as far as it needs no ROS: headers, peers that talk to each other, probes."""

import threading
import time

import pytest

from mavfi.cli import run
from mavfi.errors import MavfiError
from mavfi.extras.ros.node.message import Composer
from mavfi.extras.ros.node.peer import Peer, TopicSource, decode_header, encode_header
from mavfi.extras.ros.ros2 import environment

COMPOSER = Composer("sensor_msgs/JointState")
MESSAGE = COMPOSER.pack({"name": ["a"], "position": [0.5]})


class NoMaster:
    """Takes registrations."""

    uri = "http://127.0.0.1:1/"

    def call(self, method, *arguments, caller=""):
        return []


@pytest.fixture
def peer():
    made = Peer(NoMaster(), "/writer")
    yield made
    made.close()


def test_headers_survive_the_wire():
    fields = {"type": "a/B", "message_definition": "x = y\nz", "empty": ""}
    encoded = encode_header(fields)
    assert decode_header(encoded[4:]) == fields and int.from_bytes(encoded[:4], "little") == len(encoded) - 4


def test_a_peer_is_read_like_a_node_and_listens_on_loopback_only(peer):
    outlet = peer.advertise("/t", COMPOSER.header)
    source = TopicSource("/writer", peer.uri, "/t", "/reader")
    assert source.header["md5sum"] == COMPOSER.header["md5sum"] and not source.is_latched
    assert source.definition().kind == "sensor_msgs/JointState"
    while outlet.reader("/reader") is None:
        time.sleep(0.001)
    assert outlet.send(MESSAGE) == 1 and next(source.messages()) == MESSAGE
    assert peer._listener.getsockname()[0] == peer._server.server_address[0] == "127.0.0.1"
    source.close()


def test_a_topic_that_is_not_offered_and_a_type_that_does_not_fit_are_refused(peer):
    with pytest.raises(MavfiError, match="no such topic"):
        TopicSource("/writer", peer.uri, "/other")
    with pytest.raises(MavfiError, match="does not answer"):
        TopicSource("/writer", "http://127.0.0.1:9/", "/other")


def test_a_reader_follows_the_publishers_of_an_update(peer):
    arrived, heard = [], threading.Event()

    def hear(message):
        arrived.append(message)
        heard.set()

    first = peer.advertise("/t", COMPOSER.header)
    reader = Peer(NoMaster(), "/reader")
    inlet = reader.subscribe("/t", hear)
    inlet.connect([peer.uri, "http://127.0.0.1:9/"])
    assert list(inlet.sources) == [peer.uri] and len(inlet.failures) == 1
    while first.reader("/reader") is None:
        time.sleep(0.001)
    first.send(MESSAGE)
    assert heard.wait(5) and arrived == [MESSAGE]
    inlet.connect([])
    assert inlet.sources == {}
    reader.close()


@pytest.mark.parametrize("arguments", [["ros", "list"], ["inject", "--ros-node", "/a"]])
def test_without_a_master_one_line_says_what_to_do(monkeypatch, capsys, arguments):
    monkeypatch.setenv("ROS_MASTER_URI", "http://127.0.0.1:9")
    monkeypatch.setattr(environment, "installations", lambda: iter(()))
    assert run(arguments) == 2
    message = capsys.readouterr().err
    assert message.startswith("mavfi: no ROS master at http://127.0.0.1:9: ") and message.count("\n") == 1
    assert run(["ros", "watch", "--topics", "/a"]) == 2
    message = capsys.readouterr().err
    assert message.startswith("mavfi: no master of ROS 1 answers; ROS 2 is not installed") and message.count("\n") == 1
