"""ROS 2 as flights use it; elsewhere its tests are skipped, saying why."""

from pathlib import Path

import pytest

from mavfi.errors import MavfiError
from mavfi.extras.ros.lockstep.transport import Middleware
from mavfi.extras.ros.processes import private_network
from mavfi.extras.ros.ros2.environment import DISTRIBUTIONS, Installation

NOWHERE = Middleware(Installation("jazzy", "python3", Path("/nowhere"), {}), 1)
"""For plans that are never flown."""


def find(name):
    """A distribution of ROS 2; raises `MavfiError` where it cannot fly."""
    middleware = Middleware.installed(name)
    middleware.require()
    private_network()
    return middleware


def why_not(name):
    """Why a distribution cannot fly here; "" = it can."""
    try:
        find(name)
    except MavfiError as error:
        return str(error)
    return ""


ABSENT = {name: why_not(name) for name in DISTRIBUTIONS}
ANY = next((name for name, why in ABSENT.items() if not why), DISTRIBUTIONS[0])
"""The distribution of tests of what is the same with each."""


def flying(*names):
    """Parameters of a test that flies with each of these."""
    return [
        pytest.param(name, marks=[pytest.mark.ros, pytest.mark.skipif(bool(ABSENT[name]), reason=ABSENT[name])])
        for name in names
    ]


any_ros = [pytest.mark.ros, pytest.mark.skipif(bool(ABSENT[ANY]), reason=ABSENT[ANY])]
