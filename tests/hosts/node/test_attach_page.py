"""Every command of docs/ros-attach.md, run as it stands there against robot_state_publisher."""

import inspect
import re
import signal
import subprocess

import pytest

from tests.hosts.node import test_node_campaign
from tests.hosts.ros1.needs import environment
from tests.pages import arguments, commands

pytestmark = [pytest.mark.ros, pytest.mark.slow]
ALL = commands("ros-attach.md")
CAMPAIGN = [command for command in ALL if command.startswith(("mavfi campaign ", "mavfi report "))]
"""Minutes long; `test_node_campaign` runs the same file with fewer trials."""
SAYS = {
    "mavfi ros list": r"/robot_state_publisher",
    "--at 10": r"message 10: position\[0\] \(float64\) bit 51: 0.5 → 0.75, \d readers, verified",
    "--rate 0.01": r"[Tt]he graph is as it was",
    "--rate 1 --to": r"[Tt]he graph is as it was",
    "mavfi inject": r"mm\d+",
    "rosbag record": r"",
    "--train normal.bag": r"",
    "--learn 10": r"",
}
"""What each command must say; the last two are silent while nothing is wrong."""
LASTS_S, LEARNS_S = 5.0, 13.0
"""How long those are let run that go on until Ctrl-C (s): those that learn for 10 s of it, longer."""


def test_the_page_has_no_command_that_is_not_run_here():
    assert len(CAMPAIGN) == 2 and all("ros_robot_state_publisher" in command for command in CAMPAIGN)
    assert 'load_campaign("ros_robot_state_publisher")' in inspect.getsource(test_node_campaign)
    others = [command for command in ALL if command not in CAMPAIGN]
    assert all(sum(key in command for key in SAYS) == 1 for command in others)
    assert len(others) == len(SAYS)


def order(command):
    """As on the page, but the fault in a register, of which the target may die, is the last one."""
    return "inject" in command, ALL.index(command)


def test_the_commands_of_the_page(arm, tmp_path):
    for command in sorted(set(ALL) - set(CAMPAIGN), key=order):
        process = subprocess.Popen(
            arguments(command, {}), cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
            env=environment(),
        )  # fmt: skip
        try:
            out, err = process.communicate(
                timeout=60 if "record" in command else LEARNS_S if "--learn" in command else LASTS_S
            )
            ended = (0,)
        except subprocess.TimeoutExpired:
            process.send_signal(signal.SIGINT)
            out, err = process.communicate(timeout=30)
            ended = (0, 130)
        says = next(text for key, text in SAYS.items() if key in command)
        assert process.returncode in ended, f"{command}: {process.returncode}: {err}"
        assert re.search(says, out + err), f"{command}: {out}{err}"
