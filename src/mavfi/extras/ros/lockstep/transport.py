"""ROS 2 under a lock-step flight: rclpy of an installation, and a wait set of each node's own.

The only module of the lock-step that imports ROS, and only inside functions.
"""

import os
import struct
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib import import_module
from importlib.abc import MetaPathFinder
from importlib.machinery import EXTENSION_SUFFIXES, ModuleSpec, PathFinder
from pathlib import Path
from types import ModuleType
from typing import Any

from mavfi.errors import BadInputError
from mavfi.extras.ros.ros2.environment import Installation, find_installation

Send = Callable[[bytes], None]
"""Publishes bytes to a topic."""
OnBytes = Callable[[bytes], None]
"""Receives the bytes of one publication."""
JOIN_EXAMPLE = "ros2 topic list"
"""Command that lists the topics of a flight, for the script `join`."""
_EXTENSION = "rclpy/_rclpy_pybind11"
"""The part of rclpy that is compiled for one version of Python."""
_PACKAGES = ("rclpy", "rpyutils", "ament_index_python", "yaml", "_yaml")
_ENDINGS = ("_msgs", "_srvs", "_interfaces")
_DOMAINS = 100
"""Number of domain ids whose ports are free for use on every system."""
_HEAD = struct.Struct("<4s3I")
"""Serialized start of `std_msgs/UInt8MultiArray`: encoding, no dimensions, offset 0, number of bytes."""
_LEASE_S = 20
"""Time after which a node that was killed is forgotten (s), as usual in ROS 2."""
_ANNOUNCEMENT_NS = 200_000_000
"""Period at which a node announces itself (ns); as usual, every 3 s, a restarted node would wait for that."""
_PROFILE_FILE = "fastdds.xml"
_PROFILE = f"""<?xml version="1.0" encoding="UTF-8"?>
<dds><profiles xmlns="http://www.eprosima.com">
<participant profile_name="mavfi" is_default_profile="true"><rtps><builtin><discovery_config>
<leaseDuration><sec>{_LEASE_S}</sec></leaseDuration>
<leaseAnnouncement><sec>0</sec><nanosec>{_ANNOUNCEMENT_NS}</nanosec></leaseAnnouncement>
</discovery_config></builtin></rtps></participant>
</profiles></dds>
"""
"""Settings of Fast DDS, for all nodes of a flight."""
_VIEW_DEPTH = 10
"""Number of messages that a slow subscriber of a view may be behind, as usual in ROS 2."""
_LITTLE_ENDIAN = b"\0\1\0\0"


def _is_of_ros(name: str) -> bool:
    """Whether a top-level module belongs to ROS 2."""
    return name in _PACKAGES or name.startswith("rosidl_") or name.endswith(_ENDINGS)


class RosFinder(MetaPathFinder):
    """Finds ROS's Python modules in folders whose other packages must stay invisible.

    On `PYTHONPATH`, such a folder would put its NumPy before this project's.  This finder is at the end of
    `sys.meta_path`, after all packages installed in this environment, and finds only modules of ROS.
    """

    def __init__(self, folders: Sequence[Path]) -> None:
        self.folders = [str(folder) for folder in folders]

    def find_spec(
        self, fullname: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """The spec of a top-level module of ROS, otherwise None."""
        if path is not None or not _is_of_ros(fullname):
            return None
        return PathFinder.find_spec(fullname, self.folders)

    def enable(self) -> None:
        """Use this finder in this process, unless one for the same folders is in use."""
        for finder in sys.meta_path:
            if isinstance(finder, RosFinder) and finder.folders == self.folders:
                return
        sys.meta_path.append(self)


@dataclass(frozen=True)
class Middleware:
    """ROS 2 as a flight uses it: plain data, which the flight's plan contains.

    Attributes:
        installation: Where it is installed.
        domain: Domain id of the flight.
    """

    installation: Installation
    domain: int

    @classmethod
    def installed(cls, distribution: str = "") -> "Middleware":
        """The first installation, or that of a distribution; raises `BadInputError` if there is none."""
        return cls(find_installation(distribution), 1 + os.getpid() % _DOMAINS)

    @property
    def title(self) -> str:
        """For people, e.g. "ROS 2 jazzy"."""
        return f"ROS 2 {self.installation.distribution}"

    def require(self) -> None:
        """Check that it can be used by this Python; raises `BadInputError` with the remedy."""
        folders = self._folders()
        if not any((folder / f"{_EXTENSION}{suffix}").exists() for folder in folders for suffix in EXTENSION_SUFFIXES):
            raise BadInputError(
                f"ROS 2 {self.installation.distribution}: its rclpy is not compiled for this Python "
                f"({EXTENSION_SUFFIXES[0]} in {self.installation.prefix}); allowed: `mavfi ros setup`, or its Python"
            )

    def variables(self, folder: Path) -> dict[str, str]:
        """Environment variables of all programs of the flight in a folder."""
        variables = self.installation.variables
        path = variables.get("PATH", os.environ.get("PATH", os.defpath))
        if Path(self.installation.python).is_absolute():
            path = os.pathsep.join([str(Path(self.installation.python).parent), path])
        return {
            **variables,
            "PATH": path,
            "RMW_IMPLEMENTATION": "rmw_fastrtps_cpp",
            "ROS_DOMAIN_ID": str(self.domain),
            # No shared memory: a node that was killed never empties its queues there, and those that send to it wait.
            # With the range LOCALHOST shared memory cannot be switched off; the private network has no other hosts.
            "FASTDDS_BUILTIN_TRANSPORTS": "UDPv4",
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET",
            "FASTRTPS_DEFAULT_PROFILES_FILE": str(folder / _PROFILE_FILE),  # until Jazzy
            "FASTDDS_DEFAULT_PROFILES_FILE": str(folder / _PROFILE_FILE),
            "ROS_LOG_DIR": str(folder / "log"),
        }

    def prepare(self, folder: Path) -> None:
        """Write the settings of its nodes to the folder of a flight."""
        (folder / _PROFILE_FILE).write_text(_PROFILE)

    def load(self) -> None:
        """Import its modules into this process, from which nodes are forked."""
        RosFinder(self._folders()).enable()
        import rclpy  # noqa: F401
        import std_msgs.msg  # noqa: F401

    def connect(self, node: str) -> "Transport":
        """Start a node with this name in this process."""
        return Transport(node)

    def _folders(self) -> list[Path]:
        """Where its Python modules are: in each of the prefixes that its setup files name."""
        prefixes = self.installation.environment().get("AMENT_PREFIX_PATH", str(self.installation.prefix))
        return [
            folder
            for prefix in prefixes.split(os.pathsep)
            for folder in sorted(Path(prefix).glob("lib/python3*/site-packages"))
        ]


class Transport:
    """The connection of one node, in its own process, to the nodes of its flight.

    Publications are reliable, ordered per topic, and never dropped.  They are received one at a time.  It is an rclpy
    node without an executor: `wait` waits on all of its subscriptions, and takes serialized messages, which takes less
    than half the time of an executor.
    """

    def __init__(self, node: str) -> None:
        import rclpy
        from rclpy.impl.implementation_singleton import rclpy_implementation
        from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
        from std_msgs.msg import UInt8MultiArray

        rclpy.init(args=[], signal_handler_options=rclpy.SignalHandlerOptions.NO)
        self._rclpy: Any = rclpy_implementation
        self._node: Any = rclpy.create_node(node, enable_rosout=False, start_parameter_services=False)
        self._type: Any = UInt8MultiArray
        self._lossless = QoSProfile(history=HistoryPolicy.KEEP_ALL, reliability=ReliabilityPolicy.RELIABLE)
        self._subscriptions: list[tuple[Any, OnBytes]] = []
        self._matches: list[tuple[Any, Callable[[], None]]] = []
        self._wait_set: Any = None

    def publisher(self, topic: str, greeting: bytes) -> Send:
        """Advertise a topic.

        A subscriber that connects is sent a greeting; what is published after the greeting reaches it.
        """
        handle = self._node.create_publisher(self._type, topic, self._lossless).handle

        def send(content: bytes) -> None:
            message = _HEAD.pack(_LITTLE_ENDIAN, 0, 0, len(content)) + content
            end = time.monotonic() + 2 * _LEASE_S
            while True:
                try:
                    handle.publish_raw(message)
                    return
                except self._rclpy.RCLError:
                    # Its memory is full of messages to a node that was killed, until that is forgotten.
                    if time.monotonic() > end:
                        raise

        event = self._rclpy.rcl_publisher_event_type_t.RCL_PUBLISHER_MATCHED
        self._matches.append((self._rclpy.EventHandle(handle, event), lambda: send(greeting)))
        self._wait_set = None
        return send

    def subscribe(self, topic: str, arrived: OnBytes) -> None:
        """Subscribe to a topic; an exception of `arrived` is raised by `wait`."""
        subscription = self._node.create_subscription(self._type, topic, arrived, self._lossless, raw=True)
        self._subscriptions.append((subscription.handle, arrived))
        self._wait_set = None

    def wait(self, until: Callable[[], bool], timeout_s: float) -> bool:
        """Receive until a condition holds, up to a time limit (s, wall clock); returns whether it holds then."""
        end = time.monotonic() + timeout_s
        while not until():
            left = end - time.monotonic()
            self._receive(max(0, int(1e9 * left)))
            if left <= 0.0:
                return until()
        return True

    def _receive(self, timeout_ns: int) -> None:
        """Wait for publications, new subscribers, or the end of the time limit; take all that is there."""
        if self._wait_set is None:
            counts = len(self._subscriptions), 0, 0, 0, 0, len(self._matches)
            self._wait_set = self._rclpy.WaitSet(*counts, self._node.context.handle)
        ready = self._wait_set
        ready.clear_entities()
        for subscription, _ in self._subscriptions:
            ready.add_subscription(subscription)
        for event, _ in self._matches:
            ready.add_event(event)
        ready.wait(timeout_ns)
        for index, (event, greet) in enumerate(self._matches):
            if ready.is_ready("event", index) and event.take_event().current_count_change > 0:
                greet()
        for index, (subscription, arrived) in enumerate(self._subscriptions):
            if ready.is_ready("subscription", index):
                while (taken := subscription.take_message(self._type, True)) is not None:
                    content = taken[0]
                    arrived(content[_HEAD.size : _HEAD.size + _HEAD.unpack_from(content)[-1]])

    def view(self, topic: str, kind: str) -> "StandardView | None":
        """Advertise a topic of a standard type, "package/Name"; None = the type is not installed."""
        package, name = kind.split("/")
        try:
            types = import_module(f"{package}.msg")
        except ModuleNotFoundError:
            return None
        return StandardView(self._node.create_publisher(getattr(types, name), topic, _VIEW_DEPTH))


class StandardView:
    """A topic with messages of a standard type, for people and their tools."""

    def __init__(self, publisher: Any) -> None:
        self._publisher = publisher

    def has_readers(self) -> bool:
        """Whether anybody is subscribed."""
        return bool(self._publisher.get_subscription_count() > 0)

    def publish(self, content: bytes) -> None:
        """Publish a serialized message."""
        self._publisher.publish(content)
