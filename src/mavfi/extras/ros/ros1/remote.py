"""The world's side of lock-step: proxies of kernels and of the detector in other processes.

The world owns the event queue of the in-process host, and with it the order of all events.  A proxy has the interface
of a kernel: an operation without a result (a non-triggering input, a mark) is sent with the next call that has one.
Values travel over the topics from node to node; an operation refers to them by sequence number, and a node waits for a
value that it has to receive.
"""

import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from mavfi.detectors.detector import Alarm, Detector
from mavfi.extras.ros.ros1.kernels import alarm_of
from mavfi.extras.ros.ros1.messages import NodeAction, message_type, serialized
from mavfi.extras.ros.ros1.plan import FlightPlan, KernelInterface
from mavfi.flight.loop import Latencies
from mavfi.states import STATES, State

HELD = -1
SILENT = "does not answer"
"""Cause of a lost node, as in events: it did not answer in time, and was killed."""
_WATCH_S = 0.1


class NodeLostError(Exception):
    """A node does not respond: it has crashed or hangs."""


@dataclass(slots=True)
class RemotePublication(State):
    """A value in transit through the topics, identified by its sequence number.

    Attributes:
        link: Node that holds it until publication, in its incarnation `life`; None = the world holds it.
        kernel: Its writer.
        sent: Whether it has already been sent to its topic, stamped with its publication instant.
    """

    number: int = 0
    link: "Link | None" = None
    life: int = 0
    kernel: str = ""
    sent: bool = False

    @property
    def is_lost(self) -> bool:
        """Whether it was lost with its node."""
        return self.link is not None and (self.link.is_lost or self.link.life != self.life)


class Watchdog:
    """Shuts down the connection of a call that exceeds a time limit (s), which aborts the call."""

    def __init__(self, patience_s: float) -> None:
        self._patience_s = patience_s
        self._lock = threading.Lock()
        self._call: tuple[float, Any] | None = None
        self._has_barked = False
        threading.Thread(target=self._watch, daemon=True).start()

    def begin(self, proxy: Any) -> None:
        """Start the timer of a call."""
        with self._lock:
            self._call = (time.monotonic() + self._patience_s, proxy)
            self._has_barked = False

    def end(self) -> bool:
        """Stop the timer; returns whether the call was aborted."""
        with self._lock:
            self._call = None
            return self._has_barked

    def _watch(self) -> None:
        while True:
            time.sleep(_WATCH_S)
            with self._lock:
                if self._call is None:
                    continue
                end, proxy = self._call
                if time.monotonic() > end and proxy.transport is not None:
                    self._has_barked = True
                    proxy.transport.socket.shutdown(2)


@dataclass(slots=True)
class Link:
    """The connection to one node.

    Attributes:
        is_lost: Whether the node is down.
        life: Number of losses so far.
        since: Sequence number of the first publication that the current process can have received; the node must
            be given earlier ones.
    """

    node: str
    watchdog: Watchdog
    on_loss: Callable[["Link", str], None]
    pid: int = 0
    is_lost: bool = True
    life: int = 0
    since: int = 0
    _handed_over: set[int] = field(default_factory=set)
    _pending: list[Any] = field(default_factory=list)
    _proxy: Any = None

    def connect(self, pid: int, since: int) -> None:
        """Connect to a (re)started node, which has received no publications before `since`."""
        import rospy
        from mavfi_msgs.srv import Drive

        self._restart()
        self._proxy = rospy.ServiceProxy(f"/{self.node}/drive", Drive, persistent=True)
        self.pid = pid
        self.since = since
        self.is_lost = False

    def lose(self) -> None:
        """Mark the node as down, its memory as lost."""
        self.is_lost = True
        self.life += 1
        self._restart()

    def reset(self, kernel: str, since: int) -> None:
        """Initialize the memory of a kernel's node without restarting its process."""
        self.note(NodeAction.RESET, kernel)
        self.since = since
        self._handed_over.clear()

    def _restart(self) -> None:
        self._pending.clear()
        self._handed_over.clear()

    def note(
        self,
        action: NodeAction,
        kernel: str,
        number: int = 0,
        time_us: int = 0,
        publish_us: int = HELD,
        state: str = "",
        value: bytes = b"",
    ) -> None:
        """Append an operation to the next call; arguments are the fields of `mavfi_msgs/Operation`."""
        if not self.is_lost:
            self._pending.append(message_type("Operation")(action, kernel, number, time_us, publish_us, state, value))

    def note_input(self, kernel: str, state: RemotePublication) -> None:
        """Give the node a value that was published before the current process started."""
        if state.number < self.since and state.number not in self._handed_over:
            self._handed_over.add(state.number)
            value = serialized(state, state.number)
            self.note(NodeAction.GIVE, kernel, state.number, state=state.spec.name, value=value)

    def flush(self) -> None:
        """Send all pending operations."""
        if self._pending:
            self._try_to_send()

    def call(self, action: NodeAction, kernel: str, number: int, time_us: int, publish_us: int = HELD) -> Any:
        """Send all pending operations, then this one; returns the response, None = the node is down."""
        if self.is_lost:
            return None
        self.note(action, kernel, number, time_us, publish_us)
        return self._try_to_send()

    def _try_to_send(self) -> Any:
        try:
            return self._send()
        except NodeLostError as loss:
            self.on_loss(self, str(loss))
            return None

    def _send(self) -> Any:
        """Send all pending operations; `NodeLostError` if the node does not answer."""
        import rospy

        cause = ""
        response = None
        self.watchdog.begin(self._proxy)
        try:
            response = self._proxy(self._pending)
        except (rospy.ServiceException, rospy.ROSException, OSError) as error:
            cause = str(error)
        was_aborted = self.watchdog.end()
        if response is None:
            raise NodeLostError(SILENT if was_aborted else cause)
        self._pending = []
        return response


class Counter:
    """Generator of sequence numbers of publications."""

    def __init__(self) -> None:
        self._next = 0

    def take(self, count: int = 1) -> int:
        """Reserve `count` sequence numbers; returns the first."""
        first = self._next
        self._next += count
        return first


class RemoteKernel:
    """Proxy of a kernel in another process."""

    def __init__(self, interface: KernelInterface, link: Link, counter: Counter, plan: FlightPlan) -> None:
        scenario = plan.scenario
        self._latencies = Latencies(scenario.platform, scenario.seed, scenario.latency_jitter)
        self._immediate = plan.immediate_states()
        self.name = interface.name
        self.stage = interface.stage
        self.reads = interface.reads
        self.writes = interface.writes
        self._triggers = interface.triggers
        self._link = link
        self._counter = counter

    def receive(self, state: State, time_us: int) -> bool:
        """Forward an input; returns whether a step is due."""
        assert isinstance(state, RemotePublication)
        self._link.note_input(self.name, state)
        if state.spec.name not in self._triggers:
            self._link.note(NodeAction.RECEIVE, self.name, state.number, time_us)
            return False
        response = self._link.call(NodeAction.RECEIVE, self.name, state.number, time_us)
        return response is not None and bool(response.due)

    def step(self, time_us: int) -> list[State]:
        """Execute one step; returns placeholders for the results, whose payload stays in the node."""
        return self._compute(NodeAction.STEP, time_us)

    def stop(self) -> list[State]:
        """Setpoint generator only: abandon the trajectory and hold position."""
        return self._compute(NodeAction.STOP, 0)

    def abandon(self, time_us: int) -> list[State]:
        """Setpoint generator only: replace the way-point in force by the next one."""
        return self._compute(NodeAction.ABANDON, time_us)

    def mark(self) -> None:
        """Mark the current memory for `rollback`."""
        self._link.note(NodeAction.MARK, self.name)

    def rollback(self) -> None:
        """Restore the memory of the last mark; inputs are unchanged."""
        self._link.note(NodeAction.ROLLBACK, self.name)

    def again(self) -> None:
        """Prepare to repeat the last step, see `pipeline.kernel.repeat`."""
        self._link.note(NodeAction.AGAIN, self.name)

    def resume(self, last: Mapping[str, State], time_us: int) -> tuple[str, ...]:
        """See `Kernel.resume`: the node is given the values."""
        for name in (*self.reads, *self.writes):
            state = last.get(name)
            if isinstance(state, RemotePublication):
                self._link.note_input(self.name, state)
        response = self._link.call(NodeAction.RESUME, self.name, 0, time_us)
        if response is None:
            return ()
        return tuple(response.states)

    def _compute(self, action: NodeAction, time_us: int) -> list[State]:
        first = self._counter.take(len(self.writes))
        publish_us = HELD
        if self._immediate:
            publish_us = time_us + self._latencies.of_kernel(self.name, time_us)
        response = self._link.call(action, self.name, first, time_us, publish_us)
        if response is None:
            return []
        return [self._promise(*result) for result in zip(response.states, response.numbers, strict=True)]

    def _promise(self, name: str, number: int) -> RemotePublication:
        """Placeholder for a value that the node has computed."""
        spec = STATES[name]
        link = self._link
        empty = np.zeros(1, spec.header_dtype), np.zeros(0, spec.element_dtype)
        return RemotePublication(spec, *empty, number, link, link.life, self.name, name in self._immediate)


class RemoteDetector(Detector):
    """Proxy of the detector in its node; while that is down, values pass unchecked."""

    def __init__(self, link: Link) -> None:
        self._link = link

    def check(self, state: State, time_us: int) -> Alarm | None:
        """The alarm of the node on a publication."""
        assert isinstance(state, RemotePublication)
        response = self._link.call(NodeAction.CHECK, state.spec.name, state.number, time_us)
        if response is None or not response.alarms:
            return None
        return alarm_of(response.alarms[0])

    def accept(self, state: State, time_us: int) -> None:
        """Let the node record a publication; sent with the next check."""
        assert isinstance(state, RemotePublication)
        self._link.note(NodeAction.ACCEPT, state.spec.name, state.number, time_us)
