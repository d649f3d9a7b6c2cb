"""`mavfi init node` writes a node and a campaign that run as they are."""

import shutil

import pytest

from mavfi.cli import run
from mavfi.errors import BadInputError
from mavfi.extras.ros.processes import private_network
from mavfi.extras.ros.ros2.environment import DISTRIBUTIONS, find_installation
from mavfi.extras.ros.templates import NODE


@pytest.mark.slow
def test_the_node_is_flown_as_it_is(tmp_path, monkeypatch, capsys):
    try:
        find_installation(DISTRIBUTIONS[0])
        private_network()
    except BadInputError as error:
        pytest.skip(str(error))
    shutil.copytree(NODE, tmp_path / "node", ignore=shutil.ignore_patterns("__pycache__"))
    monkeypatch.chdir(tmp_path / "node")
    assert run(["campaign", "run", "campaign.yaml", "--out", "out", "--allow-plugins", "--workers", "1"]) == 0
    assert "SDC" in capsys.readouterr().out
