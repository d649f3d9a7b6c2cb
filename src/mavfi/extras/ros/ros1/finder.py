"""Import finder for Debian's ROS modules that excludes all other Python packages of Debian.

`PYTHONPATH=/usr/lib/python3/dist-packages` would put Debian's NumPy before this project's.  This import finder is at
the end of `sys.meta_path`, after all packages installed in this environment, and finds only listed names.
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
"""Environment variable: folder of unpacked Debian packages, for systems on which they are not installed."""
DIST_PACKAGES = Path("usr/lib/python3/dist-packages")
WORKSPACE_MARK = Path("usr/.catkin")
"""Marker file by which catkin recognizes an installation prefix."""
GENERATED = ("mavfi_msgs",)
"""Packages generated for each flight."""
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
    "std_srvs",
)
_HELPERS = ("rospkg", "catkin_pkg", "yaml", "defusedxml", "netifaces", "Cryptodome", "gnupg", "distro")
ALLOWED = frozenset((*_ROS, *_HELPERS))
"""Top-level names imported from Debian unless installed in this environment."""
NEEDED_MODULES = ("rospy", "genpy", "genmsg", "std_msgs", "std_srvs", "yaml")
NEEDED_FILES = ("usr/bin/rosmaster", "usr/share/std_msgs/msg/Header.msg")
_SYSTEM = Path("/")
_LIBRARIES = ("usr/lib/x86_64-linux-gnu", "usr/lib", "lib/x86_64-linux-gnu")


class Finder(MetaPathFinder):
    """Finds the listed modules in Debian's folders, and generated message packages in their own folder."""

    def __init__(self, dist_packages: Sequence[Path], generated: Path | None = None) -> None:
        self.dist_packages = [str(folder) for folder in dist_packages]
        self.generated = generated

    def find_spec(
        self, fullname: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """The spec of a listed top-level module, otherwise None."""
        if path is not None:
            return None
        if fullname in GENERATED and self.generated is not None:
            return PathFinder.find_spec(fullname, [str(self.generated)])
        if fullname in ALLOWED:
            return PathFinder.find_spec(fullname, self.dist_packages)
        return None


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


def enable(generated: Path | None = None) -> None:
    """Make ROS importable in this process, and optionally a folder of generated message packages."""
    here = [finder for finder in sys.meta_path if isinstance(finder, Finder)]
    if here:
        here[0].generated = generated or here[0].generated
    else:
        sys.meta_path.append(Finder([root / DIST_PACKAGES for root in roots()], generated))
    os.environ.setdefault("ROS_PACKAGE_PATH", environment()["ROS_PACKAGE_PATH"])


def missing() -> list[str]:
    """Missing parts of ROS, determined without importing."""
    finder = Finder([root / DIST_PACKAGES for root in roots()])
    modules = [name for name in NEEDED_MODULES if PathFinder.find_spec(name) is None and finder.find_spec(name) is None]
    return modules + [name for name in NEEDED_FILES if not find_file(name).is_file()]


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
