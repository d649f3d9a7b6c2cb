"""Publishers and subscribers of the loop's topics, and the service with which a node reports that it is connected."""

import os
import sys
import threading
import time
import traceback
from collections.abc import Callable, Hashable
from contextlib import suppress
from io import BytesIO
from typing import Any, NoReturn, TypeVar
from xmlrpc.client import ServerProxy

from mavfi.errors import MavfiError
from mavfi.faults.state import ActedOn
from mavfi.hosts.loop.restarts import CHANGES
from mavfi.hosts.ros1.convert import from_msg, from_stamp, to_msg
from mavfi.hosts.ros1.generate import message_type, state_types
from mavfi.hosts.ros1.graph import BYPASS, JUDGED_BY_WORLD, Way
from mavfi.hosts.ros1.mirrors import Mirror, mirrors_of
from mavfi.hosts.ros1.plan import Plan
from mavfi.states import STATES, State

_BUFFER = 1 << 22
_POLL_S = 0.005
_REPEAT_S = 1.0
_KEPT = 2
_Given = TypeVar("_Given")
_Answer = TypeVar("_Answer")
Arrived = Callable[[State, int, int], None]
"""Receives a value, its sequence number, and its instant (us)."""


def die() -> NoReturn:
    """Terminate this process and log the current exception; roslaunch restarts it immediately.

    rospy itself would log exceptions of callbacks and services, and continue without the value.
    """
    traceback.print_exc()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(1)


def fatal(callback: Callable[[_Given], _Answer]) -> Callable[[_Given], _Answer]:
    """Wrap a callback so that an exception terminates the process."""

    def guarded(given: _Given) -> _Answer:
        try:
            return callback(given)
        except Exception:  # any exception type
            die()

    return guarded


class Inbox:
    """Passes values from callbacks to a waiting thread, by key."""

    def __init__(self) -> None:
        self._things: dict[Hashable, Any] = {}
        self._changed = threading.Condition()

    def put(self, key: Hashable, thing: Any) -> None:
        """Add a value."""
        with self._changed:
            self._things[key] = thing
            self._changed.notify_all()

    def take(self, key: Hashable, patience_s: float) -> Any:
        """Wait for a value and remove it; `TimeoutError` if it does not arrive in time."""
        end = time.monotonic() + patience_s
        with self._changed:
            while key not in self._things:
                if not self._changed.wait(max(0.0, end - time.monotonic())) and key not in self._things:
                    raise TimeoutError(f"{key} did not come within {patience_s:g} s")
            return self._things.pop(key)


class Kept:
    """The latest values that a node has published or consumed, for restarted nodes.

    For each state the two values of highest sequence number, as the latest may precede its publication instant, and
    the last one that consumers act upon; all changes of a map.
    """

    def __init__(self) -> None:
        self._values: dict[str, dict[int, State]] = {}
        self._acted_on = {name: ActedOn(spec) for name, spec in STATES.items() if spec.acted_on}
        self._alarms: dict[tuple[str, int], State] = {}

    def put(self, state: State, number: int) -> None:
        """Store a value; values of one state arrive in order."""
        name = state.spec.name
        self.put_late(state, number)
        if name in self._acted_on and self._acted_on[name](state):
            self._alarms = {key: kept for key, kept in self._alarms.items() if key[0] != name} | {(name, number): state}

    def put_late(self, state: State, number: int) -> None:
        """Store a value that arrives out of order."""
        values = self._values.setdefault(state.spec.name, {})
        values[number] = state
        if state.spec.name != CHANGES and len(values) > _KEPT:
            del values[min(values)]

    def find(self, name: str, number: int) -> State | None:
        """A stored value; None = not stored."""
        return self._values.get(name, {}).get(number) or self._alarms.get((name, number))


class Outlet:
    """Publishes the values of one state to `listeners` nodes of the flight, and to mirrors in standard types."""

    def __init__(self, state: str, topic: str, listeners: int, mirrors: list[Mirror], kept: Kept | None) -> None:
        import rospy

        self._kind = state_types()[state]
        self._publisher = rospy.Publisher(topic, self._kind, queue_size=None, tcp_nodelay=True)
        self._listeners = listeners
        self._mirrors = mirrors
        self._kept = kept

    def publish(self, state: State, number: int, time_us: int) -> None:
        """Publish one value."""
        if self._kept is not None:
            self._kept.put(state, number)
        self._publisher.publish(to_msg(state, number, time_us, self._kind))
        for mirror in self._mirrors:
            mirror.publish(state, time_us)

    def connected(self) -> bool:
        """Whether all of the flight's subscribers are connected."""
        return bool(self._publisher.get_num_connections() >= self._listeners)


class GatedOutlet:
    """Publishes the values of one state to a gate or, while that is down, to the gate's consumers."""

    def __init__(self, gate: Outlet, around: Outlet) -> None:
        self.bypassing = False
        self._gate, self._around = gate, around

    def publish(self, state: State, number: int, time_us: int) -> None:
        """Publish one value."""
        (self._around if self.bypassing else self._gate).publish(state, number, time_us)


class Ports:
    """Publications and subscriptions of a node."""

    def __init__(self, node: str, plan: Plan) -> None:
        self.node = node
        self.plan = plan
        self.ways = plan.graph.ways
        self.kept = Kept()
        self._outlets: list[Outlet] = []
        self._gated: list[GatedOutlet] = []
        self._subscribers: list[Any] = []
        self._others: list[tuple[Any, int]] = []
        self._conditions: list[Callable[[], bool]] = []
        self._peers: dict[str, Any] = {}

    def outlet(self, way: Way, topic: str) -> Outlet | GatedOutlet:
        """Advertise one of the topics on the route of a state; in front of a gate the one after it as well.

        Free-running, such a node publishes around the gate whenever the world reports that it is down.
        """
        if not way.gated or topic != way.before_gate:
            return self._outlet(way, topic)
        if self.plan.free_running and not self._gated:
            self.listen(BYPASS, "Bypass", lambda message: self.bypass(message.on))
        found = GatedOutlet(self._outlet(way, topic), self._outlet(way, way.final))
        self._gated.append(found)
        return found

    def bypass(self, on: bool) -> None:
        """Publish around the gate from now on, or no longer."""
        for outlet in self._gated:
            outlet.bypassing = on

    def _outlet(self, way: Way, topic: str) -> Outlet:
        mirrors = mirrors_of(way.state, self.plan) if topic == way.final else []
        kept = self.kept if topic == way.final and not self.plan.free_running else None
        outlet = Outlet(way.state, topic, listeners(way, topic, self.plan), mirrors, kept)
        self._outlets.append(outlet)
        return outlet

    def read(self, state: str, topic: str, arrived: Arrived) -> None:
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

    def publisher(self, topic: str, kind: str, awaited: int = 0) -> Any:
        """Advertise a topic of non-state messages, with `awaited` subscribers among the flight's nodes."""
        import rospy

        publisher = rospy.Publisher(topic, message_type(kind), queue_size=None, tcp_nodelay=True)
        self._others.append((publisher, awaited))
        return publisher

    def listen(self, topic: str, kind: str, callback: Callable[[Any], None]) -> None:
        """Subscribe to non-state messages."""
        import rospy

        self._subscribers.append(
            rospy.Subscriber(topic, message_type(kind), fatal(callback), queue_size=None, tcp_nodelay=True)
        )

    def also(self, condition: Callable[[], bool]) -> None:
        """Add a condition under which this node counts as connected."""
        self._conditions.append(condition)

    def wait_until_connected(self) -> None:
        """Wait until this node is connected to every publisher and subscriber of the flight, or raise `MavfiError`."""
        now = time.monotonic()
        end, repeat = now + self.plan.patience_s, now + _REPEAT_S
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

        topics = {each.resolved_name for each in self._subscribers if each.get_num_connections() == 0}
        master = rosgraph.Master(rospy.get_name())
        with suppress(OSError, rosgraph.MasterException):  # a node has just died: next time
            for topic, nodes in master.getSystemState()[0]:
                if topic in topics:
                    uris = [master.lookupNode(node) for node in nodes]
                    ServerProxy(rospy.get_node_uri()).publisherUpdate(rospy.get_name(), topic, uris)

    def _connected(self) -> bool:
        return (
            all(outlet.connected() for outlet in self._outlets)
            and all(subscriber.get_num_connections() >= 1 for subscriber in self._subscribers)
            and all(publisher.get_num_connections() >= awaited for publisher, awaited in self._others)
            and all(condition() for condition in self._conditions)
        )

    def offer_ready(self) -> None:
        """Offer the service `/<node>/ready`, which returns the process id once all connections are established."""
        import rospy
        from std_srvs.srv import Trigger, TriggerResponse

        def answer(request: Any) -> Any:
            self.wait_until_connected()
            return TriggerResponse(True, str(os.getpid()))

        self.offer_recall()
        rospy.Service(f"/{self.node}/ready", Trigger, answer)

    # ---- recall of earlier values ------------------------------------------------------------------------------------
    def offer_recall(self) -> None:
        """Offer the service `/<node>/recall`, which returns a stored value."""
        import rospy
        from mavfi_msgs.srv import Recall, RecallResponse

        def answer(request: Any) -> Any:
            state = self.kept.find(request.state, request.number)
            if state is None:
                return RecallResponse(False, b"")
            content = BytesIO()
            to_msg(state, request.number, 0, state_types()[request.state]).serialize(content)
            return RecallResponse(True, content.getvalue())

        rospy.Service(f"/{self.node}/recall", Recall, answer)

    def recall(self, name: str, number: int) -> State | None:
        """Request from live peers a value that was published before this node started; None = no peer stores it."""
        import rospy

        for peer in peers(self.ways[name], self.node):
            with suppress(rospy.ServiceException, rospy.ROSException, OSError):
                answer = self._asking(peer)(name, number)
                if answer.held:
                    message = state_types()[name]()
                    message.deserialize(answer.value)
                    return from_msg(message, STATES[name])
        return None

    def _asking(self, peer: str) -> Any:
        """The persistent connection to a peer's recall service."""
        import rospy
        from mavfi_msgs.srv import Recall

        if peer not in self._peers:
            self._peers[peer] = rospy.ServiceProxy(f"/{peer}/recall", Recall, persistent=True)
        return self._peers[peer]


def peers(way: Way, node: str) -> tuple[str, ...]:
    """Nodes that store a route's final values: its subscribers, and those that publish them."""
    return tuple(peer for peer in dict.fromkeys((*way.readers, *way.senders)) if peer != node)


def listeners(way: Way, topic: str, plan: Plan) -> int:
    """Number of the flight's nodes that subscribe to one of the topics of a route."""
    if topic == way.rejected:
        return 0 if plan.free_running else 1  # the world
    if topic != way.final:
        return 1  # the next tap
    return len(way.readers) + world_listens(plan, way.state) + plan.observed


def world_listens(plan: Plan, state: str) -> bool:
    """Whether the world subscribes to the values of a state.

    In lock-step the world derives map updates itself, but waits for every value that a gate may withhold, and for all
    values if a profile is requested.  Free-running it watches a gate by one sensor's values.
    """
    if plan.free_running:
        return state in JUDGED_BY_WORLD or state == "perception.map_update" or (plan.gated and state == probe(plan))
    return state in JUDGED_BY_WORLD or plan.gated or plan.profile


def probe(plan: Plan) -> str:
    """The most frequent sensor whose values the flight's nodes read."""
    return next(name for name in ("sensor.odometry", "sensor.imu") if name in plan.graph.ways)
