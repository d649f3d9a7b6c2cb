"""Topics of a node in lock step: greetings that prove connections, values by number, and calls."""

import json
import os
import time
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple, NoReturn

from mavfi.errors import MavfiError
from mavfi.extras.ros.lockstep.encoding import GREETING, TopicFrame, from_bytes, from_frame, to_bytes, to_frame
from mavfi.extras.ros.lockstep.folder import flight_folder, write_file
from mavfi.extras.ros.lockstep.plan import WORLD, FlightPlan, answers_topic, calls_topic
from mavfi.extras.ros.lockstep.transport import Transport
from mavfi.extras.ros.processes import is_alive
from mavfi.states import STATES, State

SILENT = "does not answer"
"""Cause of a lost node, as in events: it did not answer in time, and was killed."""
ENDED = "its process has ended"
"""Cause of a lost node, as in events: it ended by itself, or was killed by somebody else."""
_POLL_S = 0.005
_LOOK_S = 0.02
"""Period at which a waiting node looks whether the awaited process still runs (s, wall clock)."""
_FOREVER_S = 3600.0


class Loss(NamedTuple):
    """A process for which a node waited in vain: its id, and the cause."""

    pid: int
    why: str


class NodeLostError(Exception):
    """A node does not respond: it has crashed or hangs; the argument is the cause."""


class Notes(NamedTuple):
    """What a node has noted in the flight's folder.

    Attributes:
        pid: Its process id; 0 = it has noted nothing yet.
        is_ready: Whether it is connected to all other nodes.
        greeted_by: For each topic that it reads, the process whose greeting has arrived; None = none yet.
    """

    pid: int = 0
    is_ready: bool = False
    greeted_by: dict[str, int | None] = {}  # noqa: RUF012 - never changed


def read_notes(node: str) -> Notes:
    """The latest notes of a node."""
    path = flight_folder() / _notes_file(node)
    if path.exists():
        return Notes(**json.loads(path.read_text()))
    return Notes()


def _notes_file(node: str) -> str:
    return f"{node}.json"


class Publisher:
    """Publishes frames to a topic of the flight, whose subscribers are `readers`; a node that connects is greeted."""

    def __init__(self, transport: Transport, topic: str, readers: Iterable[str]) -> None:
        self.topic = topic
        self.readers = tuple(readers)
        self._send = transport.publisher(topic, to_frame(GREETING, os.getpid()))

    def publish(self, number: int, time_us: int, content: bytes) -> None:
        """Publish one frame."""
        self._send(to_frame(number, time_us, content))

    def publish_state(self, state: State, number: int, time_us: int) -> None:
        """Publish the value of a state."""
        self._send(to_frame(number, time_us, to_bytes(state)))


class Ports:
    """Publications and subscriptions of a node.

    A connection counts as established once the subscriber has received a greeting of the publisher's process: what is
    published afterwards reaches it.  Every node notes in a file of the flight's folder whose greetings it has received;
    so a publisher learns of it, too.  The number of connections that a middleware reports includes those of processes
    that were killed, and of other people's tools.
    """

    def __init__(self, node: str, plan: FlightPlan, transport: Transport) -> None:
        self.node = node
        self.plan = plan
        self.transport = transport
        self.routes = plan.graph.routes
        self._publishers: list[Publisher] = []
        self._greeted_by: dict[str, int | None] = {}
        self._is_ready = False
        self._note()

    def publisher(self, topic: str, readers: Iterable[str]) -> Publisher:
        """Advertise a topic that nodes of the flight read."""
        publisher = Publisher(self.transport, topic, readers)
        self._publishers.append(publisher)
        return publisher

    def outlet(self, state: str, topic: str) -> Publisher:
        """Advertise one of the topics on the route of a state."""
        return self.publisher(topic, self.plan.readers(state, topic))

    def subscribe(self, topic: str, arrived: Callable[[TopicFrame], None]) -> None:
        """Subscribe to a topic of the flight."""
        self._greeted_by[topic] = None

        def handle(content: bytes) -> None:
            frame = from_frame(content)
            if frame.number != GREETING:
                arrived(frame)
            elif self._greeted_by[topic] != frame.time_us:
                self._greeted_by[topic] = frame.time_us
                self._note()

        self.transport.subscribe(topic, handle)

    def read(self, state: str, topic: str, arrived: Callable[[State, int, int], None]) -> None:
        """Subscribe to values of a state; `arrived` receives a value, its number, and its instant (us)."""
        spec = STATES[state]
        self.subscribe(topic, lambda frame: arrived(from_bytes(spec, frame.content), frame.number, frame.time_us))

    # ---- connections to the other nodes ------------------------------------------------------------------------------
    def wait_until_connected(self) -> None:
        """Wait until this node is connected to every publisher and subscriber of the flight, or raise `MavfiError`."""
        end = time.monotonic() + self.plan.patience_s
        while not self._is_connected():
            self.transport.wait(lambda: False, _POLL_S)
            if time.monotonic() > end:
                raise MavfiError(f"node {self.node}: not connected within {self.plan.patience_s:g} s")
        self._is_ready = True
        self._note()

    def wait_for(self, node: str, not_pid: int = 0) -> int:
        """Wait until a node is connected whose process is not `not_pid`; returns its process id.

        Raises:
            MavfiError: It is not within the plan's patience.
        """

        def is_ready() -> bool:
            notes = read_notes(node)
            return notes.is_ready and notes.pid != not_pid

        end = time.monotonic() + self.plan.patience_s
        while not is_ready():
            self.transport.wait(lambda: False, _POLL_S)
            if time.monotonic() > end:
                raise MavfiError(f"node {node}: is not there after {self.plan.patience_s:g} s")
        return read_notes(node).pid

    def _is_connected(self) -> bool:
        """Whether all greetings have arrived: those of others here, and those of this process at its subscribers."""
        if None in self._greeted_by.values():
            return False
        notes = {reader: read_notes(reader) for publisher in self._publishers for reader in publisher.readers}
        return all(
            notes[reader].greeted_by.get(publisher.topic) == os.getpid()
            for publisher in self._publishers
            for reader in publisher.readers
        )

    def _note(self) -> None:
        """Let the other nodes know whose greetings have arrived."""
        notes = Notes(os.getpid(), self._is_ready, self._greeted_by)
        write_file(_notes_file(self.node), json.dumps(notes._asdict()).encode())

    def wait_with(self, until: Callable[[], bool], pids: Sequence[int]) -> Loss | None:
        """Wait for what processes do one after the other; returns the loss if it cannot come any more."""
        end = time.monotonic() + self.plan.patience_s
        while not self.transport.wait(until, _LOOK_S):
            for pid in pids:
                # look once more: a process may have ended after it did what it is waited for
                if not is_alive(pid) and not self.transport.wait(until, 0.0):
                    return Loss(pid, ENDED)
            if time.monotonic() > end:
                return Loss(pids[-1], SILENT)
        return None

    # ---- calls -------------------------------------------------------------------------------------------------------
    def serve(self, answer: Callable[[bytes], bytes] | None = None) -> NoReturn:
        """Answer the world's calls one after the other, until this process is ended; None = it makes none."""
        calls: deque[TopicFrame] = deque()
        if answer is not None:
            answers = self.publisher(answers_topic(self.node), [WORLD])
            self.subscribe(calls_topic(self.node), calls.append)
        self.wait_until_connected()
        while True:
            if self.transport.wait(lambda: bool(calls), _FOREVER_S):
                call = calls.popleft()
                assert answer is not None
                answers.publish(call.number, 0, answer(call.content))


class Inbox:
    """Values that have arrived, by number, until they are taken."""

    def __init__(self, ports: Ports) -> None:
        self._ports = ports
        self._values: dict[int, State] = {}

    def read(self, state: str, topic: str) -> None:
        """Subscribe to the values of a state."""
        self._ports.read(state, topic, self._put)

    def take(self, number: int) -> State:
        """Wait for a value and remove it; raises `TimeoutError` if it does not arrive within the plan's patience."""
        patience_s = self._ports.plan.patience_s
        if not self._ports.transport.wait(lambda: number in self._values, patience_s):
            raise TimeoutError(f"publication {number} did not come within {patience_s:g} s")
        return self._values.pop(number)

    def take_from(self, number: int, pids: Sequence[int]) -> State | Loss:
        """As `take`, or the loss of one of the processes through which the value passes."""
        loss = self._ports.wait_with(lambda: number in self._values, pids)
        if loss is not None:
            return loss
        return self._values.pop(number)

    def _put(self, state: State, number: int, time_us: int) -> None:
        self._values[number] = state


class Client:
    """The world's side of the calls to one node."""

    def __init__(self, ports: Ports, node: str) -> None:
        self._ports = ports
        self._calls = ports.publisher(calls_topic(node), [node])
        self._number = 0
        self._answers: dict[int, bytes] = {}
        ports.subscribe(answers_topic(node), self._arrived)

    def call(self, content: bytes, pid: int) -> bytes:
        """The answer of the node, whose process has this id.

        Raises:
            NodeLostError: The process has ended, or does not answer in time.
        """
        self._number += 1
        number = self._number
        self._calls.publish(number, 0, content)
        loss = self._ports.wait_with(lambda: number in self._answers, [pid])
        if loss is not None:
            raise NodeLostError(loss.why)
        return self._answers.pop(number)

    def _arrived(self, frame: TopicFrame) -> None:
        if frame.number == self._number:  # not the answer to a call that was given up
            self._answers[frame.number] = frame.content
