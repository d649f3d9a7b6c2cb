"""The roslaunch file of a flight, and the package that roslaunch finds its nodes in."""

import shlex
import sys
from pathlib import Path

from mavfi.hosts.node.nodelets import point_cloud_xyz
from mavfi.hosts.ros1.folder import LAUNCH_FILE, own_path
from mavfi.hosts.ros1.foreign import IMAGE, INFO, POINTS
from mavfi.hosts.ros1.graph import WORLD
from mavfi.hosts.ros1.plan import Plan

PACKAGE = "mavfi"
_EXECUTABLE = "node"


def launch_text(plan: Plan) -> str:
    """The launch file: nodes come back when they die, but when the world ends so does the flight."""
    lines = ["<launch>", '  <param name="/use_sim_time" value="true"/>']
    lines.append(f'  <node pkg="{PACKAGE}" type="{_EXECUTABLE}" name="{WORLD}" args="{WORLD}" required="true"/>')
    lines += [
        f'  <node pkg="{PACKAGE}" type="{_EXECUTABLE}" name="{node}" args="{node}" respawn="true" respawn_delay="0"/>'
        for node in plan.nodes
    ]
    lines += [
        f'  <node pkg="{PACKAGE}" type="{node}" name="{node}" respawn="true" respawn_delay="0"/>'
        for node in plan.foreign
    ]
    return "\n".join([*lines, "</launch>", ""])


def write_package(plan: Plan, folder: Path) -> Path:
    """Write launch file and package into a flight's folder.

    Returns:
        The launch file.
    """
    package = folder / PACKAGE
    package.mkdir()
    (package / "package.xml").write_text(
        f'<package format="2"><name>{PACKAGE}</name><version>1.0.0</version><description>Generated.</description>'
        '<maintainer email="mavfi@localhost">mavfi</maintainer><license>Apache-2.0</license></package>\n'
    )
    executable = package / _EXECUTABLE
    executable.write_text(
        f'#!/bin/sh\nPYTHONPATH="{own_path()}" exec "{sys.executable}" -m mavfi.hosts.ros1.node "$@"\n'
    )
    executable.chmod(0o755)
    for node in plan.foreign:
        _write_foreign(package / node, folder)
    path = folder / LAUNCH_FILE
    path.write_text(launch_text(plan))
    return path


def _write_foreign(executable: Path, folder: Path) -> None:
    """Write the script that becomes Debian's nodelet; roslaunch adds its name to the arguments."""
    command, variables = point_cloud_xyz(
        folder / "nodelets", {"image_rect": IMAGE, "camera_info": INFO, "points": POINTS}
    )
    settings = [f"{name}={value}" for name, value in variables.items()]
    executable.write_text(f'#!/bin/sh\nexec env {shlex.join([*settings, *command])} "$@"\n')
    executable.chmod(0o755)
