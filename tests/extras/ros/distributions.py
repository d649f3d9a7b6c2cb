"""The distributions of ROS 2 with which tests run: by day the default one, at night all."""

import pytest

from mavfi.extras.ros.ros2.environment import DISTRIBUTIONS

BY_DAY, *AT_NIGHT = DISTRIBUTIONS
EACH = [BY_DAY, *(pytest.param(name, marks=pytest.mark.long) for name in AT_NIGHT)]
