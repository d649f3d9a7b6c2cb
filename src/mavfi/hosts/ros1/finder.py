"""Makes Debian's ROS modules importable, but no other Python packages of Debian.

`PYTHONPATH=/usr/lib/python3/dist-packages` would put Debian's numpy before this project's.  So an import finder stands
at the end of `sys.meta_path`, after everything that is installed here, and knows only the names on its list.
"""

import os
import sys
from collections.abc import Iterable, Sequence
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder
from pathlib import Path
from types import ModuleType

from mavfi.errors import BadInputError

ROOT_VARIABLE = "MAVFI_ROS_ROOT"
"""Environment variable: folder into which Debian's packages were unpacked; without it, they are installed."""
DIST_PACKAGES = Path("usr/lib/python3/dist-packages")
WORKSPACE_MARK = Path("usr/.catkin")
"""File by which catkin knows a folder in which packages are installed."""
GENERATED = ("mavfi_msgs", "nav_msgs")
"""Packages that are generated for a flight: ours, and one whose Debian package would pull in 144 MB."""
_ROS = (
    "rospy", "rosgraph", "rosgraph_msgs", "roslib", "rosmaster", "roslaunch", "rosnode", "rostopic", "rosparam",
    "rosservice", "rosbag", "rosmsg", "rosclean", "roslz4", "roscpp", "genpy", "genmsg", "catkin",
)  # fmt: skip
_MESSAGES = (
    "std_msgs", "std_srvs", "geometry_msgs", "sensor_msgs", "trajectory_msgs", "visualization_msgs",
    "diagnostic_msgs", "tf2_msgs", "actionlib_msgs", "map_msgs",
)  # fmt: skip
_HELPERS = ("rospkg", "catkin_pkg", "yaml", "defusedxml", "netifaces", "Cryptodome", "gnupg", "distro")
ALLOWED = frozenset((*_ROS, *_MESSAGES, *_HELPERS))
"""Top-level names that come from Debian where they are not installed here."""
NEEDED_MODULES = ("rospy", "genpy", "genmsg", "std_srvs", "sensor_msgs", "trajectory_msgs", "tf2_msgs", "yaml")
NEEDED_FILES = ("usr/bin/roslaunch", "usr/bin/rosmaster", "usr/share/nav_msgs/msg/Odometry.msg")
_SYSTEM = Path("/")
_LIBRARIES = ("usr/lib/x86_64-linux-gnu", "usr/lib", "lib/x86_64-linux-gnu")


class Finder(MetaPathFinder):
    """Finds the modules on the list in Debian's folders, and generated message packages in theirs."""

    def __init__(self, dist_packages: Sequence[Path], generated: Path | None = None) -> None:
        self.dist_packages = [str(folder) for folder in dist_packages]
        self.generated = generated

    def find_spec(
        self, fullname: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """The module, if it is a top-level one on the list."""
        if path is not None:
            return None
        if fullname in GENERATED and self.generated is not None:
            return PathFinder.find_spec(fullname, [str(self.generated)])
        if fullname in ALLOWED:
            return PathFinder.find_spec(fullname, self.dist_packages)
        return None


def own_root() -> Path:
    """Folder into which `make ros` unpacks packages where it may not install them."""
    named = os.environ.get(ROOT_VARIABLE)
    cache = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(named) if named else Path(cache) / "mavfi" / "ros"


def roots() -> list[Path]:
    """Folders under which Debian's packages may lie, the preferred one first."""
    own = own_root()
    return [own, _SYSTEM] if (own / "usr").is_dir() else [_SYSTEM]


def find_file(name: str) -> Path:
    """A file of ROS, e.g. "usr/bin/roslaunch"; a missing one as if it were in the system."""
    return next((path for root in roots() if (path := root / name).exists()), _SYSTEM / name)


def enable(generated: Path | None = None) -> None:
    """Make ROS importable in this process, with a folder of generated message packages."""
    here = [finder for finder in sys.meta_path if isinstance(finder, Finder)]
    if here:
        here[0].generated = generated or here[0].generated
    else:
        sys.meta_path.append(Finder([root / DIST_PACKAGES for root in roots()], generated))
    os.environ.setdefault("ROS_PACKAGE_PATH", environment()["ROS_PACKAGE_PATH"])


def missing() -> list[str]:
    """Missing parts of ROS; nothing is imported."""
    finder = Finder([root / DIST_PACKAGES for root in roots()])
    modules = [name for name in NEEDED_MODULES if PathFinder.find_spec(name) is None and finder.find_spec(name) is None]
    return modules + [name for name in NEEDED_FILES if not find_file(name).is_file()]


def require() -> None:
    """Check that ROS is installed.

    Raises:
        BadInputError: It is not; the line says what to do.
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
        own = folders[0]
        variables["PYTHONPATH"] = str(own / DIST_PACKAGES)
        # roslaunch runs rosversion
        variables["PATH"] = os.pathsep.join([str(own / "usr/bin"), os.environ.get("PATH", os.defpath)])
        variables["LD_LIBRARY_PATH"] = _path(own / name for name in _LIBRARIES)
        variables["CMAKE_PREFIX_PATH"] = _path(root / "usr" for root in folders)
    return variables


def _path(folders: Iterable[Path]) -> str:
    return os.pathsep.join(str(folder) for folder in folders)
