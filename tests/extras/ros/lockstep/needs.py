"""ROS 2 as flights use it; elsewhere its tests are skipped, saying why."""

from pathlib import Path

import pytest

from mavfi.errors import MavfiError
from mavfi.extras.ros.lockstep.transport import Middleware
from mavfi.extras.ros.processes import private_network
from mavfi.extras.ros.ros2.environment import DISTRIBUTIONS, Installation
from tests.extras.ros.distributions import AT_NIGHT, BY_DAY

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


def marks(name):
    """Marks of a test that flies with a distribution."""
    return [pytest.mark.ros, pytest.mark.skipif(bool(ABSENT[name]), reason=ABSENT[name])]


any_ros = marks(ANY)
each_distribution = pytest.mark.parametrize(
    "ros",
    [
        pytest.param(BY_DAY, marks=marks(BY_DAY)),
        *(pytest.param(name, marks=[*marks(name), pytest.mark.long]) for name in AT_NIGHT),
    ],
)
