"""Waits for nodes of the flight to be there and connected."""

import time
from collections.abc import Callable
from typing import Any

from mavfi.errors import MavfiError

_POLL_S = 0.01


def wait_for(
    node: str, patience_s: float, not_pid: int = 0, ask: Callable[[str], int | None] | None = None
) -> int:  # fmt: skip
    """Wait until a node says that it is connected with all others.

    Args:
        node: Its name.
        patience_s: For how long (s).
        not_pid: Process of the node's former life, whose answer would not count.
        ask: Gives its process id, None while it does not answer; `ask_ours` by default.

    Returns:
        Its process id.

    Raises:
        MavfiError: It does not come.
    """
    end = time.monotonic() + patience_s
    while True:
        answer = (ask or ask_ours)(node)
        if answer is not None and answer != not_pid:
            return answer
        if time.monotonic() > end:
            raise MavfiError(f"node {node}: is not there after {patience_s:g} s")
        time.sleep(_POLL_S)


def ask_ours(node: str) -> int | None:
    """Process id of a node of ours that is connected with all others; None = it does not answer."""
    import rospy
    from std_srvs.srv import Trigger

    proxy: Any = rospy.ServiceProxy(f"/{node}/ready", Trigger)
    try:
        return int(proxy().message)
    except (rospy.ServiceException, rospy.ROSException, OSError):
        return None


def is_alive(pid: int) -> bool:
    """Whether a process runs (a zombie does not)."""
    try:
        with open(f"/proc/{pid}/stat", encoding="ascii") as file:
            return file.read().rpartition(")")[2].split()[0] not in "ZX"
    except OSError:
        return False


def is_traced(pid: int) -> bool:
    """Whether a tracer holds on to a process."""
    try:
        with open(f"/proc/{pid}/status", encoding="ascii") as file:
            return any(line.startswith("TracerPid:") and line.split()[1] != "0" for line in file)
    except OSError:
        return False
