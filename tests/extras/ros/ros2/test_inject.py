"""`mavfi ros inject | run` and `mavfi inject --ros-node` on real nodes."""

import json
import os
import re
import signal
import subprocess
import threading

import pytest

from mavfi.cli import run
from mavfi.extras.ros.ros2.graph import AgentClient
from tests.core.architecture.source import ROOT
from tests.extras.ros.ros2.conftest import NODES
from tests.extras.ros.ros2.messages import Messages

pytestmark = pytest.mark.ros


@pytest.fixture(scope="module")
def talker(ros2):
    process = ros2.start("talker.py", "--clock")
    with AgentClient(ros2.installation) as client:
        assert client.wait_for("/joint_states", limit_s=20)
        yield process
    assert process.poll() is None


def test_a_number_in_a_running_node_is_changed_and_a_second_reader_sees_it(talker, capsys):
    assert run("ros inject --topic joint_states --field position[1] --set nan --at sim=0.1 --json".split()) == 0
    (injection,) = json.loads(capsys.readouterr().out)["injections"]
    assert injection["site"] == "/joint_states.position[1]" and injection["activated"]
    assert injection["before"] in (0.25, 0.26) and injection["after"] == "nan"
    details = injection["details"]
    assert details["verified"] is True and details["node"] == "/talker" and details["pid"] == talker.pid
    assert details["sim_s"] > 1000


once = pytest.mark.parametrize("ros2", ["jazzy"], indirect=True, scope="module")
"""Not with every distribution."""


@once
def test_what_is_wrong_is_one_line_before_anything_is_touched(talker, capsys):
    for arguments, message in (
        (
            ["--topic", "/joint_state", "--field", "x"],
            "topic /joint_state: not in the graph (did you mean '/joint_states'?); allowed:",
        ),
        (
            ["--topic", "/joint_states", "--field", "positions[0]"],
            "member of sensor_msgs/msg/JointState 'positions': not known (did you mean 'position'?)",
        ),
        (["--topic", "/joint_states", "--field", "position[0]", "--bit", "64"], "bit 64: allowed: 0 to 63"),
        (["--topic", "/joint_states", "--set", "1"], "set=1: changes a number; allowed: with a field"),
        (["--topic", "/joint_states", "--drop", "--at", "5..2"], "'5..2': ends before it starts; allowed: 10, 10..12"),
        (["--service", "/switch", "--drop"], "--side: allowed with --service: request, response"),
        (["--topic", "/joint_states", "--side", "take", "--drop"], "/joint_states: no node reads it"),
        (
            ["--service", "/switch", "--side", "request", "--delay", "1"],
            "not possible in a call of a service; allowed: drop",
        ),
        (["--topic", "/joint_states", "--service", "/switch"], "--topic NAME or --service NAME, one of them"),
    ):
        assert run(["ros", "inject", *arguments]) == 2
        captured = capsys.readouterr()
        assert message in captured.err and captured.err.count("\n") == 1 and captured.out == ""


@once
def test_a_register_of_a_node_is_injected_by_its_name(talker, capsys):
    assert run(["inject", "--ros-node", "talker", "--symbol", "rmw_publish", "--null", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["injections"][0]["activated"]


@once
def test_nodes_are_started_with_faults_and_missing_ones_are_explained(ros2, capfd, monkeypatch):
    for name, value in ros2.installation.environment(ROS_DOMAIN_ID="48").items():
        monkeypatch.setenv(name, value)
    faults = ["--fault", "topic:/number1 data set=-5 times=2 @n=2", "--fault", "topic:/nothing drop"]
    assert run(["ros", "run", *faults, "--", ros2.installation.python, str(NODES / "calls.py"), "5"]) == 0
    captured = capfd.readouterr()
    assert json.loads(captured.out)["received"][1] == [0.0, -5.0, -5.0, 3.0, 4.0]
    lines = captured.err.splitlines()
    assert lines[0].startswith("/number1 message 2: data (f8) 1.0 → -5.0 (") and len(lines) == 4
    assert lines[2] == "/number1: 2 of 5 messages changed"
    assert lines[3].startswith("/nothing: NOT injected: none of 1 processes had a message of it")


@pytest.fixture(scope="module")
def signals(ros2):
    process = ros2.start("signals.py", "600")
    with AgentClient(ros2.installation) as client:
        assert client.wait_for("/takeoff", limit_s=20)
        yield process
    assert process.poll() is None


NO_FIELD = "has no field; allowed: drop, delay, duplicate"


@once
def test_a_message_without_numbers_has_none_to_change(signals, ros2, capfd, monkeypatch):
    assert run("ros inject --topic /takeoff --field data --set 1".split()) == 2
    assert f"field data: std_msgs/msg/Empty {NO_FIELD}" in capfd.readouterr().err
    for name, value in ros2.installation.environment(ROS_DOMAIN_ID="49").items():
        monkeypatch.setenv(name, value)
    command = [ros2.installation.python, str(NODES / "signals.py"), "60"]
    assert run(["ros", "run", "--fault", "topic:/takeoff data set=1", "--", *command]) == 2
    assert f"fault in /takeoff: field data: Empty {NO_FIELD}" in capfd.readouterr().err


FEEDBACK = "ros inject --topic /count/_action/feedback --field feedback.sequence[0] --set 9".split()


@once
def test_feedback_of_an_action_is_changed_and_what_is_counted_is_what_was_changed(signals, capsys):
    assert run([*FEEDBACK, "--json"]) == 0
    (injection,) = json.loads(capsys.readouterr().out)["injections"]
    assert (injection["before"], injection["after"]) == (1, 9) and injection["details"]["verified"] is True
    assert run([*FEEDBACK, "--times", "0", "--duration", "0.5", "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert data["changed"] == data["passed"] == len(data["injections"]) > 30


@once
def test_the_exit_code_says_that_nothing_was_changed(signals, capsys):
    assert run([*FEEDBACK, "--at", "n=100000", "--duration", "0.3"]) == 3
    assert "0 changed; the graph is as it was" in capsys.readouterr().out


SUPERVISOR = """
import subprocess, sys
while True:
    subprocess.run([sys.executable, sys.argv[1]], stderr=subprocess.DEVNULL)
"""


def test_the_report_says_that_a_supervisor_brought_the_node_back(ros2, capfd):
    """The node raises an exception at a NaN, which ends it; its supervisor starts another one."""
    installation = ros2.installation
    supervisor = subprocess.Popen(
        [installation.python, "-c", SUPERVISOR, str(ROOT / "examples/ros2/limiter.py")],
        env=installation.environment(),
        start_new_session=True,
    )
    try:
        with AgentClient(installation) as client:
            joints = Messages(client.definition("test_msgs/msg/BasicTypes")).data["JointState"]
            assert client.advertise("/in", "sensor_msgs/msg/JointState", subscribers=1)
            is_over = threading.Event()

            def publish():
                while not is_over.wait(0.05):
                    client.publish("/in", joints)

            pump = threading.Thread(target=publish)
            pump.start()
            arguments = ["--topic", "/in", "--side", "take", "--field", "position[0]", "--set", "nan"]
            code = run(["ros", "inject", *arguments, "--duration", "60"])
            is_over.set()
            pump.join()
            assert code == 0
    finally:
        os.killpg(supervisor.pid, signal.SIGKILL)
        supervisor.wait()
    lines = capfd.readouterr().out.splitlines()
    assert "position[0] (f8) 0.0 → nan (/limiter" in lines[0]
    assert re.search(r"s after the injection: process \d+ of /limiter has ended", lines[1])
    assert re.search(r"process \d+ \(.*limiter.py\) has taken its place", lines[2])
