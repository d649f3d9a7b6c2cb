"""Every command of docs/ros.md, run as it stands there."""

import re
import signal
import subprocess
import threading
import time

import pytest

from tests.extras.ros.ros1.flights import NODES
from tests.extras.ros.ros1.needs import ros
from tests.pages import DOCS, arguments, commands
from tools import install_ros as install

pytestmark = [*ros, pytest.mark.slow]
ALL = commands("ros.md")
FLIGHTS = [command for command in ALL if command.startswith("mavfi ros fly ")]
LOOKED_AT = next(command for command in FLIGHTS if command.endswith("--pace 1"))
OTHERWISE = ("--fault", "--coupling observer", "--kill", "--localization estimator", "--json", "--pace")
"""Other tests fly these too, in shorter missions."""
JOINED = [command for command in ALL if command.startswith("$FLIGHT/join ")]
SAYS = {
    "rosnode list": r"/octomap\n(.*\n)*/world",
    "rostopic hz": r"average rate: \d+\.\d+\n\s+min: ",
    "rostopic echo": r"yaw_rate: ",
}
"""What each tool must print during a flight."""


def test_the_page_has_no_command_that_is_not_run_here():
    assert set(ALL) == {"make ros", *FLIGHTS, *JOINED}
    assert len(FLIGHTS) == 10
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
    done = subprocess.run(arguments(command, {}), cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "digest" in done.stdout


def listed(folder):
    """Nodes of a flight, once its master is there."""
    return subprocess.run([f"{folder}/join", "rosnode", "list"], capture_output=True, text=True, check=False).stdout


@pytest.fixture(scope="module")
def flight():
    """Folder of a running flight that all look at."""
    with subprocess.Popen(
        arguments(LOOKED_AT, {}), stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
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
        assert {f"/{node}" for node in (*NODES, "world")} <= set(output.split())
