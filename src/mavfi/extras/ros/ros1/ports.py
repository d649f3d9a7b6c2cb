"""Publishers and subscribers of the loop's topics, and the services of a node."""

import os
import sys
import threading
import time
import traceback
from collections.abc import Callable
from contextlib import suppress
from typing import Any, NoReturn, TypeVar
from xmlrpc.client import ServerProxy

from mavfi.errors import MavfiError
from mavfi.extras.ros.ros1.messages import from_msg, from_stamp, state_types, to_msg
from mavfi.extras.ros.ros1.plan import FlightPlan
from mavfi.states import STATES, State

_BUFFER = 1 << 22
_POLL_S = 0.005
_REPEAT_S = 1.0
_Argument = TypeVar("_Argument")
_Answer = TypeVar("_Answer")
OnArrival = Callable[[State, int, int], None]
"""Receives a value, its sequence number, and its instant (us)."""


def die() -> NoReturn:
    """Terminate this process and log the current exception; the supervisor restarts it immediately.

    rospy itself would log exceptions of callbacks and services, and continue without the value.
    """
    traceback.print_exc()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(1)


def fatal(callback: Callable[[_Argument], _Answer]) -> Callable[[_Argument], _Answer]:
    """Wrap a callback so that an exception terminates the process."""

    def guarded(argument: _Argument) -> _Answer:
        try:
            return callback(argument)
        except Exception:  # any exception type
            die()

    return guarded


class Inbox:
    """Passes values from the callbacks of topics to a waiting thread, by sequence number."""

    def __init__(self) -> None:
        self._values: dict[int, State] = {}
        self._changed = threading.Condition()

    def put(self, number: int, state: State) -> None:
        """Add a value."""
        with self._changed:
            self._values[number] = state
            self._changed.notify_all()

    def take(self, number: int, patience_s: float) -> State:
        """Wait for a value and remove it; `TimeoutError` if it does not arrive in time."""
        end = time.monotonic() + patience_s
        with self._changed:
            while number not in self._values:
                if not self._changed.wait(max(0.0, end - time.monotonic())) and number not in self._values:
                    raise TimeoutError(f"publication {number} did not come within {patience_s:g} s")
            return self._values.pop(number)


class StatePublisher:
    """Publishes the values of one state to `listeners` nodes of the flight."""

    def __init__(self, state: str, topic: str, listeners: int) -> None:
        import rospy

        self._kind = state_types()[state]
        self._publisher = rospy.Publisher(topic, self._kind, queue_size=None, tcp_nodelay=True)
        self._listeners = listeners

    def publish(self, state: State, number: int, time_us: int) -> None:
        """Publish one value."""
        self._publisher.publish(to_msg(state, number, time_us, self._kind))

    def connected(self) -> bool:
        """Whether all of the flight's subscribers are connected."""
        return bool(self._publisher.get_num_connections() >= self._listeners)


class Ports:
    """Publications and subscriptions of a node."""

    def __init__(self, node: str, plan: FlightPlan) -> None:
        self.node = node
        self.plan = plan
        self.routes = plan.graph.routes
        self._outlets: list[StatePublisher] = []
        self._subscribers: list[Any] = []

    def outlet(self, state: str, topic: str) -> StatePublisher:
        """Advertise one of the topics on the route of a state."""
        listeners = 1  # the injector
        if topic == self.routes[state].final:
            listeners = self.plan.listeners(state)
        outlet = StatePublisher(state, topic, listeners)
        self._outlets.append(outlet)
        return outlet

    def read(self, state: str, topic: str, arrived: OnArrival) -> None:
        """Subscribe to values of a state."""
        import rospy

        spec = STATES[state]

        def callback(message: Any) -> None:
            arrived(from_msg(message, spec), int(message.number), from_stamp(message.header.stamp))

        self._subscribers.append(
            rospy.Subscriber(
                topic, state_types()[state], fatal(callback), queue_size=None, buff_size=_BUFFER, tcp_nodelay=True
            )
        )

    # ---- connections to the other nodes ------------------------------------------------------------------------------
    def wait_until_connected(self) -> None:
        """Wait until this node is connected to every publisher and subscriber of the flight, or raise `MavfiError`."""
        now = time.monotonic()
        end = now + self.plan.patience_s
        repeat = now + _REPEAT_S
        while not self._connected():
            now = time.monotonic()
            if now > end:
                raise MavfiError(f"node {self.node}: not connected within {self.plan.patience_s:g} s")
            if now > repeat:
                repeat = now + _REPEAT_S
                self._repeat_publishers()
            time.sleep(_POLL_S)

    def _repeat_publishers(self) -> None:
        """Send this node the master's list of publishers of each topic without a connection.

        Its registration can race with that of the publisher: rospy keeps one list per topic, the one it queued last,
        which may be the older one.
        """
        import rosgraph
        import rospy

        topics = {subscriber.resolved_name for subscriber in self._subscribers if subscriber.get_num_connections() == 0}
        master = rosgraph.Master(rospy.get_name())
        with suppress(OSError, rosgraph.MasterException):  # a node has just died: next time
            for topic, nodes in master.getSystemState()[0]:
                if topic in topics:
                    uris = [master.lookupNode(node) for node in nodes]
                    ServerProxy(rospy.get_node_uri()).publisherUpdate(rospy.get_name(), topic, uris)

    def _connected(self) -> bool:
        return all(outlet.connected() for outlet in self._outlets) and all(
            subscriber.get_num_connections() >= 1 for subscriber in self._subscribers
        )

    def serve(self, drive: Callable[[Any], Any] | None = None) -> None:
        """Offer the services of a node, and run until shutdown.

        These are `/<node>/ready`, which returns the process id once all connections are established, and
        `/<node>/drive`, by which the world drives the node (None = it does not).
        """
        import rospy
        from mavfi_msgs.srv import Drive
        from std_srvs.srv import Trigger, TriggerResponse

        def answer(request: Any) -> Any:
            self.wait_until_connected()
            return TriggerResponse(True, str(os.getpid()))

        if drive is not None:
            rospy.Service(f"/{self.node}/drive", Drive, fatal(drive), buff_size=1 << 16)
        rospy.Service(f"/{self.node}/ready", Trigger, answer)
        rospy.spin()


# ---- which nodes are running and connected ---------------------------------------------------------------------------

_ASK_AGAIN_S = 0.01


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
        time.sleep(_ASK_AGAIN_S)


def is_alive(pid: int) -> bool:
    """Whether a process runs (a zombie does not)."""
    try:
        with open(f"/proc/{pid}/stat", encoding="ascii") as file:
            return file.read().rpartition(")")[2].split()[0] not in "ZX"
    except OSError:
        return False
