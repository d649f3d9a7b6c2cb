"""Without ROS everything else works, and the verbs for ROS say what to do; with it, nothing but ROS comes in."""

import re
import shlex
import subprocess
import sys

import pytest

from mavfi.cli import run
from mavfi.errors import BadInputError
from mavfi.extras.ros.cli import mission_with
from mavfi.extras.ros.ros1 import finder
from mavfi.mission import MissionSpec
from tests.core.architecture.source import ROOT
from tests.extras.ros.ros1.needs import ros
from tools import install_ros as install


def python(code, **variables):
    import os

    return subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False, env={**os.environ, **variables}
    )


def test_no_ros_is_one_line_and_exit_code_2(monkeypatch, capsys):
    monkeypatch.setattr(finder, "missing", lambda: ["rospy"])
    assert run(["ros", "fly"]) == 2
    text = capsys.readouterr().err
    assert text.count("\n") == 1
    assert "make ros" in text and finder.ROOT_VARIABLE in text


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--kill", "octomap"], "NODE@SECONDS"),
        (["--kill", "octomap@nan"], "NODE@SECONDS"),
        (["--kill", "world@3"], "allowed: point_cloud, octomap"),
        (["--coupling", "observer"], "--detector"),
        (["--free-running"], "--free-running: dropped; use --pace 1"),
        (["--point-cloud-node", "depth_image_proc"], "--point-cloud-node: dropped; no replacement: attach with"),
        (["--pace", "-1"], "--pace"),
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
    assert run(["ros", "fly", *arguments]) == 2
    text = capsys.readouterr().err
    assert text.count("\n") == 1 and message in text


class TestTheFinder:
    pytestmark = ros

    def test_ros_comes_from_debian_and_numpy_from_here(self):
        code = (
            "import warnings; warnings.simplefilter('ignore')\n"
            "from mavfi.extras.ros.ros1 import finder; finder.enable()\n"
            "import numpy, rospy, yaml\nprint(rospy.__file__, numpy.__file__, yaml.__file__)"
        )
        rospy, numpy, yaml = python(code).stdout.split()
        assert "dist-packages" in rospy
        assert "dist-packages" not in numpy and "dist-packages" not in yaml

    def test_nothing_else_of_debian_comes_in(self):
        code = "from mavfi.extras.ros.ros1 import finder; finder.enable(); import apt_pkg"
        assert "ModuleNotFoundError" in python(code).stderr

    def test_an_installation_that_is_there_is_left_as_it_is(self, capsys):
        assert install.main() == 0
        text = capsys.readouterr().out
        assert text.startswith("ROS 1 1.") and text.count("\n") == 1


COMMANDS = re.findall(r"^    (mavfi ros .+)$", (ROOT / "docs" / "ros.md").read_text(encoding="utf-8"), re.MULTILINE)


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_of_the_page_is_accepted(monkeypatch, command):
    class FlyingError(Exception):
        pass

    def fly(plan, **options):
        del options
        raise FlyingError(plan)

    monkeypatch.setattr(finder, "missing", list)
    monkeypatch.setattr("mavfi.extras.ros.ros1.host.fly", fly)
    with pytest.raises(FlyingError) as stopped:
        run(shlex.split(command)[1:])
    (plan,) = stopped.value.args
    assert plan.scenario.seed == 7
    assert ("--kill" in command) == bool(plan.kills)
    assert ("observer" in command) == (plan.recovery.coupling == "observer")
    assert plan.pace == ("--pace 1" in command)


def test_the_grain_of_a_detector_is_one_that_nodes_have():
    assert mission_with(MissionSpec(), "recommended").grain == "kernel"
    assert mission_with(MissionSpec(grain="stage"), "recommended").grain == "stage"
    with pytest.raises(BadInputError, match="grain: 'message': on ROS"):
        mission_with(MissionSpec(grain="message"), "recommended")
    with pytest.raises(BadInputError, match="detector_place: 'published': not on ROS; allowed: consumer"):
        mission_with(MissionSpec(detector_place="published"), "recommended")
