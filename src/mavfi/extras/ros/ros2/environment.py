"""ROS 2 installations: which there are, their Python, and the environment in which their programs run."""

import os
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from mavfi.errors import BadInputError

ROOT_VARIABLE = "MAVFI_ROS2_ROOT"
"""Environment variable: folder with the environments that `mavfi ros setup` makes, one per distribution."""
DISTRIBUTIONS = ("jazzy", "kilted")
"""Distributions that `mavfi ros setup` can install, the default first."""
_SYSTEM = Path("/opt/ros")
_BOOTSTRAPPED = "_ROS_WHEELS_BOOTSTRAP_COMPLETE"
"""Set, it keeps the wheels from starting every interpreter of their environment a second time."""


class Installation(NamedTuple):
    """A ROS 2 installation.

    Attributes:
        distribution: Its name, e.g. "jazzy".
        python: The interpreter that imports its rclpy.
        prefix: Folder that holds `lib` and `include`.
        variables: Environment variables of its programs, in addition to those of this process.
    """

    distribution: str
    python: str
    prefix: Path
    variables: dict[str, str]

    def environment(self, **more: str) -> dict[str, str]:
        """All environment variables of a program, with additional ones."""
        return {**os.environ, **self.variables, **more}


def own_root() -> Path:
    """Folder of the environments that `mavfi ros setup` makes."""
    named = os.environ.get(ROOT_VARIABLE)
    if named:
        return Path(named)
    cache = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(cache) / "mavfi" / "ros2"


def installations() -> Iterator[Installation]:
    """All installations: that of this shell, those of the system, those of `mavfi ros setup`."""
    sourced = os.environ.get("AMENT_PREFIX_PATH")
    distribution = os.environ.get("ROS_DISTRO", "")
    if sourced and distribution:
        yield Installation(distribution, _python_of_shell(), _SYSTEM / distribution, {})
    for setup in sorted(_SYSTEM.glob("*/local_setup.sh")):
        if setup.parent.name != distribution:
            yield _of_system(setup.parent)
    for name in DISTRIBUTIONS:
        if (own_root() / name / "bin/python").exists():
            yield _of_wheels(own_root() / name)


def find_installation(distribution: str = "") -> Installation:
    """The first installation, or the first of a distribution.

    Raises:
        BadInputError: There is none; the message names the cure.
    """
    names = []
    for installation in installations():
        if distribution in ("", installation.distribution):
            return installation
        names.append(installation.distribution)
    if names:
        raise BadInputError(f"ROS 2 {distribution}: not installed; allowed: {', '.join(names)}")
    raise BadInputError("ROS 2 is not installed: run `mavfi ros setup`, or source the setup file of an installation")


def _python_of_shell() -> str:
    """The Python of this shell; not that of mavfi's virtual environment, if that is active."""
    folders = os.environ.get("PATH", os.defpath).split(os.pathsep)
    if sys.prefix != sys.base_prefix:
        folders = [folder for folder in folders if Path(folder) != Path(sys.prefix) / "bin"]
    return shutil.which("python3", path=os.pathsep.join(folders)) or "python3"


def _of_system(prefix: Path) -> Installation:
    """An installation of the system, as its setup file would set it up."""
    folder = f"python{sys.version_info.major}.{sys.version_info.minor}"
    packages = [path for path in prefix.glob("lib/python3*/site-packages")] or [
        prefix / "lib" / folder / "site-packages"
    ]
    variables = {
        "AMENT_PREFIX_PATH": str(prefix),
        "ROS_DISTRO": prefix.name,
        "ROS_VERSION": "2",
        "LD_LIBRARY_PATH": _joined(str(prefix / "lib"), os.environ.get("LD_LIBRARY_PATH", "")),
        "PYTHONPATH": _joined(*map(str, packages), os.environ.get("PYTHONPATH", "")),
        "PATH": _joined(str(prefix / "bin"), os.environ.get("PATH", os.defpath)),
    }
    return Installation(prefix.name, "/usr/bin/python3", prefix, variables)


def _of_wheels(prefix: Path) -> Installation:
    """An environment of `mavfi ros setup`, as its own start-up file would set it up."""
    libraries = [prefix / "lib", *sorted(prefix.glob("lib/python3*/site-packages/ros_*.libs"))]
    variables = {
        "AMENT_PREFIX_PATH": str(prefix),
        "ROS_DISTRO": prefix.name,
        "ROS_VERSION": "2",
        "LD_LIBRARY_PATH": _joined(*map(str, libraries), os.environ.get("LD_LIBRARY_PATH", "")),
        "PATH": _joined(str(prefix / "bin"), os.environ.get("PATH", os.defpath)),
        _BOOTSTRAPPED: "1",
    }
    return Installation(prefix.name, str(prefix / "bin/python"), prefix, variables)


def _joined(*parts: str) -> str:
    return os.pathsep.join(part for part in parts if part)
