"""The agent in a graph of real nodes, of both distributions."""

import ast
import os
import re
import signal
import struct
import subprocess
import sys
import time
from pathlib import Path

import pytest

from mavfi.errors import BadInputError, MavfiError
from mavfi.extras.ros.ros2 import agent as agent_module
from mavfi.extras.ros.ros2.graph import AgentClient
from mavfi.extras.ros.ros2.processes import GraphProcesses
from tests.extras.ros.ros2.conftest import has_ended, until

pytestmark = pytest.mark.ros


@pytest.fixture(scope="module")
def talker(ros2):
    return ros2.start("talker.py", "--clock")


@pytest.fixture(scope="module")
def agent(ros2, talker):
    with AgentClient(ros2.installation) as client:
        assert client.wait_for("/joint_states", limit_s=20)
        yield client


def test_snapshot_names_what_is_in_the_graph_and_its_processes_but_not_the_agent(agent, talker):
    graph = agent.snapshot(least_s=0.0)
    assert graph.nodes == ("/talker",)
    topic = graph.topic("joint_states")
    assert topic.kinds == ("sensor_msgs/msg/JointState",) and not topic.subscribers
    assert [(end.node, end.reliability) for end in topic.publishers] == [("/talker", "reliable")]
    assert graph.service("/switch").kinds == ("std_srvs/srv/SetBool",)
    processes = GraphProcesses(graph)
    for answer in (
        processes.pid_of_node("talker"),
        *processes.pids_of_publishers("/count"),
        *processes.pids_of_service("/switch"),
    ):
        assert answer.pid == talker.pid and answer.problem == ""
    with pytest.raises(
        BadInputError,
        match=r"topic /joint_state: not in the graph \(did you mean '/joint_states'\?\); allowed: .*/clock",
    ):
        graph.topic("/joint_state")


def test_messages_come_with_instants_by_wall_and_clock_whatever_the_quality_of_service(agent):
    assert agent.now().sim_ns > 1000 * 10**9
    assert agent.subscribe("/count").reliability == "best_effort"
    assert agent.subscribe("/joint_states").reliability == "reliable"
    began = time.time_ns()
    messages = list(agent.messages(0.5))
    agent.unsubscribe("/count")
    agent.unsubscribe("/joint_states")
    counts = [struct.unpack("<4xi", message.data)[0] for message in messages if message.topic == "/count"]
    assert counts and counts == sorted(set(counts))
    assert all(abs(message.wall_ns - began) < 2 * 10**9 and message.sim_ns > 1000 * 10**9 for message in messages)


def test_a_publisher_whose_quality_of_service_does_not_match_is_told(agent):
    agent.subscribe("/count", "std_msgs/Int32", reliable=True)
    until(lambda: agent.notices)
    agent.unsubscribe("/count")
    assert agent.notices == ["topic /count: the reliability of a publisher does not match: it is not read"]


def test_definitions_of_types_come_from_the_installation(agent):
    assert "string data" in agent.definition("std_msgs/String")
    with pytest.raises(BadInputError, match="type my_robot/State: no file my_robot/msg/State.msg"):
        agent.definition("my_robot/State")


def test_rates_are_counted_and_an_absent_topic_has_a_reason(agent):
    measured = agent.rates(["/joint_states", "/count", "/nothing"], 0.5)
    for topic in ("/count", "/joint_states"):
        assert 0 < measured.rates[topic] < 100, topic  # 50 where the machine has nothing else to do
    assert measured.reasons == {"/nothing": "topic /nothing: nobody publishes it"}


def test_published_bytes_reach_a_reader_as_they_are(ros2, agent):
    with AgentClient(ros2.installation) as reader:
        agent.advertise("/numbers", "std_msgs/Int32", latched=True)
        assert reader.subscribe("/numbers").durability == "transient_local"
        with AgentClient(ros2.installation):  # a third one disturbs nobody
            assert agent.advertise("/numbers", "std_msgs/Int32", subscribers=1)
            data = b"\x00\x01\x00\x00" + struct.pack("<i", -7)
            agent.publish("/numbers", data, count=3)
            assert [reader.receive(10.0).data for _ in range(3)] == [data] * 3
        assert reader.receive(0.1) is None


@pytest.mark.parametrize(
    ("kind", "message"),
    [
        ("std_msgs/Strong", "type std_msgs/msg/Strong: this ROS installation has no Python class of it"),
        ("my_robot/State", "type my_robot/msg/State: this ROS installation has no Python class of it"),
        ("rubbish", "type 'rubbish': allowed: names such as std_msgs/msg/String"),
    ],
)
def test_an_unknown_type_is_refused_in_one_line(agent, kind, message):
    with pytest.raises(BadInputError, match=message):
        agent.subscribe("/unknown", kind, reliable=True)


def test_the_agent_ends_with_its_client_and_leaves_nothing(ros2):
    program = (
        "import time\n"
        "from mavfi.extras.ros.ros2.graph import AgentClient\n"
        "with AgentClient(variables={'ROS_DOMAIN_ID': '9'}) as agent:\n"  # where it is alone
        "    agent.advertise('/text', 'std_msgs/String')\n"
        "    print(agent.pid, flush=True)\n"
        "    time.sleep(60)\n"
    )
    with subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True) as client:
        pid = int(client.stdout.readline())
        maps = Path(f"/proc/{pid}/maps").read_text()
        client.kill()
    until(lambda: has_ended(pid))
    (shared_memory,) = set(re.findall(r"/dev/shm/fast\w+_[0-9a-f]{16}", maps))
    assert not Path(shared_memory).exists()


def test_a_killed_agent_is_told_in_one_line(ros2):
    with AgentClient(ros2.installation) as agent:
        os.kill(agent.pid, signal.SIGKILL)
        with pytest.raises(MavfiError, match="agent in ROS 2: has ended"):
            agent.snapshot()


def test_a_python_without_ros_is_told_in_one_line(ros2):
    without = ros2.installation._replace(python=sys.executable, variables={"PYTHONPATH": ""})
    with pytest.raises(MavfiError, match="No module named 'rclpy'"), AgentClient(without):
        pass


def test_the_agent_is_valid_for_the_oldest_python_of_a_ros_that_is_still_in_use():
    ast.parse(Path(agent_module.__file__).read_text(), feature_version=(3, 10))
