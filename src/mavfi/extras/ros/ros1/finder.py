"""Where ROS 1 is: Debian's packages, installed or unpacked into a folder.  Only listed modules are imported from it."""

import os
from collections.abc import Iterable
from importlib.machinery import PathFinder
from pathlib import Path

from mavfi.errors import BadInputError
from mavfi.extras.ros.imports import Finder

ROOT_VARIABLE = "MAVFI_ROS_ROOT"
"""Environment variable: folder of unpacked Debian packages, for systems on which they are not installed."""
DIST_PACKAGES = Path("usr/lib/python3/dist-packages")
WORKSPACE_MARK = Path("usr/.catkin")
"""Marker file by which catkin recognizes an installation prefix."""
_ROS = (
    "rospy",
    "rosgraph",
    "rosgraph_msgs",
    "roslib",
    "rosmaster",
    "roscpp",
    "genpy",
    "genmsg",
    "catkin",
    "std_msgs",
    "geometry_msgs",
    "nav_msgs",
    "sensor_msgs",
    "tf2_msgs",
    "trajectory_msgs",
    "visualization_msgs",
)
_HELPERS = ("rospkg", "catkin_pkg", "yaml", "defusedxml", "netifaces", "Cryptodome", "gnupg", "distro")
ALLOWED = frozenset((*_ROS, *_HELPERS))
"""Top-level names imported from Debian unless installed in this environment."""
NEEDED_MODULES = ("rospy", "genpy", "std_msgs", "yaml")
NEEDED_FILES = ("usr/bin/rosmaster",)
_SYSTEM = Path("/")
_LIBRARIES = ("usr/lib/x86_64-linux-gnu", "usr/lib", "lib/x86_64-linux-gnu")


def own_root() -> Path:
    """Folder into which `make ros` unpacks packages if the user may not install them."""
    named = os.environ.get(ROOT_VARIABLE)
    cache = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    if named:
        return Path(named)
    return Path(cache) / "mavfi" / "ros"


def roots() -> list[Path]:
    """Installation prefixes of Debian's packages, in order of preference."""
    root = own_root()
    if (root / "usr").is_dir():
        return [root, _SYSTEM]
    return [_SYSTEM]


def find_file(name: str) -> Path:
    """Path of a ROS file, e.g. "usr/bin/rosmaster"; a missing file yields its path under the system prefix."""
    for root in roots():
        if (root / name).exists():
            return root / name
    return _SYSTEM / name


def enable() -> None:
    """Make ROS importable in this process."""
    _finder().enable()
    os.environ.setdefault("ROS_PACKAGE_PATH", environment()["ROS_PACKAGE_PATH"])


def missing() -> list[str]:
    """Missing parts of ROS, determined without importing."""
    finder = _finder()
    modules = [name for name in NEEDED_MODULES if PathFinder.find_spec(name) is None and finder.find_spec(name) is None]
    return modules + [name for name in NEEDED_FILES if not find_file(name).is_file()]


def _finder() -> Finder:
    return Finder([root / DIST_PACKAGES for root in roots()], ALLOWED.__contains__)


def require() -> None:
    """Check that ROS is installed.

    Raises:
        BadInputError: It is not; the message names the remedy.
    """
    absent = missing()
    if absent:
        raise BadInputError(
            f"ROS is not installed ({absent[0]} is missing): run `make ros` on Debian 12, or name the folder into "
            f"which its packages were unpacked in {ROOT_VARIABLE}"
        )


def environment() -> dict[str, str]:
    """Additional environment variables of ROS programs."""
    folders = roots()
    variables = {"ROS_PACKAGE_PATH": _path(root / "usr/share" for root in folders)}
    if len(folders) > 1:
        unpacked = folders[0]
        variables["PYTHONPATH"] = str(unpacked / DIST_PACKAGES)
        # for the programs that they start
        variables["PATH"] = os.pathsep.join([str(unpacked / "usr/bin"), os.environ.get("PATH", os.defpath)])
        variables["LD_LIBRARY_PATH"] = _path(unpacked / name for name in _LIBRARIES)
        variables["CMAKE_PREFIX_PATH"] = _path(root / "usr" for root in folders)
    return variables


def _path(folders: Iterable[Path]) -> str:
    return os.pathsep.join(str(folder) for folder in folders)
