"""The host `ros2`."""

from mavfi.extras.ros.lockstep.host import LockstepHost
from mavfi.extras.ros.ros2.transport import Ros2


class Ros2Host(LockstepHost):
    """Missions flown by nodes of ROS 2."""

    name = "ros2"

    @classmethod
    def middleware(cls) -> Ros2:
        """See `LockstepHost`."""
        return Ros2.installed()
