"""The page on kernels of one's own: its code is that of the example, and its commands fly the example's files."""

import json
import re
import shlex
import shutil

import pytest

from mavfi.campaign.config import load_campaign
from mavfi.cli import run
from mavfi.levels.instruction import campaign_targets
from tests.core.architecture.source import ROOT
from tests.pages import DOCS, commands, importing_from

PAGE = "how-to/own-kernels.md"
EXAMPLE = ROOT / "examples" / "own_kernels"
FLIGHTS = [command for command in commands(PAGE) if command.startswith("mavfi fly")]


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A working directory with the files of the example."""
    shutil.copytree(EXAMPLE, tmp_path, dirs_exist_ok=True)
    with importing_from(tmp_path, monkeypatch):
        yield tmp_path


def test_every_block_of_code_is_from_the_example():
    sources = "".join(path.read_text(encoding="utf-8") for path in EXAMPLE.glob("*.py"))
    blocks = re.findall(r"```python\n(.*?)```", (DOCS / PAGE).read_text(encoding="utf-8"), re.DOTALL)
    assert len(blocks) == 3
    for block in blocks:
        for part in block.split("\n\n\n"):  # as between functions
            assert part.strip("\n") in sources


@pytest.mark.parametrize("command", FLIGHTS[1:2] + FLIGHTS[-1:])
@pytest.mark.long
def test_the_flights_of_the_page_succeed(folder, capsys, command):
    assert run([*shlex.split(command)[1:], "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert data["status"] == "success" and all(injection["activated"] for injection in data["injections"])


def test_the_campaign_of_the_page_names_the_kernels_of_the_example(folder):
    campaign = load_campaign("table1.yaml")
    stages = {target.name: target.stage for target in campaign_targets(campaign)}
    assert {name: stages[name] for name in ("AStar", "VoxelMap", "Jumps")} == {
        "AStar": "planning",
        "VoxelMap": "perception",
        "Jumps": "",
    }
