"""ROS 2 and ROS 1 as flights use them; elsewhere their tests are skipped, saying why."""

import subprocess

import pytest

from mavfi.errors import MavfiError
from mavfi.extras.ros.processes import private_network
from mavfi.extras.ros.ros1.transport import Ros1
from mavfi.extras.ros.ros2.environment import DISTRIBUTIONS
from mavfi.extras.ros.ros2.transport import Ros2


def find(name):
    """ROS 1, or a distribution of ROS 2; raises `MavfiError` where it cannot fly."""
    middleware = Ros1() if name == "ros1" else Ros2.installed(name)
    middleware.require()
    private_network()
    return middleware


def why_not(name):
    """Why a ROS cannot fly here; "" = it can."""
    try:
        find(name)
    except MavfiError as error:
        return str(error)
    return ""


ABSENT = {name: why_not(name) for name in (*DISTRIBUTIONS, "ros1")}
ANY = next((name for name, why in ABSENT.items() if not why), "ros1")
"""The ROS of tests of what is the same with each."""


def flying(*names):
    """Parameters of a test that flies with each of these."""
    return [
        pytest.param(name, marks=[pytest.mark.ros, pytest.mark.skipif(bool(ABSENT[name]), reason=ABSENT[name])])
        for name in names
    ]


any_ros = [pytest.mark.ros, pytest.mark.skipif(bool(ABSENT[ANY]), reason=ABSENT[ANY])]


def number(name):
    """The same as the option `--ros`."""
    return "1" if name == "ros1" else "2"


def joined(folder, *command, **options):
    """A command in the network of a flight."""
    return subprocess.run([f"{folder}/join", *command], capture_output=True, text=True, check=False, **options)
