"""The host `ros1`."""

from mavfi.extras.ros.lockstep.host import LockstepHost
from mavfi.extras.ros.ros1.transport import Ros1


class Ros1Host(LockstepHost):
    """Missions flown by nodes of ROS 1."""

    name = "ros1"

    @classmethod
    def middleware(cls) -> Ros1:
        """See `LockstepHost`."""
        return Ros1()
