"""The tutorial on a ROS 2 application, as a newcomer follows it."""

import pytest

from mavfi.errors import BadInputError
from mavfi.extras.ros.processes import private_network
from mavfi.extras.ros.ros2.environment import find_installation
from tests.pages import follow

PAGE = "tutorials/ros2.md"
FEWER = ((r"faults: \d+", "faults: 1"),)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """An empty working directory on a machine that can fly the campaign, and a user who has allowed nothing."""
    try:
        find_installation()
        private_network()
    except BadInputError as error:
        pytest.skip(str(error))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.delenv("MAVFI_ALLOW_PLUGINS", raising=False)
    return tmp_path


@pytest.mark.ros
@pytest.mark.slow
@pytest.mark.long
@pytest.mark.parametrize("fewer", [FEWER, ()], ids=["small", "whole"])
def test_the_tutorial_can_be_followed(folder, capsys, fewer):
    follow(PAGE, folder, capsys, fewer)
