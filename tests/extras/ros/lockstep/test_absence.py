"""Without ROS everything else works, and the verbs for ROS say what to do."""

import re
import shlex
from pathlib import Path

import pytest

from mavfi.cli import run
from mavfi.errors import BadInputError
from mavfi.extras.ros.cli import middleware_of, mission_with
from mavfi.extras.ros.ros1 import finder
from mavfi.extras.ros.ros1.transport import Ros1
from mavfi.extras.ros.ros2 import environment
from mavfi.extras.ros.ros2.transport import Ros2
from mavfi.mission import MissionSpec
from tests.core.architecture.source import ROOT


@pytest.fixture
def without_ros(monkeypatch):
    """Neither ROS is installed."""
    monkeypatch.setattr(finder, "missing", lambda: ["rospy"])
    monkeypatch.setattr(environment, "installations", lambda: iter(()))


@pytest.mark.parametrize(("number", "remedy"), [("1", "make ros"), ("2", "mavfi ros setup")])
def test_no_ros_is_one_line_and_exit_code_2(without_ros, capsys, number, remedy):
    assert run(["ros", "fly", "--ros", number]) == 2
    text = capsys.readouterr().err
    assert text.count("\n") == 1 and remedy in text


def test_without_a_choice_it_is_ros_2_if_there_is_one(monkeypatch):
    there = environment.Installation("jazzy", "python3", Path("/nowhere"), {})
    monkeypatch.setattr(environment, "installations", lambda: iter([there]))
    assert middleware_of("").title == "ROS 2 jazzy"
    assert middleware_of("1").title == "ROS 1"
    monkeypatch.setattr(environment, "installations", lambda: iter(()))
    assert middleware_of("").title == "ROS 1"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--kill", "octomap"], "NODE@SECONDS"),
        (["--kill", "octomap@nan"], "NODE@SECONDS"),
        (["--kill", "world@3"], "allowed: point_cloud, octomap"),
        (["--coupling", "observer"], "--detector"),
        (["--pace", "-1"], "--pace"),
        (["--ros", "3"], "--ros: '3': not known; allowed: 2, 1"),
        (["--register-fault", "octomap@-1"], "NODE@SECONDS"),
        (["--register-fault", "rviz@5"], "allowed: point_cloud, octomap"),
        (["--register-fault", "octomap@5", "--registers", "xmm"], "allowed: all, general, fp"),
        (["--register-seed", "3"], "with --register-fault only"),
        (["--fault-seed", "3"], "--fault"),
        (["--save", "flight.txt"], ".npz"),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(capsys, monkeypatch, arguments, message):
    monkeypatch.setattr(finder, "missing", list)
    monkeypatch.setattr(environment, "installations", lambda: iter(()))
    assert run(["ros", "fly", *arguments]) == 2
    text = capsys.readouterr().err
    assert text.count("\n") == 1 and message in text


COMMANDS = re.findall(
    r"^    (mavfi ros .+)$", (ROOT / "docs" / "how-to" / "ros.md").read_text(encoding="utf-8"), re.MULTILINE
)


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_of_the_page_is_accepted(monkeypatch, command):
    class FlyingError(Exception):
        pass

    def fly(plan, **options):
        del options
        raise FlyingError(plan)

    monkeypatch.setattr(Ros1, "require", lambda ros: None)
    monkeypatch.setattr(Ros2, "require", lambda ros: None)
    monkeypatch.setattr(environment, "installations", lambda: iter([environment.Installation("", "", Path(), {})]))
    monkeypatch.setattr("mavfi.extras.ros.lockstep.host.fly", fly)
    with pytest.raises(FlyingError) as stopped:
        run(shlex.split(command)[1:])
    (plan,) = stopped.value.args
    assert plan.scenario.seed == 7
    assert ("--kill" in command) == bool(plan.kills)
    assert ("observer" in command) == (plan.recovery.coupling == "observer")
    assert plan.pace == ("--pace 1" in command)
    assert plan.middleware.name == ("ros1" if "--ros 1" in command else "ros2")


def test_the_grain_of_a_detector_is_one_that_nodes_have():
    assert mission_with(MissionSpec(), "recommended").grain == "kernel"
    assert mission_with(MissionSpec(grain="stage"), "recommended").grain == "stage"
    with pytest.raises(BadInputError, match="grain: 'message': on ROS"):
        mission_with(MissionSpec(grain="message"), "recommended")
    with pytest.raises(BadInputError, match="detector_place: 'published': not on ROS; allowed: consumer"):
        mission_with(MissionSpec(detector_place="published"), "recommended")
