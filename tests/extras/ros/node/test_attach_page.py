"""Every command on ROS 1 of docs/how-to/ros2.md, run as it stands there against robot_state_publisher."""

import re
import signal
import subprocess
import threading

import pytest

from tests.extras.ros.ros1.needs import environment
from tests.pages import arguments, commands

pytestmark = [pytest.mark.ros, pytest.mark.slow]
ALL = commands("how-to/ros2.md", "## ROS 1")
SAYS = {
    "mavfi ros list": r"/robot_state_publisher",
    "--at n=10": r"message 10: position\[0\] \(float64\): 0.5 → 0.75, \d readers, verified",
    "--share 0.01": r"[Tt]he graph is as it was",
    "mavfi inject": r"mm\d+",
    "rosbag record": r"",
    "--train normal.bag": r"",
}
"""What each command must say; the last two are silent while nothing is wrong."""
WORKS = {
    "--share 0.01": r"message \d+: .*position\[0\]",
    "--train": r"learned from \d+",
}
"""Output of the commands that run until Ctrl-C, once they work."""
READING = ("mavfi ros list", "rosbag record")
"""These change nothing: they run at the same time."""
LONGEST_S = 90.0


def test_the_page_has_no_command_that_is_not_run_here():
    assert all(sum(key in command for key in SAYS) == 1 for command in ALL)
    assert len(ALL) == len(SAYS)


def begun(command, folder):
    return subprocess.Popen(
        arguments(command, {}),
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env=environment(),
    )


def check(command, process):
    """Wait for its end, or until it works and then for its end after Ctrl-C; it says what it must."""
    works = next((text for key, text in WORKS.items() if key in command), "")
    limit = threading.Timer(LONGEST_S, process.kill)
    limit.start()
    output, asked = "", False
    with process:
        for line in process.stdout:
            output += line
            if works and not asked and re.search(works, output):
                process.send_signal(signal.SIGINT)
                asked = True
    limit.cancel()
    assert asked == bool(works), f"{command}: {output}"
    assert process.returncode in ((0, 130) if asked else (0,)), f"{command}: {process.returncode}: {output}"
    says = next(text for key, text in SAYS.items() if key in command)
    assert re.search(says, output), f"{command}: {output}"


def test_the_commands_of_the_page(arm, tmp_path):
    """The fault in a register, of which the target may die, is the last one."""
    own = list(ALL)
    reading = [command for command in own if any(key in command for key in READING)]
    assert len(reading) == len(READING)
    for command, process in [(command, begun(command, tmp_path)) for command in reading]:
        check(command, process)
    for command in sorted(set(own) - set(reading), key=lambda command: ("inject" in command, own.index(command))):
        check(command, begun(command, tmp_path))
