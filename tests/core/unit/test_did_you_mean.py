"""Every place that reads a name says what was probably meant, and what is allowed."""

import pytest

from mavfi.analysis.runs import Runs
from mavfi.analysis.views import table
from mavfi.campaign.config import Campaign
from mavfi.campaign.requirement import Requirement
from mavfi.cli import run
from mavfi.config import parse
from mavfi.errors import BadInputError
from mavfi.flight.host import host_class
from mavfi.levels.state.drawing import stage_target
from mavfi.report.figures import drawing

COMMANDS = [
    ("fyl", "fly"),
    ("campaign rnu", "run"),
    ("fly --enviroment sparse", "--environment"),
    ("fly --environment dence", "dense"),
    ("fly --planner rrt_conect", "rrt_connect"),
    ("fly --protection ful", "full"),
    ("fly --detector recomended", "recommended"),
    ("fly --detector gaussian --profile tunned", "tuned"),
    ("fly --fault stat:planning.waypoint", "state"),
    ("fly --fault state:planning.waypont.x", "planning.waypoint"),
    ("fly --fault sensor:gyro:drft", "drift"),
    ("fly --fault message:control.command:dop", "drop"),
    ("fly --fault instruction:pid:model=zeros", "zero"),
    ("states --autopilot publishd", "published"),
    ("campaign run smoek", "smoke"),
    ("campaign run smoke --scale quik", "quick"),
    ("campaign run smoke --executor locl", "local"),
    ("campaign run smoke --require 'succes > 5 %'", "success"),
    ("completion bahs", "bash"),
]


@pytest.mark.parametrize(("line", "meant"), COMMANDS)
def test_a_command_with_a_misspelt_name(line, meant, capsys, tmp_path, monkeypatch):
    import shlex

    monkeypatch.chdir(tmp_path)
    assert run(shlex.split(line)) == 2
    (message,) = capsys.readouterr().err.splitlines()
    assert f"(did you mean {meant!r}?)" in message
    assert "allowed: " in message or "--help" in message
    assert not list(tmp_path.iterdir()), "nothing is left"


def campaign(**changes):
    return parse(Campaign, {"name": "c", "environments": ["sparse"], **changes}, "c.yaml")


READ = [
    (lambda: campaign(mision={}), "mission"),
    (lambda: campaign(environments=["spars"]).spec("sparse", 1, {"planer": "rrt"}), "planner"),
    (lambda: campaign(sampling={"level": "stat"}), "state"),
    (lambda: campaign(scales={"paper": {"mission": 3}}), "missions"),
    (lambda: campaign(parts={"spars": {"environment": "sparse"}}), "sparse"),
    (lambda: Requirement.parse("succes > 90 %"), "success"),
    (lambda: table(Runs.of([]), "succes"), "success"),
    (lambda: drawing("kernel"), "kernels"),
    (lambda: stage_target("planing", "published"), "planning"),
    (lambda: host_class("ros_2"), "ros2"),
]


@pytest.mark.parametrize(("read", "meant"), READ)
def test_a_file_or_call_with_a_misspelt_name(read, meant):
    with pytest.raises(BadInputError) as refused:
        read()
    assert f"(did you mean {meant!r}?)" in str(refused.value)
