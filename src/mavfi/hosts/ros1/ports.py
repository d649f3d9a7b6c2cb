"""Publishers and subscribers of the loop's topics, and the service by which a node reports that it is connected."""

import os
import sys
import threading
import time
import traceback
from collections.abc import Callable, Hashable
from contextlib import suppress
from io import BytesIO
from typing import Any, NoReturn, TypeVar

from mavfi.errors import MavfiError
from mavfi.faults.state import ActedOn
from mavfi.hosts.loop.restarts import CHANGES
from mavfi.hosts.ros1.convert import from_msg, from_stamp, to_msg
from mavfi.hosts.ros1.generate import message_type, state_types
from mavfi.hosts.ros1.graph import JUDGED_BY_WORLD, Way
from mavfi.hosts.ros1.mirrors import Mirror, mirrors_of
from mavfi.hosts.ros1.plan import Plan
from mavfi.states import STATES, State

_BUFFER = 1 << 22
_POLL_S = 0.005
_KEPT = 2
_Given = TypeVar("_Given")
_Answer = TypeVar("_Answer")
Arrived = Callable[[State, int, int], None]
"""Takes a value, its number, and its instant (microseconds)."""


def die() -> NoReturn:
    """End this process, with the exception that is being handled in the log: roslaunch restarts it at once.

    rospy by itself catches exceptions of callbacks and services, writes a line, and continues without the value.
    """
    traceback.print_exc()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(1)


def fatal(callback: Callable[[_Given], _Answer]) -> Callable[[_Given], _Answer]:
    """The same callback, but an exception ends the process."""

    def guarded(given: _Given) -> _Answer:
        try:
            return callback(given)
        except Exception:  # whatever it is
            die()

    return guarded


class Inbox:
    """Hands values from callbacks to the thread that waits for them, by key."""

    def __init__(self) -> None:
        self._things: dict[Hashable, Any] = {}
        self._changed = threading.Condition()

    def put(self, key: Hashable, thing: Any) -> None:
        """Add a value."""
        with self._changed:
            self._things[key] = thing
            self._changed.notify_all()

    def take(self, key: Hashable, patience_s: float) -> Any:
        """Wait for a value, and take it out; `TimeoutError` if it does not come in time."""
        end = time.monotonic() + patience_s
        with self._changed:
            while key not in self._things:
                if not self._changed.wait(max(0.0, end - time.monotonic())) and key not in self._things:
                    raise TimeoutError(f"{key} did not come within {patience_s:g} s")
            return self._things.pop(key)


class Kept:
    """The last values that a node has published or consumed, for nodes that begin again without memory.

    Of each state the two of the highest numbers, since one may not have come to its instant yet, and the last one that
    consumers act upon; all changes of a map.
    """

    def __init__(self) -> None:
        self._values: dict[str, dict[int, State]] = {}
        self._acted_on = {name: ActedOn(spec) for name, spec in STATES.items() if spec.acted_on}
        self._alarms: dict[tuple[str, int], State] = {}

    def put(self, state: State, number: int) -> None:
        """Keep a value; values of one state come in order."""
        name = state.spec.name
        self.put_late(state, number)
        if name in self._acted_on and self._acted_on[name](state):
            self._alarms = {key: kept for key, kept in self._alarms.items() if key[0] != name} | {(name, number): state}

    def put_late(self, state: State, number: int) -> None:
        """Keep a value that comes out of order."""
        values = self._values.setdefault(state.spec.name, {})
        values[number] = state
        if state.spec.name != CHANGES and len(values) > _KEPT:
            del values[min(values)]

    def find(self, name: str, number: int) -> State | None:
        """A value, None = it is not kept."""
        return self._values.get(name, {}).get(number) or self._alarms.get((name, number))


class Outlet:
    """Publishes the values of one state to `listeners` nodes of the flight, and mirrors in standard types."""

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
        """Whether all of the flight's listeners are there."""
        return bool(self._publisher.get_num_connections() >= self._listeners)


class Ports:
    """Publications and subscriptions of a node."""

    def __init__(self, node: str, plan: Plan) -> None:
        self.node = node
        self.plan = plan
        self.ways = plan.graph.ways
        self.kept = Kept()
        self._outlets: list[Outlet] = []
        self._subscribers: list[Any] = []
        self._others: list[tuple[Any, int]] = []
        self._conditions: list[Callable[[], bool]] = []
        self._peers: dict[str, Any] = {}

    def outlet(self, way: Way, topic: str) -> Outlet:
        """Publish values of a state on one of the topics of its way."""
        mirrors = mirrors_of(way.state, self.plan) if topic == way.final else []
        kept = self.kept if topic == way.final and not self.plan.free_running else None
        outlet = Outlet(way.state, topic, listeners(way, topic, self.plan), mirrors, kept)
        self._outlets.append(outlet)
        return outlet

    def read(self, state: str, topic: str, arrived: Arrived) -> None:
        """Listen to values of a state."""
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
        """Publish messages that are no states; `awaited` of the flight's nodes listen."""
        import rospy

        publisher = rospy.Publisher(topic, message_type(kind), queue_size=None, tcp_nodelay=True)
        self._others.append((publisher, awaited))
        return publisher

    def listen(self, topic: str, kind: str, callback: Callable[[Any], None]) -> None:
        """Listen to messages that are no states."""
        import rospy

        self._subscribers.append(
            rospy.Subscriber(topic, message_type(kind), fatal(callback), queue_size=None, tcp_nodelay=True)
        )

    def also(self, condition: Callable[[], bool]) -> None:
        """Add a condition for this node to be connected."""
        self._conditions.append(condition)

    def wait_until_connected(self) -> None:
        """Wait for every publisher and listener of the flight to be connected with this node, or raise `MavfiError`."""
        end = time.monotonic() + self.plan.patience_s
        while not self._connected():
            if time.monotonic() > end:
                raise MavfiError(f"node {self.node}: not connected within {self.plan.patience_s:g} s")
            time.sleep(_POLL_S)

    def _connected(self) -> bool:
        return (
            all(outlet.connected() for outlet in self._outlets)
            and all(subscriber.get_num_connections() >= 1 for subscriber in self._subscribers)
            and all(publisher.get_num_connections() >= awaited for publisher, awaited in self._others)
            and all(condition() for condition in self._conditions)
        )

    def offer_ready(self) -> None:
        """Offer the service `/<node>/ready`: it answers with the process id when all connections stand."""
        import rospy
        from std_srvs.srv import Trigger, TriggerResponse

        def answer(request: Any) -> Any:
            self.wait_until_connected()
            return TriggerResponse(True, str(os.getpid()))

        self.offer_recall()
        rospy.Service(f"/{self.node}/ready", Trigger, answer)

    # ---- values of the past -----------------------------------------------------------------------------------------
    def offer_recall(self) -> None:
        """Offer the service `/<node>/recall`: it answers with a value that is kept here."""
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
        """Ask living peers for a value of a state that was published before this node began; None = nobody has it."""
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
        """The connection to the service of a peer."""
        import rospy
        from mavfi_msgs.srv import Recall

        if peer not in self._peers:
            self._peers[peer] = rospy.ServiceProxy(f"/{peer}/recall", Recall, persistent=True)
        return self._peers[peer]


def peers(way: Way, node: str) -> tuple[str, ...]:
    """Nodes that keep what came out on the topic of a way: those that read it, and the last in the way."""
    last = (way.writer, *way.taps)[-1]
    return tuple(peer for peer in dict.fromkeys((*way.readers, last)) if peer != node)


def listeners(way: Way, topic: str, plan: Plan) -> int:
    """Number of the flight's nodes that listen to one of the topics of a way."""
    if topic == way.rejected:
        return 0 if plan.free_running else 1  # the world
    if topic != way.final:
        return 1  # the next tap
    return len(way.readers) + world_listens(plan, way.state) + plan.observed


def world_listens(plan: Plan, state: str) -> bool:
    """Whether the world listens to the values of a state.

    In lock-step it knows by itself when a map was updated, but waits for every value that a gate may hold back, and for
    all if their profile is wanted.
    """
    if plan.free_running:
        return state in JUDGED_BY_WORLD or state == "perception.map_update"
    return state in JUDGED_BY_WORLD or plan.gated or plan.profile
