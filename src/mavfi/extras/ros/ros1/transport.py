"""ROS 1 under a lock-step flight: rospy, and a master for each flight."""

import os
import socket
import subprocess
import sys
import threading
import time
import traceback
import warnings
from collections.abc import Callable, Collection
from contextlib import suppress
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any, NoReturn
from xmlrpc.client import ServerProxy

from mavfi.errors import MavfiError
from mavfi.extras.ros.lockstep.transport import Middleware, OnBytes, Send, StandardView, Transport
from mavfi.extras.ros.processes import end_with_parent
from mavfi.extras.ros.ros1 import finder

_BUFFER = 1 << 22
_VIEW_DEPTH = 10
"""Number of messages that a slow subscriber of a view may be behind; the flight does not wait for it."""
_POLL_S = 0.005
_MASTER_PATIENCE_S = 60.0


def free_port() -> int:
    """An unused port of the loopback interface."""
    with socket.socket() as any_socket:
        any_socket.bind(("127.0.0.1", 0))
        return int(any_socket.getsockname()[1])


@dataclass(frozen=True)
class Ros1(Middleware):
    """ROS 1 of Debian's packages; `port`: of the flight's master."""

    name = "ros1"
    join_example = "rostopic list"
    port: int = field(default_factory=free_port)

    @property
    def title(self) -> str:
        """See `Middleware`."""
        return "ROS 1"

    def require(self) -> None:
        """See `Middleware`."""
        finder.require()

    def variables(self, folder: Path) -> dict[str, str]:
        """See `Middleware`."""
        variables = finder.environment()
        programs = str(finder.find_file("usr/bin/rosmaster").parent)
        return {
            **variables,
            "PATH": os.pathsep.join([programs, os.environ.get("PATH", os.defpath)]),
            "ROS_MASTER_URI": f"http://127.0.0.1:{self.port}",
            "ROS_IP": "127.0.0.1",
            "ROS_HOME": str(folder),
            "ROS_LOG_DIR": str(folder / "log"),
        }

    def start(self, folder: Path) -> "subprocess.Popen[bytes]":
        """See `Middleware`: the master, which ends with this process."""
        program = str(finder.find_file("usr/bin/rosmaster"))
        with (folder / "log" / "master.out").open("wb") as output:
            return subprocess.Popen(
                [program, "--core", "-p", str(self.port)],
                env={**os.environ, **self.variables(folder)},
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=output,
                cwd=folder,
                preexec_fn=end_with_parent,
            )

    def load(self) -> None:
        """See `Middleware`."""
        finder.enable()
        import rospy  # noqa: F401
        import std_msgs.msg  # noqa: F401

    def connect(self, node: str) -> "Ros1Transport":
        """See `Middleware`."""
        end = time.monotonic() + _MASTER_PATIENCE_S
        while not self._has_master():
            if time.monotonic() > end:
                raise MavfiError(f"rosmaster: is not there after {_MASTER_PATIENCE_S:g} s")
            time.sleep(_POLL_S)
        return Ros1Transport(node)

    def _has_master(self) -> bool:
        with socket.socket() as trial:
            return trial.connect_ex(("127.0.0.1", self.port)) == 0


class Ros1Transport(Transport):
    """A rospy node; its threads receive, one at a time."""

    def __init__(self, node: str) -> None:
        import rospy
        from std_msgs.msg import UInt8MultiArray

        # values are published without a queue: the order of transmission is that of the calls
        warnings.filterwarnings("ignore", "The publisher should be created", SyntaxWarning)
        rospy.init_node(node, argv=[], disable_signals=True, disable_rostime=True, disable_rosout=True)
        self._rospy: Any = rospy
        self._type: Any = UInt8MultiArray
        self._changed = threading.Condition(threading.RLock())
        self._subscribers: list[Any] = []

    def publisher(self, topic: str, greeting: bytes) -> Send:
        """See `Transport`."""
        kind = self._type

        class Greeter(self._rospy.SubscribeListener):  # type: ignore[name-defined]
            def peer_subscribe(self, name: str, publish: Any, publish_to_peer: Any) -> None:
                publish_to_peer(kind(data=greeting))

        publisher = self._rospy.Publisher(topic, kind, Greeter(), queue_size=None, tcp_nodelay=True)
        return lambda content: publisher.publish(kind(data=content))

    def subscribe(self, topic: str, arrived: OnBytes) -> None:
        """See `Transport`."""

        def receive(message: Any) -> None:
            try:
                with self._changed:
                    arrived(message.data)
                    self._changed.notify_all()
            except Exception:  # any exception type: rospy would log it, and continue without the value
                die()

        self._subscribers.append(
            self._rospy.Subscriber(topic, self._type, receive, queue_size=None, buff_size=_BUFFER, tcp_nodelay=True)
        )

    def wait(self, until: Callable[[], bool], timeout_s: float) -> bool:
        """See `Transport`."""
        with self._changed:
            return self._changed.wait_for(until, timeout_s)

    def reconnect(self, topics: Collection[str]) -> None:
        """Send this node the master's list of publishers of these topics.

        Its registration can race with that of the publisher: rospy keeps one list per topic, the one it queued last,
        which may be the older one.
        """
        import rosgraph

        master = rosgraph.Master(self._rospy.get_name())
        with suppress(OSError, rosgraph.MasterException):  # a node has just died: next time
            for topic, nodes in master.getSystemState()[0]:
                if topic in topics:
                    uris = [master.lookupNode(node) for node in nodes]
                    ServerProxy(self._rospy.get_node_uri()).publisherUpdate(self._rospy.get_name(), topic, uris)

    def view(self, topic: str, kind: str) -> "Ros1View | None":
        """See `Transport`."""
        package, name = kind.split("/")
        try:
            types = import_module(f"{package}.msg")
        except ModuleNotFoundError:
            return None
        return Ros1View(self._rospy, topic, getattr(types, name))


class Ros1View(StandardView):
    """A topic of a standard type, with messages that are serialized already."""

    def __init__(self, rospy: Any, topic: str, kind: Any) -> None:
        members = {name: getattr(kind, name) for name in ("_type", "_md5sum", "_full_text")}
        self._type = type(kind.__name__, (rospy.AnyMsg,), members)
        self._publisher = rospy.Publisher(topic, self._type, queue_size=_VIEW_DEPTH)

    def has_readers(self) -> bool:
        """See `StandardView`."""
        return bool(self._publisher.get_num_connections() > 0)

    def publish(self, content: bytes) -> None:
        """See `StandardView`."""
        message = self._type()
        message._buff = content
        self._publisher.publish(message)


def die() -> NoReturn:
    """End this process and log the current exception; the supervisor restarts it immediately."""
    traceback.print_exc()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(1)
