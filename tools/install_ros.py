"""`make ros`: installs Debian's ROS 1 packages, or unpacks them into a folder without root rights; verifies them.

Then environments with ROS 2, where there is none.
"""

import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from mavfi.errors import BadInputError, MavfiError
from mavfi.extras.ros.ros1 import finder
from mavfi.extras.ros.ros2.environment import DISTRIBUTIONS
from mavfi.extras.ros.ros2.setup import install as install_ros2

_PYTHON = (
    "rosmaster",
    "rospy",
    "rosbag",
    "rostopic",
    "rosnode",
    "rosmsg",
    "rosservice",
    "rosparam",
    "std-msgs",
    "sensor-msgs",
    "tf2-msgs",
    "geometry-msgs",
    "nav-msgs",
    "trajectory-msgs",
    "visualization-msgs",
    "std-srvs",
    "rosgraph-msgs",
    "genpy",
    "genmsg",
)
_DEFINITIONS = ("std-msgs", "sensor-msgs", "tf2-msgs", "rosgraph-msgs", "robot-state-publisher")
PACKAGES = ("topic-tools", *map("python3-{}".format, _PYTHON), *map("ros-{}".format, _DEFINITIONS))
"""Nodes and tools; `robot_state_publisher` is the example of a node of others."""


def main() -> int:
    """Install what is missing of ROS 1 and ROS 2, each as far as possible, and report the results."""
    return max(_install_ros1(), _install_ros2())


def _install_ros2() -> int:
    """Make an environment per distribution, and report each in one line."""
    code = 0
    for distribution in DISTRIBUTIONS:
        try:
            installation = install_ros2(distribution, lambda line: None)
        except MavfiError as error:
            sys.stderr.write(f"make ros: {error}\n")
            code = 2
        else:
            sys.stdout.write(f"ROS 2 {installation.distribution} is here: {installation.prefix}\n")
    return code


def _install_ros1() -> int:
    """Install missing packages of Debian, and report the result in one line."""
    try:
        missing = finder.missing()
        if missing:
            install()
        finder.require()
    except MavfiError as error:
        sys.stderr.write(f"make ros: {error}\n")
        return 2
    if not missing:
        how = "was here"
    elif os.geteuid() == 0:
        how = "installed"
    else:
        how = f"unpacked into {finder.own_root()}"
    sys.stdout.write(f"ROS 1 {version()} {how}: {finder.find_file('usr/bin/rosmaster')}\n")
    return 0


def install() -> None:
    """Install with this user's rights; raises `MavfiError` if apt is missing or fails."""
    if os.geteuid() == 0:
        variables = {**os.environ, "DEBIAN_FRONTEND": "noninteractive"}
        _run(["apt-get", "update", "-qq"], environment=variables)
        _run(["apt-get", "install", "-y", "-qq", "--no-install-recommends", *PACKAGES], environment=variables)
        return
    unpack(finder.own_root())


def unpack(folder: Path, status: Path = Path("/var/lib/dpkg/status")) -> int:
    """Download missing packages and unpack them into a folder, without root rights; returns their number.

    `status` lists the installed packages in dpkg's format.
    """
    # apt keeps its lists and packages in the folder, so that it needs no root rights
    state = folder / "apt" / "state"
    cache = folder / "apt" / "cache"
    for directory in (state / "lists" / "partial", cache / "archives" / "partial"):
        directory.mkdir(parents=True, exist_ok=True)
    options = [
        "-qq",
        "-o",
        f"Dir::State={state}",
        "-o",
        f"Dir::State::status={status}",
        "-o",
        f"Dir::Cache={cache}",
        "-o",
        "Debug::NoLocking=1",
        "-o",
        "APT::Sandbox::User=",
    ]

    # which packages are missing: those that a simulated installation would install
    _run(["apt-get", *options, "update"])
    planned = _run(["apt-get", *options, "install", "--simulate", "--no-install-recommends", *PACKAGES])
    packages = [line.split()[1] for line in planned.splitlines() if line.startswith("Inst ")]

    # download and unpack them
    archives = cache / "archives"
    if packages:
        _run(["apt-get", *options, "download", *packages], cwd=archives)
    for archive in sorted(archives.glob("*.deb")):
        _run(["dpkg", "-x", str(archive), str(folder)])
        archive.unlink()
    (folder / finder.WORKSPACE_MARK).touch()  # otherwise rosbag searches its executables only under /usr
    return len(packages)


def version() -> str:
    """Version of Debian's rospy."""
    folders = [root / finder.DIST_PACKAGES for root in finder.roots()]
    for folder in folders:
        for path in folder.glob("rospy-*.egg-info"):
            return path.name.split("-")[1].removesuffix(".egg")
    return ""


def _run(command: Sequence[str], *, cwd: Path | None = None, environment: dict[str, str] | None = None) -> str:
    try:
        done = subprocess.run(command, cwd=cwd, env=environment, capture_output=True, text=True, check=False)
    except FileNotFoundError:
        raise BadInputError(f"{command[0]}: not found: ROS comes from Debian 12's packages") from None
    if done.returncode != 0:
        last = (done.stderr.strip() or done.stdout.strip() or "no message").splitlines()[-1]
        raise MavfiError(f"{' '.join(command[:2])}: {last}")
    return done.stdout


if __name__ == "__main__":
    sys.exit(main())
