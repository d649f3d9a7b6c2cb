"""Queries which nodes of a flight are running, connected or traced.

Foreign nodes, i.e. Debian's nodelet `depth_image_proc/point_cloud_xyz`, lack mavfi's `ready` service: they are queried
through the ROS master and `/proc`.  They are expected to crash, as faults are injected into their registers.
"""

import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from mavfi.errors import MavfiError
from mavfi.hosts.ros1.folder import flight_folder
from mavfi.hosts.ros1.plan import Plan

HUNG, ENDED = "did not answer", "has ended"
_POLL_S = 0.01


def asks(plan: Plan) -> Mapping[str, Callable[[str], int | None]]:
    """Query function of each node: returns its process id; None = no response."""
    return dict.fromkeys(plan.nodes, ask_ours) | dict.fromkeys(plan.foreign, ask_foreign)


def ask_ours(node: str) -> int | None:
    """Process id of a mavfi node that is connected to all others; None = no response."""
    import rospy
    from std_srvs.srv import Trigger

    proxy: Any = rospy.ServiceProxy(f"/{node}/ready", Trigger)
    try:
        return int(proxy().message)
    except (rospy.ServiceException, rospy.ROSException, OSError):
        return None


def ask_foreign(node: str) -> int | None:
    """Process id of a foreign node; None = no response."""
    from mavfi.hosts.node.master import Master

    try:
        return Master().node_pid(f"/{node}")
    except (MavfiError, OSError):
        return None


def wait_for(node: str, patience_s: float, not_pid: int = 0, ask: Callable[[str], int | None] = ask_ours) -> int:
    """Wait for a response of a node whose process is not `not_pid`, or raise `MavfiError`; returns its process id."""
    end = time.monotonic() + patience_s
    while True:
        answer = ask(node)
        if answer is not None and answer != not_pid:
            return answer
        if time.monotonic() > end:
            raise MavfiError(f"node {node}: is not there after {patience_s:g} s")
        time.sleep(_POLL_S)


def wait_for_all(plan: Plan) -> dict[str, int]:
    """Wait for all nodes of a flight; returns their process ids."""
    return {node: wait_for(node, plan.patience_s, ask=ask) for node, ask in asks(plan).items()}


def is_alive(pid: int) -> bool:
    """Whether a process runs (a zombie does not)."""
    try:
        with open(f"/proc/{pid}/stat", encoding="ascii") as file:
            return file.read().rpartition(")")[2].split()[0] not in "ZX"
    except OSError:
        return False


def is_traced(pid: int) -> bool:
    """Whether a tracer is attached to a process."""
    try:
        with open(f"/proc/{pid}/status", encoding="ascii") as file:
            return any(line.startswith("TracerPid:") and line.split()[1] != "0" for line in file)
    except OSError:
        return False


def cause(pid: int) -> str:
    """Why a process terminated: killed after a hang, see `note_hung`, or by itself."""
    return HUNG if _hung(pid).exists() else ENDED


def note_hung(pid: int) -> None:
    """Record that a process is about to be killed as hung."""
    _hung(pid).touch()


def _hung(pid: int) -> Path:
    return flight_folder() / f"hung-{pid}"
