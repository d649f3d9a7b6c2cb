"""`mavfi ros watch` on ROS 2: trained on a recording, it raises alarms for wild values alone."""

import json
import signal
import subprocess
import sys
from itertools import islice

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from mavfi.cli import run
from mavfi.errors import BadInputError
from mavfi.extras.ros.ros2 import listener
from mavfi.extras.ros.ros2.graph import AgentClient
from mavfi.extras.ros.ros2.message_types import TypeLibrary


def record(agent, folder, plugin, count):
    """What `ros2 bag record` writes of a topic."""
    types = get_typestore(Stores.ROS2_JAZZY)
    with Writer(folder, version=9, storage_plugin=plugin) as writer:
        kind = agent.subscribe("/joint_states").kind
        connection = writer.add_connection("/joint_states", kind, typestore=types)
        for message in islice(agent.messages(20.0), count):
            writer.write(connection, message.wall_ns, message.data)
    agent.unsubscribe("/joint_states")


def text_of(message):
    """The JSON of a serialized std_msgs/String."""
    return json.loads(get_typestore(Stores.ROS2_JAZZY).deserialize_cdr(message.data, "std_msgs/msg/String").data)


@pytest.mark.ros
@pytest.mark.slow
def test_a_detector_trained_on_a_recording_raises_alarms_for_wild_values_and_publishes_them(ros2, tmp_path):
    plugin = {"jazzy": StoragePlugin.MCAP, "kilted": StoragePlugin.SQLITE3}[ros2.installation.distribution]
    talker = ros2.start("talker.py")
    command = [sys.executable, "-m", "mavfi", "ros", "watch", "--topics", "joint_states", "--json"]
    with AgentClient(ros2.installation) as agent:
        record(agent, tmp_path / "normal", plugin, 120)
        talker.kill()
        ros2.start("talker.py", "--wild", "25")
        with subprocess.Popen([*command, "--train", str(tmp_path / "normal")], stdout=subprocess.PIPE) as process:
            agent.subscribe("/mavfi/alarm", limit_s=60.0)
            alarms = (message for message in agent.messages(60.0) if message.topic == "/mavfi/alarm")
            published = [text_of(message) for message in islice(alarms, 4)]
            process.send_signal(signal.SIGINT)
            result = json.load(process.stdout)
    assert result["learned_from"] == 120 and result["judged"]["/joint_states"] > 25
    assert published == result["alarms"][:4]
    assert [alarm["fields"] for alarm in result["alarms"]] == [["position[1]"]] * len(result["alarms"])
    values = {alarm["values"][0] for alarm in result["alarms"]}
    assert "1000000.0" in values and values - {"1000000.0"} <= {"0.25", "0.26"}  # there and back


@pytest.mark.ros
@pytest.mark.slow
@pytest.mark.parametrize("ros2", ["jazzy"], indirect=True)
def test_an_unknown_topic_is_refused(ros2, capsys, monkeypatch):
    monkeypatch.setattr(listener, "_PATIENCE_S", 0.5)
    ros2.start("talker.py")
    assert run(["ros", "watch", "--topics", "/joint_state"]) == 2
    assert (
        "topic /joint_state: not in the graph (did you mean '/joint_states'?); allowed: /count, /joint_states"
        in capsys.readouterr().err
    )


def test_types_that_are_not_standard_are_fetched_with_their_components():
    texts = {
        "robot/msg/Arm": "std_msgs/Header header\nrobot/Joint[] joints\nfloat32[2] limits\n",
        "robot/msg/Joint": "string name\nfloat64 angle\n",
    }
    types = TypeLibrary("jazzy", texts.__getitem__)
    types.require("robot/msg/Arm")
    made = types.store.types
    stamp = made["builtin_interfaces/msg/Time"](3, 4)
    joint = made["robot/msg/Joint"]("elbow", 0.25)
    header = made["std_msgs/msg/Header"](stamp, "base")
    message = made["robot/msg/Arm"](header, [joint], np.array([-1, 1], np.float32))
    data = types.to_ros1("robot/msg/Arm", bytes(types.store.serialize_cdr(message, "robot/msg/Arm")))
    definition = types.definition("robot/msg/Arm")
    assert definition.kind == "robot/Arm"
    assert definition.locate(data, "joints[0].angle").value(data) == 0.25
    assert definition.locate(data, "limits[1]").value(data) == 1


def test_a_type_that_nobody_defines_is_refused():
    def fetch(kind):
        raise BadInputError(f"type {kind}: no file")

    with pytest.raises(BadInputError, match="type robot/msg/Arm: no file"):
        TypeLibrary("humble", fetch).require("robot/msg/Arm")
    with pytest.raises(BadInputError, match="type robot/msg/Arm: its definition is not understood"):
        TypeLibrary("unheard_of", lambda kind: "[[[").require("robot/msg/Arm")
