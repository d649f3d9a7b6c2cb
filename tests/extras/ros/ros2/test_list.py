"""`mavfi ros list` in a graph of real nodes."""

import json

import pytest

from mavfi.cli import run
from mavfi.extras.ros.ros2 import environment
from mavfi.extras.ros.ros2.graph import AgentClient, Endpoint, GraphSnapshot, TopicInfo
from mavfi.extras.ros.ros2.processes import GraphProcesses
from mavfi.extras.ros.ros2.survey import Survey, SurveyedNode, SurveyedService, SurveyedTopic


@pytest.mark.ros
@pytest.mark.slow
@pytest.mark.parametrize("ros2", ["jazzy"], indirect=True)
def test_nodes_processes_topics_and_rates_are_listed(ros2, capsys):
    talkers = [ros2.start("talker.py", "--name", name) for name in ("one", "two")]
    with AgentClient(ros2.installation) as agent:
        assert agent.wait_for("/count", publishers=2)
    assert run(["ros", "list", "--seconds", "0.5", "--json"]) == 0
    (graph,) = json.loads(capsys.readouterr().out)["graphs"]
    assert graph["ros"] == 2
    assert {node["name"]: node["pid"] for node in graph["nodes"]} == {
        "/one": talkers[0].pid,
        "/two": talkers[1].pid,
    }
    assert all(node["executable"].endswith("nodes/talker.py") for node in graph["nodes"])
    topics = {topic["name"]: topic for topic in graph["topics"]}
    assert topics["/count"]["kind"] == "std_msgs/msg/Int32" and topics["/count"]["qos"] == "best effort"
    assert sorted(topics["/count"]["publishers"]) == ["/one", "/two"]
    assert 0 < topics["/count"]["rate"] < 200  # 100 where the machine has nothing else to do
    service = next(service for service in graph["services"] if service["name"] == "/switch")
    assert sorted(service["servers"]) == ["/one", "/two"]


def test_the_text_has_the_answer_first_and_fits_a_terminal(capsys, monkeypatch):
    node = SurveyedNode("/controller", 4711, "", "/opt/robot/lib/control/controller", (), ("/joint_states",))
    far = SurveyedNode("/far", None, "no process on this machine and in this network", "", (), ())
    topic = SurveyedTopic(
        "/joint_states", "sensor_msgs/msg/JointState", "reliable, latched", ("/driver",), ("/controller",), 50.04
    )
    hidden = SurveyedTopic("/go/_action/feedback", "test_msgs/action/Fibonacci_FeedbackMessage", "", (), (), None)
    service = SurveyedService("/switch", "std_srvs/srv/SetBool", ("/driver",))
    parameters = SurveyedService("/driver/describe_parameters", "rcl_interfaces/srv/DescribeParameters", ("/driver",))
    action = SurveyedService("/go", "test_msgs/action/Fibonacci", ("/driver",))
    survey = Survey("domain 0", (node, far), (topic, hidden), (service, parameters), (action,))
    monkeypatch.setattr("mavfi.extras.ros.ros2.survey.survey_graph", lambda seconds: survey)
    monkeypatch.setenv("COLUMNS", "80")
    assert run(["ros", "list"]) == 0
    out = capsys.readouterr().out
    assert out.startswith("ROS 2 (domain 0): 2 nodes, 2 topics, 1 service, 1 action\n")
    assert max(map(len, out.splitlines())) <= 80
    for text in ("4711", "no process on this machine", "50.0", "latched", "std_srvs/SetBool", "test_msgs/Fibonacci"):
        assert text in out
    assert "_action" not in out and "describe_parameters" not in out


@pytest.mark.parametrize(
    "arguments",
    [
        ["ros", "list"],
        ["ros", "watch", "--topics", "/a"],
        ["ros", "inject", "--topic", "/a", "--drop"],
        ["ros", "fly"],
        ["inject", "--ros-node", "/a"],
    ],
)
def test_without_ros_one_line_says_what_to_do(capsys, monkeypatch, arguments):
    monkeypatch.setattr(environment, "installations", lambda: iter(()))
    assert run(arguments) == 2
    message = capsys.readouterr().err
    assert message.startswith("mavfi: ROS 2 is not installed: run `mavfi ros setup`") and message.count("\n") == 1


@pytest.mark.ros
@pytest.mark.slow
@pytest.mark.parametrize("ros2", ["jazzy"], indirect=True)
def test_a_graph_without_a_node_is_refused(ros2, capsys, monkeypatch):
    monkeypatch.setenv("ROS_DOMAIN_ID", "77")
    assert run(["ros", "list", "--seconds", "0"]) == 2
    assert capsys.readouterr().err == "mavfi: no ROS 2 node in domain 77, rmw_fastrtps_cpp\n"


def test_an_unknown_process_has_a_reason():
    def snapshot(gid):
        endpoint = Endpoint("/far", "std_msgs/msg/String", gid, "reliable", "volatile")
        topic = TopicInfo("/text", (endpoint.kind,), (endpoint,), ())
        return GraphProcesses(GraphSnapshot(("/far", "/bare"), (topic,), (), (), "rmw_other", 0))

    elsewhere = snapshot("010f7f01" + "0000" + "de30f00000000000001703")  # no process has a number that ends with 0000
    assert "it may be in a container, or elsewhere" in elsewhere.pid_of_node("/far").problem
    assert elsewhere.pids_of_publishers("/text")[0].pid is None
    other = snapshot("0110" * 8)
    assert other.pid_of_node("far").problem == "rmw_other does not say in which process it is"
    assert other.pid_of_node("bare").problem.startswith("has no topic and no service")
