"""`mavfi init`: what it writes works as it is."""

import subprocess
import sys

import pytest
import yaml

from mavfi.campaign.begin import check_names
from mavfi.campaign.config import Scale, load_campaign
from mavfi.campaign.executors.local import LocalExecutor
from mavfi.cli import run
from mavfi.cli.init import SCHEMAS, templates
from tests.campaigns import run_campaign

GOAL = (12.0, 0.0, 3.0)
"""Near the start, so that flights are short (m)."""
CORE = ("campaign", "detector", "planner")


@pytest.fixture
def started(tmp_path, monkeypatch, capsys):
    """Write a template to a folder, and go there; gives what was printed."""

    def start(name):
        monkeypatch.chdir(tmp_path)
        assert run(["init", name, "here"]) == 0
        monkeypatch.chdir(tmp_path / "here")
        monkeypatch.setattr(sys, "path", [*sys.path, str(tmp_path / "here")])
        return capsys.readouterr().out

    yield start
    for module in ("my_detector", "my_planner"):
        sys.modules.pop(module, None)


@pytest.mark.parametrize("name", CORE)
def test_a_template_is_flown_as_it_is(name, started, tmp_path, monkeypatch):
    monkeypatch.setenv("MAVFI_ALLOW_PLUGINS", "all")
    text = started(name)
    assert "mavfi campaign run campaign.yaml" in text and "cd here" in text
    campaign = load_campaign("campaign.yaml")
    check_names(campaign, "campaign.yaml")
    short = {"mission": {**campaign.mission, "goal": GOAL}, "null_runs": 0}
    small = campaign.resized(Scale(missions=1, faults=1)).model_copy(update=short)
    status = run_campaign(small, tmp_path / "out", executor=LocalExecutor(1))
    assert status.complete and not status.unknown


@pytest.mark.parametrize("name", ["detector", "planner"])
def test_the_contract_suite_of_a_template_passes(name, started):
    text = started(name)
    assert f"python -m pytest test_my_{name}.py" in text
    suite = [sys.executable, "-m", "pytest", "-q", f"test_my_{name}.py"]
    result = subprocess.run(suite, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stdout


@pytest.mark.parametrize("name", CORE)
def test_a_template_has_the_schema_for_editors(name):
    lines = (templates()[name] / "campaign.yaml").read_text().splitlines()
    assert lines[0] == "# yaml-language-server: $schema=SCHEMAS/campaign.json"
    assert (SCHEMAS / "campaign.json").is_file()
    content = yaml.safe_load("\n".join(lines))
    assert content["name"]


def test_nothing_is_overwritten(started, tmp_path, capsys):
    started("detector")
    path = tmp_path / "here" / "my_detector.py"
    path.write_text("# mine\n")
    (tmp_path / "here" / "campaign.yaml").unlink()
    assert run(["init", "detector", str(tmp_path / "here")]) == 2
    assert "my_detector.py: exists; allowed: a folder without it" in capsys.readouterr().err
    assert path.read_text() == "# mine\n" and not (tmp_path / "here" / "campaign.yaml").exists()
    assert run(["init", "nonsense", str(tmp_path / "none")]) == 2 and not (tmp_path / "none").exists()
