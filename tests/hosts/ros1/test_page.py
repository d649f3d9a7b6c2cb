"""Every command of docs/ros.md, run as it stands there."""

import os
import re
import signal
import subprocess
import sys
import threading
import time
from contextlib import contextmanager
from pathlib import Path

import pytest

from mavfi.errors import BadInputError
from mavfi.hosts.node import nodelets
from mavfi.hosts.ros1 import install
from tests.hosts.ros1.flights import NODES
from tests.hosts.ros1.needs import environment, ros
from tests.pages import DOCS, arguments, commands

pytestmark = [*ros, pytest.mark.slow]
ALL = commands("ros.md")
FREE = [command for command in ALL if "--free-running" in command]
FLIGHTS = [command for command in ALL if command.startswith("mavfi ros fly ") and command not in FREE]
OTHERWISE = (
    "--fault", "--coupling observer", "--kill", "--localization estimator", "--json",
    "--point-cloud-node depth_image_proc",
)  # fmt: skip
"""Other tests fly these too, in shorter missions."""
INJECT = next(command for command in ALL if "mavfi inject" in command)
JOINED = [command for command in ALL if command.startswith("$FLIGHT/join ") and command != INJECT]
SAYS = {
    "rosnode list": r"/octomap\n(.*\n)*/world",
    "rostopic hz": r"average rate: \d+\.\d+\n\s+min: ",
    "rosmsg show": r"float64 x\n",
    "rostopic echo": r"yaw_rate: ",
    "rosbag record": r"",
    "rosservice call": r"pose:[\s\S]*pose:",
}
"""What each tool must print during a flight."""


def need_nodelets():
    try:
        nodelets.require()
    except BadInputError as error:
        pytest.skip(str(error))


def test_the_page_has_no_command_that_is_not_run_here():
    assert set(ALL) == {"make ros", *FLIGHTS, *FREE, *JOINED, INJECT}
    assert (len(FLIGHTS), len(FREE)) == (10, 2)
    assert ["--point-cloud-node" in command for command in FREE] == [False, True]
    assert {" ".join(command.split()[1:3]) for command in JOINED} == set(SAYS)


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
    if "--point-cloud-node" in command:
        need_nodelets()
    done = subprocess.run(arguments(command, {}), cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert "digest" in done.stdout


def listed(folder):
    """Nodes of a flight, once its master is there."""
    return subprocess.run([f"{folder}/join", "rosnode", "list"], capture_output=True, text=True, check=False).stdout


@contextmanager
def running_flight(command):
    """Folder of a running flight."""
    with subprocess.Popen(
        arguments(command, {}), stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
    ) as flown:
        assert flown.stderr is not None
        folder = re.match(r"join the flight: (.*)/join ", flown.stderr.readline())[1]
        until = time.monotonic() + 120
        while "/pid" not in listed(folder) and time.monotonic() < until:
            time.sleep(0.5)
        yield folder
        assert flown.poll() is None, "the flight was over before all had looked at it"
        flown.send_signal(signal.SIGINT)


@pytest.mark.alone
def test_an_injection_from_a_second_terminal():
    need_nodelets()
    with running_flight(FREE[1]) as folder:
        first = [f"{folder}/join", "rostopic", "echo", "-n", "1", "/points/header"]  # images come
        subprocess.run(first, stdout=subprocess.DEVNULL, check=True, timeout=60)
        here = {**os.environ, "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}
        done = subprocess.run(
            arguments(INJECT, {"FLIGHT": folder}), env=here, capture_output=True, text=True, check=False
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        assert "bit" in done.stdout


@pytest.fixture(scope="module")
def flight():
    """Folder of a flight that all look at."""
    with running_flight(FREE[0]) as folder:
        yield folder


@pytest.mark.alone
def test_debians_tools_see_the_frame_of_the_vehicle(flight):
    done = subprocess.run(
        [f"{flight}/join", "rostopic", "echo", "-n", "1", "/odometry"], capture_output=True, text=True, timeout=60,
        check=True,
    )  # fmt: skip
    assert 'child_frame_id: "base_link"' in done.stdout


@pytest.mark.alone
@pytest.mark.parametrize("command", JOINED)
def test_a_look_into_a_flight(command, flight, tmp_path):
    join, *rest = arguments(command, {"FLIGHT": flight})
    wanted, output = SAYS[" ".join(rest[:2])], ""
    with subprocess.Popen(
        [join, *rest], cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
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
    if "rosnode" in rest:
        assert {f"/{node}" for node in (*NODES, "world", "rosout")} <= set(output.split())
    if "record" in rest:
        output = subprocess.run(
            [sys.executable, "-c", "import rosbags.rosbag1 as b, sys; print(b.Reader(sys.argv[1]).__enter__().topics)",
             "flight.bag"], cwd=tmp_path, capture_output=True, text=True, check=True, env=environment(),
        )  # fmt: skip
        assert all(topic in output.stdout for topic in ("/odometry", "/tf", "/command"))
