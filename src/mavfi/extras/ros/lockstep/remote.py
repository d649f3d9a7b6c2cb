"""The world's side of lock-step: proxies of kernels and of the detector in other processes.

The world owns the event queue of the in-process host, and with it the order of all events.  A proxy has the interface
of a kernel: an operation without a result (a non-triggering input, a mark) is sent with the next call that has one.
Values travel over the topics from node to node; an operation refers to them by sequence number, and a node waits for a
value that it has to receive.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from mavfi.detectors.detector import Alarm, Detector
from mavfi.extras.ros.lockstep.encoding import (
    HELD,
    Answer,
    NodeAction,
    NodeOrder,
    answer_from_bytes,
    operations_to_bytes,
    to_bytes,
)
from mavfi.extras.ros.lockstep.plan import FlightPlan, KernelInterface
from mavfi.extras.ros.lockstep.ports import Client, NodeLostError
from mavfi.flight.latencies import Latencies
from mavfi.states import STATES, State


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


@dataclass(slots=True)
class Link:
    """The connection to one node.

    Attributes:
        on_loss: Called with the link and the cause when the node does not answer.
        pid: Process id of the node.
        is_lost: Whether the node is down.
        life: Number of losses so far.
        since: Sequence number of the first publication that the current process can have received; the node must
            be given earlier ones.
    """

    node: str
    on_loss: Callable[["Link", str], None]
    pid: int = 0
    is_lost: bool = True
    life: int = 0
    since: int = 0
    _handed_over: set[int] = field(default_factory=set)
    _pending: list[NodeOrder] = field(default_factory=list)
    _client: Client | None = None

    def advertise(self, client: Client) -> None:
        """Call the node by this client from now on."""
        self._client = client

    def connect(self, pid: int, since: int) -> None:
        """Begin a life of the node, whose process has received no publications before `since`."""
        self._restart()
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
        value: str = "",
    ) -> None:
        """Append an operation to the next call; see `NodeOrder`."""
        if not self.is_lost:
            self._pending.append(NodeOrder(action, kernel, number, time_us, publish_us, state, value))

    def note_input(self, kernel: str, state: RemotePublication) -> None:
        """Give the node a value that was published before the current process started."""
        if state.number < self.since and state.number not in self._handed_over:
            self._handed_over.add(state.number)
            value = to_bytes(state).hex()
            self.note(NodeAction.GIVE, kernel, state.number, state=state.spec.name, value=value)

    def flush(self) -> None:
        """Send all pending operations."""
        if self._pending:
            self._try_to_send()

    def call(self, action: NodeAction, kernel: str, number: int, time_us: int, publish_us: int = HELD) -> Answer | None:
        """Send all pending operations, then this one; returns the answer, None = the node is down."""
        if self.is_lost:
            return None
        self.note(action, kernel, number, time_us, publish_us)
        return self._try_to_send()

    def _try_to_send(self) -> Answer | None:
        """Send all pending operations; None = the node has been lost."""
        assert self._client is not None
        try:
            content = self._client.call(operations_to_bytes(self._pending), self.pid)
        except NodeLostError as loss:
            self.on_loss(self, str(loss))
            return None
        self._pending = []
        return answer_from_bytes(content)


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
        return response is not None and response.due

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
        if response is None:
            return None
        return response.alarm

    def accept(self, state: State, time_us: int) -> None:
        """Let the node record a publication; sent with the next check."""
        assert isinstance(state, RemotePublication)
        self._link.note(NodeAction.ACCEPT, state.spec.name, state.number, time_us)
