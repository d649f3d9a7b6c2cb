"""mavfi attached to software that nobody here wrote: Debian's robot_state_publisher."""

import json
import math
import subprocess
import sys
import threading
import time
from collections import Counter
from functools import partial

import pytest

from mavfi.cli import run
from mavfi.extras.ros.node.injector import MessageInjector, check_fault
from mavfi.extras.ros.node.master import CALLER, Master, call
from mavfi.extras.ros.node.peer import TopicSource
from mavfi.extras.ros.node.relay import Relay
from mavfi.faults.fault import MessageFault
from tests.extras.ros.node.conftest import POSITION, until

pytestmark = pytest.mark.ros

FIELD = ["--topic", "/joint_states", "--field", "position[0]"]
CHANGED = 0.75
"""0.5 with bit 51 flipped."""


class Transforms:
    """Every message on /tf: the rotations of both joints, by name of the child frame, and the time stamp (ns)."""

    def __init__(self, master, node):
        self.source = TopicSource(node, master.node_uri(node), "/tf")
        self.definition = self.source.definition()
        self.found, self.stamps = [], []
        self.thread = threading.Thread(target=self._listen, daemon=True)
        self.thread.start()

    def _listen(self):
        for message in self.source.messages():
            stamp = (self._value(message, f"[0].header.stamp.{part}") for part in ("secs", "nsecs"))
            self.stamps.append(next(stamp) * 10**9 + next(stamp))
            rotations = [f"[{joint}].transform.rotation.{axis}" for joint in (0, 1) for axis in "xyzw"]
            self.found.append(tuple(round(self._value(message, rotation), 9) for rotation in rotations))

    def _value(self, message, place):
        return self.definition.locate(message, f"transforms{place}").value(message)

    def changed(self):
        """Time stamps of the transforms that are not those of the driver, once all so far have come."""
        now = time.time_ns()
        until(lambda: self.stamps[-1] > now)
        return {stamp for stamp, found in zip(self.stamps, self.found, strict=False) if found != expected(0.5)}


def expected(shoulder):
    """Rotation of elbow and shoulder (by name), from their angles: q = (axis sin(angle / 2), cos(angle / 2))."""
    half = POSITION[1] / 2
    elbow = (0.0, math.sin(half), 0.0, math.cos(half))
    return tuple(round(v, 9) for v in (*elbow, 0.0, 0.0, math.sin(shoulder / 2), math.cos(shoulder / 2)))


def unless_lost(transforms, act):
    """What `act` answers as soon as the node has not lost all messages that were changed meanwhile."""
    for _ in range(5):
        done = act()
        if transforms.changed():
            return done
    raise AssertionError("no transform changed")


@pytest.fixture
def transforms(arm):
    listening = Transforms(arm.master, arm.node)
    until(lambda: len(listening.found) > 20)
    yield listening
    listening.source.close()


def graph_of(arm):
    graph = arm.master.graph()
    uri = arm.master.node_uri(arm.node)
    links = sorted((row[1], row[2], row[4]) for row in call(uri, "getBusInfo", CALLER) if row[2] == "i")
    return graph.publishers, graph.subscribers, links


def run_json(capsys, *arguments):
    capsys.readouterr()
    assert run([*arguments, "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def test_list_names_nodes_processes_topics_and_rates(arm, capsys):
    found = run_json(capsys, "ros", "list", "--seconds", "0.5")["graphs"][0]
    node = next(node for node in found["nodes"] if node["name"] == arm.node)
    assert node["pid"] == arm.process.pid and node["executable"].endswith("/robot_state_publisher")
    assert "/tf" in node["publishes"] and node["reads"] == ["/joint_states"]
    topics = {topic["name"]: topic for topic in found["topics"]}
    assert topics["/tf"]["kind"] == "tf2_msgs/TFMessage"
    assert 20 < topics["/joint_states"]["rate"] <= 210
    assert topics["/joint_states"]["readers"] == [arm.node]


def test_one_changed_message_changes_exactly_the_expected_transform(arm, transforms, capsys):
    before = graph_of(arm)
    arguments = ["ros", "inject", *FIELD, "--bit", "51", "--at", "n=10"]
    (injection,) = unless_lost(transforms, lambda: run_json(capsys, *arguments)["injections"])
    assert injection["before"] == 0.5 and injection["after"] == CHANGED and injection["activated"]
    details = injection["details"]
    assert details["message"] == 10 and details["readers"] == 1
    assert Counter(transforms.found).keys() == {expected(0.5), expected(CHANGED)}
    assert Counter(transforms.found)[expected(CHANGED)] == 1
    assert arm.process.poll() is None
    assert graph_of(arm) == before


@pytest.mark.slow
def test_the_graph_is_as_before_when_the_tool_is_killed(arm, transforms):
    before = graph_of(arm)
    command = [sys.executable, "-m", "mavfi", "ros", "inject", *FIELD, "--bit", "51", "--times", "0"]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL) as tool:
        try:
            until(lambda: expected(CHANGED) in transforms.found)
            assert graph_of(arm)[2] != before[2]
        finally:
            tool.kill()
    until(lambda: graph_of(arm) == before)
    count = len(transforms.found)
    until(lambda: len(transforms.found) > count + 20)
    assert set(transforms.found[-10:]) == {expected(0.5)}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            ["--topic", "/joint_state", "--field", "position[0]"],
            "topic /joint_state: not in the graph (did you mean '/joint_states'?); allowed: /j",
        ),
        (
            ["--topic", "/joint_states", "--field", "positions[0]"],
            "'positions': not known (did you mean 'position[0]'?)",
        ),
        (["--topic", "/joint_states", "--field", "name[0]"], "field name[0]: is text; allowed: a number"),
        (["--topic", "/tf", "--field", "transforms[0].transform.rotation.z"], "nobody reads it"),
        ([*FIELD, "--bit", "64"], "is a float64; allowed: 0 to 63"),
        ([*FIELD, "--node", "/driver"], "does not read /joint_states; allowed: /robot_state_publisher"),
    ],
)
def test_bad_input_is_one_line_with_what_is_allowed(arm, capsys, arguments, message):
    assert run(["ros", "inject", *arguments]) == 2
    err = capsys.readouterr().err
    assert message in err and err.count("\n") == 1


def record_bag(path, seconds):
    subprocess.run(
        ["/usr/bin/rosbag", "record", "-O", str(path), f"--duration={seconds}", "/joint_states", "/tf"],
        check=True,
        capture_output=True,
        timeout=60,
    )


def inject_when(condition):
    """Change one message as soon as something is the case; in a thread."""

    def inject():
        until(condition, 30)
        fault = MessageFault("/joint_states", "position[0]", 55, at=5)
        injector = MessageInjector(fault)
        with Relay(Master(), "/joint_states", injector, partial(check_fault, fault)):
            assert injector.done.wait(10)
            time.sleep(0.2)

    thread = threading.Thread(target=inject)
    thread.start()
    return thread


@pytest.mark.slow
def test_a_detector_trained_from_a_recorded_bag_raises_an_alarm_for_the_changed_message_alone(
    arm, transforms, tmp_path, capsys
):
    bag = tmp_path / "normal.bag"
    record_bag(bag, 3)

    def watch():
        injecting = inject_when(lambda: "/mavfi/alarm" in arm.master.graph().publishers)
        arguments = ["--topics", "/joint_states,/tf", "--train", str(bag), "--duration", "8"]
        found = run_json(capsys, "ros", "watch", *arguments)
        injecting.join()
        return found

    found = unless_lost(transforms, watch)
    assert found["learned_from"] > 100 and min(found["judged"].values()) > 100
    topics = Counter(alarm["topic"] for alarm in found["alarms"])
    assert topics == {"/joint_states": 2, "/tf": 2}  # there, and back
    assert next(alarm["fields"] for alarm in found["alarms"] if alarm["topic"] == "/joint_states") == ["position[0]"]
    assert "/mavfi/alarm" not in arm.master.graph().publishers
    assert "/joint_states" in arm.master.graph().publishers
    assert arm.master.graph().subscribers["/joint_states"] == [arm.node]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--topics", "/nothing"], "topic /nothing: not in the graph"),
        (["--topics", "/tf", "--detector", "oracle"], "allowed: gaussian, autoencoder"),
    ],
)
def test_what_cannot_be_watched_is_refused(arm, capsys, arguments, message):
    assert run(["ros", "watch", *arguments]) == 2
    assert message in capsys.readouterr().err
