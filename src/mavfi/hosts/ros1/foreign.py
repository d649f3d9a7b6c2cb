"""Nodes of a flight that nobody here wrote: Debian's nodelet `depth_image_proc/point_cloud_xyz`.

The world does not drive such a node, and it answers no roll call of ours; what is known of it is what the ROS master
and `/proc` say.  It is expected to die: its registers can be injected.
"""

from dataclasses import dataclass
from pathlib import Path

from mavfi.errors import MavfiError
from mavfi.hosts.ros1.folder import flight_folder
from mavfi.hosts.ros1.graph import NODELET
from mavfi.hosts.ros1.remote import Link

IMAGE, INFO, POINTS = (f"/{NODELET}/{name}" for name in ("image_rect", "camera_info", "points"))
HUNG, ENDED = "did not answer", "has ended"


@dataclass(slots=True)
class ForeignLink(Link):
    """What the world knows of a foreign node; attributes as of `Link`."""

    def connect(self, pid: int, since: int) -> None:
        """The node is there (again)."""
        self.pid, self.since, self.lost = pid, since, False


def cause(pid: int) -> str:
    """Why a process is no more: whoever works with it has ended it because it hung, or it has ended by itself."""
    return HUNG if _hung(pid).exists() else ENDED


def note_hung(pid: int) -> None:
    """Note that a process will be ended because it does not answer."""
    _hung(pid).touch()


def _hung(pid: int) -> Path:
    return flight_folder() / f"hung-{pid}"


def ask_foreign(node: str) -> int | None:
    """Process id of a foreign node; None = it does not answer."""
    from mavfi.hosts.node.master import Master

    try:
        return Master().node_pid(f"/{node}")
    except (MavfiError, OSError):
        return None
