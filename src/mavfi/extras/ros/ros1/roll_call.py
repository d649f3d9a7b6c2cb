"""Queries which nodes of a flight are running and connected."""

import time
from typing import Any

from mavfi.errors import MavfiError

_POLL_S = 0.01


def ready_pid(node: str) -> int | None:
    """Process id of a node that is connected to all others; None = no response."""
    import rospy
    from std_srvs.srv import Trigger

    proxy: Any = rospy.ServiceProxy(f"/{node}/ready", Trigger)
    try:
        return int(proxy().message)
    except (rospy.ServiceException, rospy.ROSException, OSError):
        return None


def wait_for(node: str, patience_s: float, not_pid: int = 0) -> int:
    """Wait for a response of a node whose process is not `not_pid`, or raise `MavfiError`; returns its process id."""
    end = time.monotonic() + patience_s
    while True:
        pid = ready_pid(node)
        if pid is not None and pid != not_pid:
            return pid
        if time.monotonic() > end:
            raise MavfiError(f"node {node}: is not there after {patience_s:g} s")
        time.sleep(_POLL_S)


def is_alive(pid: int) -> bool:
    """Whether a process runs (a zombie does not)."""
    try:
        with open(f"/proc/{pid}/stat", encoding="ascii") as file:
            return file.read().rpartition(")")[2].split()[0] not in "ZX"
    except OSError:
        return False
