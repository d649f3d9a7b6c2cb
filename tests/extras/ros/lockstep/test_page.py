"""Every command of a section of docs/how-to/ros2.md, run as it stands there."""

import re
import signal
import subprocess
import sys
from contextlib import contextmanager

import pytest

from tests.extras.ros.lockstep.needs import any_ros
from tests.pages import arguments, commands

pytestmark = [*any_ros, pytest.mark.slow]
ALL = commands("how-to/ros2.md", "## The pipeline as nodes")
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
LISTED = "mavfi ros list"
NOT_HERE = {"ros2 topic echo --once /odometry", "rviz2"}
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


def test_the_section_has_no_command_that_is_not_run_here():
    assert set(ALL) == {*FLIGHTS, *JOINED}
    assert len(FLIGHTS) == 10
    assert {command.removeprefix("$FLIGHT/join ") for command in JOINED} == {LISTED, *NOT_HERE}


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
def running():
    """Folder of a running flight."""
    with subprocess.Popen(
        arguments(LOOKED_AT, {}), stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
    ) as flown:
        assert flown.stderr is not None
        yield re.match(r"join the flight: (.*)/join ", flown.stderr.readline())[1]
        assert flown.poll() is None, "the flight was over before all had looked at it"
        flown.send_signal(signal.SIGINT)


def joined(folder, *command, **options):
    """What a command prints in the network of a flight."""
    done = subprocess.run(
        [f"{folder}/join", *command], capture_output=True, text=True, check=False, timeout=60, **options
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_a_look_into_a_flight(tmp_path):
    with running() as folder:
        assert joined(folder, "python3", "-c", LISTENER) == "map base_link True True True\n"
        _, *rest = LISTED.split()
        assert re.search(r"/octomap(.*\n)*.*/world", joined(folder, sys.executable, "-m", "mavfi", *rest, cwd=tmp_path))
