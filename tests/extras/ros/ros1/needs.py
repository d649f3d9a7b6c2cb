"""What tests on real ROS need; elsewhere they are skipped, saying why."""

import os

import pytest

from mavfi.extras.ros.ros1 import finder

ABSENT = finder.missing()
ros = [
    pytest.mark.ros,
    pytest.mark.skipif(bool(ABSENT), reason=f"ROS is not installed ({', '.join(ABSENT[:1])} is missing): `make ros`"),
]


def environment():
    """Variables of a shell in which ROS's own tools are found."""
    tools = finder.find_file("usr/bin/rosmaster").parent
    return {**os.environ, **finder.environment(), "PATH": f"{tools}{os.pathsep}{os.environ['PATH']}"}
