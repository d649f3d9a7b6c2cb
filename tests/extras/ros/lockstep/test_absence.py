"""Without ROS everything else works, and the verbs for ROS say what to do."""

import re
import shlex

import pytest

from mavfi.cli import run
from mavfi.errors import BadInputError
from mavfi.extras.ros.cli import mission_with
from mavfi.extras.ros.lockstep.transport import Middleware
from mavfi.extras.ros.ros2 import environment
from mavfi.mission import MissionSpec
from tests.core.architecture.source import ROOT
from tests.extras.ros.lockstep.needs import NOWHERE


@pytest.fixture
def pretended(monkeypatch):
    """An installation that no flight uses."""
    monkeypatch.setattr(environment, "installations", lambda: iter([NOWHERE.installation]))
    monkeypatch.setattr(Middleware, "require", lambda middleware: None)


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
        (["--ros", "1"], "--ros: dropped; no replacement: nodes are those of ROS 2"),
        (["--register-fault", "octomap@-1"], "NODE@SECONDS"),
        (["--register-fault", "rviz@5"], "allowed: point_cloud, octomap"),
        (["--register-fault", "octomap@5", "--registers", "xmm"], "allowed: all, general, fp"),
        (["--register-seed", "3"], "with --register-fault only"),
        (["--fault-seed", "3"], "--fault"),
        (["--save", "flight.txt"], ".npz"),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(pretended, capsys, arguments, message):
    assert run(["ros", "fly", *arguments]) == 2
    text = capsys.readouterr().err
    assert text.count("\n") == 1 and message in text


PAGE = (ROOT / "docs" / "how-to" / "ros2.md").read_text(encoding="utf-8")
COMMANDS = re.findall(r"^    (mavfi ros fly .+)$", PAGE, re.MULTILINE)


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_of_the_page_is_accepted(pretended, monkeypatch, command):
    class FlyingError(Exception):
        pass

    def fly(plan, **options):
        del options
        raise FlyingError(plan)

    monkeypatch.setattr("mavfi.extras.ros.lockstep.host.fly", fly)
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
