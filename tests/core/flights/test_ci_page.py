"""The workflow of the page on CI, as it stands there, and what its campaign says."""

import os
import shlex
import subprocess
import sys

import pytest
import yaml

from mavfi.campaign.config import load_campaign
from mavfi.campaign.requirement import MEASURES
from tests.core.architecture.source import ROOT

EXAMPLE = ROOT / "examples" / "ci"
PAGE = ROOT / "docs" / "how-to" / "ci.md"


def test_the_page_lists_every_measure_and_the_campaign_its_requirements():
    page = PAGE.read_text()
    assert [name for name in MEASURES if f"`{name}`" not in page] == []
    assert [
        text for text in load_campaign(EXAMPLE / "faults.yaml").require if f"    holds      {text}: " not in page
    ] == []


@pytest.mark.slow
@pytest.mark.long
def test_the_steps_of_the_workflow_run(tmp_path):
    steps = yaml.safe_load((EXAMPLE / "faults-workflow.yml").read_text())["jobs"]["faults"]["steps"]
    install, *commands = [step["run"] for step in steps if "run" in step]
    assert install == "pip install mavfi"
    (tmp_path / "faults.yaml").write_text((EXAMPLE / "faults.yaml").read_text())
    printed = ""
    for command in commands:
        program, *arguments = shlex.split(command)
        assert program == "mavfi"
        printed += subprocess.run(
            [sys.executable, "-m", "mavfi", *arguments],
            cwd=tmp_path,
            env=os.environ,
            check=True,
            capture_output=True,
            text=True,
        ).stdout
    page = PAGE.read_text()
    verdicts = [line for line in printed.splitlines() if line.startswith("holds ")]
    assert len(verdicts) == 2 and [line for line in verdicts if line not in page] == []
    assert (tmp_path / "faults.xml").exists() and (tmp_path / "faults.html").exists()
