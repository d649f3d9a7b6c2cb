"""Whether there is ROS 2, and whether its nodes can be kept apart, for `mavfi doctor`."""

import shutil
import subprocess

from mavfi.cli.doctor import Check
from mavfi.extras.ros.ros2.environment import installations

_PRIVATE_NETWORK = ("--net", "--mount", "true")


def checks() -> list[Check]:
    """ROS 2, and private networks for nodes."""
    distributions = ", ".join(installation.distribution for installation in installations())
    ros2 = Check("ROS 2", True, distributions)
    if not distributions:
        ros2 = Check("ROS 2", False, "mavfi ros setup")
    return [ros2, _namespaces()]


def _namespaces() -> Check:
    """Whether this process may have a network of its own, which trials of a ROS 2 stack need."""
    program = shutil.which("unshare")
    if program is None:
        return Check("namespaces", False, "install the package util-linux")
    done = subprocess.run([program, *_PRIVATE_NETWORK], capture_output=True, check=False)
    if done.returncode:
        return Check("namespaces", False, "run as root, or with the capability SYS_ADMIN")
    return Check("namespaces", True, "nodes can have a network of their own")
