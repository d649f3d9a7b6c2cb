"""Every command of docs/how-to/ros.md, run as it stands there."""

import re
import signal
import subprocess
import sys
import threading
import time
from contextlib import contextmanager

import pytest

from tests.extras.ros.lockstep.flights import NODES
from tests.extras.ros.lockstep.needs import any_ros, flying, number
from tests.pages import DOCS, arguments, commands
from tools import install_ros as install

pytestmark = [*any_ros, pytest.mark.slow]
ALL = commands("how-to/ros.md")
FLIGHTS = [command for command in ALL if command.startswith("mavfi ros fly ")]
LOOKED_AT = next(command for command in FLIGHTS if command.endswith("--pace 1"))
OTHERWISE = (
    "--fault",
    "--coupling observer",
    "--kill",
    "--localization estimator",
    "--json",
    "--pace",
    "--register-fault",
)
"""Other tests fly these too, in shorter missions."""
JOINED = [command for command in ALL if command.startswith("$FLIGHT/join ")]
SAYS = {
    "mavfi ros": r"/octomap(.*\n)*.*/world",
    "rosnode list": r"/octomap\n(.*\n)*/world",
    "rostopic hz": r"average rate: \d+\.\d+\n\s+min: ",
    "rostopic echo": r"linear: ",
}
"""What each tool must print during a flight."""
NOT_HERE = {"ros2 topic", "rviz2"}
"""Tools that are no package of Python."""
LISTENER = """
import rclpy
from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry, Path
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import PointCloud2
from trajectory_msgs.msg import MultiDOFJointTrajectory
from visualization_msgs.msg import MarkerArray

kinds = {"/clock": Clock, "/odometry": Odometry, "/command": TwistStamped, "/points": PointCloud2, "/map": PointCloud2,
         "/path": Path, "/trajectory": Path, "/trajectory_points": MultiDOFJointTrajectory, "/obstacles": MarkerArray}
rclpy.init()
node = rclpy.create_node("listener")
got = {}
for topic, kind in kinds.items():
    node.create_subscription(kind, topic, lambda message, topic=topic: got.update({topic: message}), 10)
while len(got) < len(kinds) or got["/map"].width < 10:
    rclpy.spin_once(node)
odometry, path = got["/odometry"], got["/trajectory_points"].points
sizes = path[-1].time_from_start.sec > 0, got["/points"].width > 10, len(got["/obstacles"].markers) > 3
print(odometry.header.frame_id, odometry.child_frame_id, *sizes)
"""


def tool(command):
    return " ".join(command.split()[1:3])


def test_the_page_has_no_command_that_is_not_run_here():
    assert set(ALL) == {"make ros", *FLIGHTS, *JOINED}
    assert len(FLIGHTS) == 11
    assert {tool(command) for command in JOINED} == {*SAYS, *NOT_HERE}


def test_make_ros_says_that_it_is_here(capsys):
    assert "ros:" in (DOCS.parent / "Makefile").read_text(encoding="utf-8")
    assert install.main() == 0
    assert re.match(r"ROS 1 1\.15\.\d+ was here: /", capsys.readouterr().out)


@pytest.mark.parametrize(
    "command",
    [
        pytest.param(command, marks=[pytest.mark.long] if any(word in command for word in OTHERWISE) else [])
        for command in FLIGHTS
    ],
)
def test_a_flight_of_the_page(command, tmp_path):
    done = subprocess.run(arguments(command, {}), cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "digest" in done.stdout


@contextmanager
def running(ros):
    """Folder of a running flight."""
    with subprocess.Popen(
        [*arguments(LOOKED_AT, {}), "--ros", number(ros)], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
    ) as flown:
        assert flown.stderr is not None
        yield re.match(r"join the flight: (.*)/join ", flown.stderr.readline())[1]
        assert flown.poll() is None, "the flight was over before all had looked at it"
        flown.send_signal(signal.SIGINT)


def listed(folder):
    """Nodes of a flight on ROS 1, once its master is there."""
    return subprocess.run([f"{folder}/join", "rosnode", "list"], capture_output=True, text=True, check=False).stdout


def look(folder, command, directory):
    """What a tool of the page prints."""
    join, *rest = arguments(command, {"FLIGHT": folder})
    if rest[0] == "mavfi":
        rest[0:1] = [sys.executable, "-m", "mavfi"]
    wanted, output = SAYS[tool(command)], ""
    with subprocess.Popen(
        [join, *rest], cwd=directory, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    ) as process:
        limit = threading.Timer(60.0, process.kill)
        limit.start()
        for line in process.stdout:
            output += line
            if "hz" in rest and re.search(wanted, output):  # it runs until Ctrl-C
                process.send_signal(signal.SIGINT)
                break
        process.wait()
        limit.cancel()
    assert process.returncode == 0 or "hz" in rest, output
    assert re.search(wanted, output), output
    return output


@pytest.mark.alone
@pytest.mark.parametrize("ros", flying("ros1"))
def test_a_look_into_a_flight_on_ros_1(ros, tmp_path):
    with running(ros) as folder:
        until = time.monotonic() + 120
        while "/pid" not in listed(folder) and time.monotonic() < until:
            time.sleep(0.5)
        for command in JOINED:
            if tool(command).startswith("ros") and tool(command) not in NOT_HERE:
                output = look(folder, command, tmp_path)
                if "rosnode" in command:
                    assert {f"/{node}" for node in (*NODES, "world")} <= set(output.split())


@pytest.mark.alone
@pytest.mark.parametrize("ros", flying("jazzy"))
def test_a_look_into_a_flight_on_ros_2(ros, tmp_path):
    with running(ros) as folder:
        listener = subprocess.run(
            [f"{folder}/join", "python3", "-c", LISTENER], capture_output=True, text=True, check=False, timeout=60
        )
        assert listener.stdout == "map base_link True True True\n", listener.stderr
        look(folder, next(command for command in JOINED if tool(command) == "mavfi ros"), tmp_path)
