"""The distributions of ROS 2 with which tests run: by day the default one, at night all."""

from mavfi.extras.ros.ros2.environment import DISTRIBUTIONS
from tests.night import at_night

BY_DAY, *AT_NIGHT = DISTRIBUTIONS
EACH = [BY_DAY, *at_night(*AT_NIGHT)]
