"""A fault in the messages of a running ROS 2 graph: what was injected, its proof, and what came of it."""

import math
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, replace
from typing import Any

from mavfi.errors import BadInputError, MavfiError
from mavfi.extras.ros.ros2.graph import AgentClient, GraphSnapshot, RawMessage
from mavfi.extras.ros.ros2.interposer.attach import Attachments
from mavfi.extras.ros.ros2.interposer.page import ControlPage, InterposedFault, Report
from mavfi.extras.ros.ros2.message_types import Decoder, TypeLibrary
from mavfi.extras.ros.ros2.processes import GraphProcesses, NodeProcess, program_of
from mavfi.record import Injection

_LIFECYCLE = "lifecycle_msgs/msg/TransitionEvent"
"""Type of the messages by which managed nodes announce their transitions."""
_POLL_S = 0.01
_REPLACEMENT_S = 5.0
"""How long a supervisor may take to start a node again (s)."""
_CLOCK_PERIOD_S = 0.02
"""How often simulated time is passed on to the processes (s)."""
_SECOND_READER_S = 2.0
"""How long the message of an injection may take to a second reader (s)."""
_MAX_MESSAGES = 20_000
"""Messages that are remembered for the second reader."""


@dataclass(frozen=True, slots=True)
class GraphInjection:
    """An injection into a message, as reported by the process in which it happened.

    Attributes:
        fault: The fault.
        report: What was done, or why not.
        armed_s: Wall-clock instant at which the fault was armed (s since 1970).
        node: Node and program of the process.
        verified: Whether a second reader received the changed number; None = it cannot be told.
    """

    fault: InterposedFault
    report: Report
    armed_s: float
    node: str
    verified: bool | None = None

    def to_injection(self) -> Injection:
        """The injection as in records and `--json`."""
        site = self.fault.topic
        if self.fault.field:
            site = f"{self.fault.topic}.{self.fault.field}"
        details: dict[str, Any] = {
            "topic": self.fault.topic,
            "side": self.fault.side,
            "field": self.fault.field,
            "operation": str(self.fault.change.operation),
            "message": self.report.message,
            "kind": self.report.dtype,
            "wall_s": self.report.wall_s,
            "pid": self.report.pid,
            "node": self.node,
            "verified": self.verified,
        }
        if self.report.sim_s:
            details["sim_s"] = self.report.sim_s
        return Injection(
            "message",
            site,
            round(self.report.wall_s - self.armed_s, 6),
            self.report.bit,
            self.report.before,
            self.report.after,
            activated=self.report.kind == "changed",
            details=details,
        )


class RunningGraphInjection:
    """A fault in a running graph; a context manager that leaves the graph as it was.

    Args:
        agent: In the graph.
        fault: Without its type.
        node: Only in the process of this node; "" = of all on its side.

    Attributes:
        processes: Into which the interposer was loaded.
        unreachable: Why it was not loaded into others, one line each.

    Raises:
        BadInputError: There is no such topic, service, node, member or type, or none of the processes can be reached.
    """

    def __init__(self, agent: AgentClient, fault: InterposedFault, node: str = "") -> None:
        self._agent = agent
        self._node = node
        targets = agent.find(lambda snapshot: _targets(snapshot, fault, node))
        kind = targets[0].kind
        self._fault = replace(fault, type=kind)
        self._types = TypeLibrary(agent.installation.distribution, agent.definition)
        self._decoder: Decoder | None = None
        if fault.side in ("publish", "take"):
            self._decoder = Decoder(kind, self._types)
            self._decoder.check(fault.field, fault.change)
        self.processes = [target for target in targets if target.pid is not None]
        self.unreachable = [f"{target.node}: {target.problem}" for target in targets if target.pid is None]
        self._messages: list[RawMessage] = []
        self._armed_s = 0.0
        self._last_injection_s: float | None = None
        self._told: set[str] = set()
        self._sim_s = 0.0

    def __enter__(self) -> "RunningGraphInjection":
        with ExitStack() as stack:
            self._page = stack.enter_context(ControlPage())
            attachments = stack.enter_context(Attachments(self._page))
            for pid in sorted({process.pid for process in self.processes if process.pid is not None}):
                try:
                    attachments.attach(pid)
                except MavfiError as error:
                    self.unreachable.append(str(error))
            if not attachments.redirected:
                reasons = "; ".join(self.unreachable)
                raise BadInputError(f"{self._fault.topic}: no process can be reached: {reasons}")
            self._stack = stack.pop_all()
        self._listen()
        if self._fault.change.when.sim_time:
            self._follow_clock()
        self._page.arm([self._fault])
        self._armed_s = time.time()
        return self

    def __exit__(self, *_: object) -> None:
        # First, so that the counts and reports are complete and no longer grow.
        self._page.disarm()
        self._stack.close()

    # ---- what happens -----------------------------------------------------------------------------------------------
    @property
    def is_over(self) -> bool:
        """Whether the fault changes no more messages."""
        when = self._fault.change.when
        if 0 < when.times <= self._page.messages_changed(0):
            return True
        if when.sim_time:
            return self._sim_s > when.end_s
        return time.time() - self._armed_s > when.end_s

    @property
    def has_target(self) -> bool:
        """Whether one of the processes is still there."""
        return any(process.pid is not None and program_of(process.pid) for process in self.processes)

    @property
    def messages(self) -> int:
        """Number of messages that have passed."""
        return self._page.messages_seen(0)

    @property
    def changed(self) -> int:
        """Number of messages that were changed."""
        return self._page.messages_changed(0)

    def new_reports(self) -> Iterator[GraphInjection]:
        """Injections and refusals since the last call, each verified by a second reader where that is possible."""
        for report in self._page.reports():
            process = next((process for process in self.processes if process.pid == report.pid), None)
            node = ""
            if process is not None:
                node = process.node
            verified = None
            if report.kind == "changed":
                self._last_injection_s = report.wall_s
                verified = self._is_verified(report)
            yield GraphInjection(self._fault, report, self._armed_s, node, verified)

    def aftermath(self) -> Iterator[str]:
        """What became of the processes and of managed nodes since the last call, in one line each."""
        for process in self.processes:
            if process.pid is not None and not program_of(process.pid):
                yield from self._news(f"process {process.pid} of {process.node} has ended", time.time())
        self._drain()
        if self._last_injection_s is None:
            return
        for message in self._messages:
            if message.topic.endswith("/transition_event") and message.wall_ns > 1e9 * self._last_injection_s:
                state = Decoder(_LIFECYCLE, self._types).text(message.data, "goal_state.label")
                node = message.topic.removesuffix("/transition_event")
                yield from self._news(f"{node}: its life-cycle state became {state!r}", 1e-9 * message.wall_ns)

    def _news(self, text: str, wall_s: float) -> Iterator[str]:
        """A line, unless it has been told, with the time since the last injection if there was one."""
        if text in self._told:
            return
        self._told.add(text)
        if self._last_injection_s is None:
            yield text
        else:
            yield f"{wall_s - self._last_injection_s:.1f} s after the injection: {text}"

    def replacement(self) -> str:
        """Who has taken the place of processes that have ended since the injection; "" = nobody, or none has."""
        if not any("has ended" in text for text in self._told):
            return ""
        earlier = {process.pid for process in self.processes}
        end = time.monotonic() + _REPLACEMENT_S
        while time.monotonic() < end:
            with suppress(MavfiError):
                targets = _targets(self._agent.snapshot(), self._fault, self._node)
                for target in targets:
                    if target.pid is not None and target.pid not in earlier:
                        return f"process {target.pid} ({program_of(target.pid)}) has taken its place"
        return ""

    # ---- the second reader ------------------------------------------------------------------------------------------
    def _listen(self) -> None:
        """Read what others read: the changed topic, and the transitions of managed nodes."""
        if self._fault.side == "publish" and self._fault.field:
            self._agent.subscribe(self._fault.topic)
        for topic in self._agent.snapshot().topics:
            if _LIFECYCLE in topic.kinds:
                with suppress(BadInputError):  # the installation lacks the type
                    self._agent.subscribe(topic.name)

    def _drain(self) -> None:
        """Move the messages that have arrived to the list of remembered ones."""
        while (message := self._agent.receive(0.0)) is not None:
            self._messages.append(message)
        del self._messages[:-_MAX_MESSAGES]

    def _is_verified(self, report: Report) -> bool | None:
        """Whether a second reader receives a message with the changed number; None = it is no reader of it."""
        if self._fault.side != "publish" or not self._fault.field or self._decoder is None:
            return None
        end = time.monotonic() + _SECOND_READER_S
        checked = 0
        while True:
            self._drain()
            for message in self._messages[checked:]:
                if message.topic == self._fault.topic and 1e-9 * message.wall_ns >= report.wall_s:
                    value = self._decoder.number(message.data, self._fault.field)
                    if value is not None and _same(value, report.after):
                        return True
            checked = len(self._messages)
            if time.monotonic() > end:
                return False
            time.sleep(_POLL_S)

    def _follow_clock(self) -> None:
        """Pass on simulated time until the end."""
        is_over = threading.Event()
        self._stack.callback(is_over.set)

        def follow() -> None:
            while not is_over.wait(_CLOCK_PERIOD_S):
                with suppress(MavfiError):
                    sim_ns = self._agent.now(0.0).sim_ns
                    if sim_ns is not None:
                        self._sim_s = 1e-9 * sim_ns
                        self._page.set_sim_time(self._sim_s)

        threading.Thread(target=follow, daemon=True).start()


def _targets(snapshot: GraphSnapshot, fault: InterposedFault, node: str) -> Sequence[NodeProcess]:
    """The processes on the side of a fault, or that of one of its nodes."""
    processes = GraphProcesses(snapshot)
    find: Callable[[str], tuple[NodeProcess, ...]] = {
        "publish": processes.pids_of_publishers,
        "take": processes.pids_of_subscribers,
        "take_request": processes.pids_of_service,
        "send_response": processes.pids_of_service,
        "send_request": processes.pids_of_clients,
        "take_response": processes.pids_of_clients,
    }[fault.side]
    targets = find(fault.topic)
    if node:
        full_name = "/" + node.removeprefix("/")
        names = ", ".join(sorted({target.node for target in targets})) or "none"
        targets = tuple(target for target in targets if target.node == full_name)
        if not targets:
            raise BadInputError(f"--node: {node!r}: not on this side of {fault.topic}; allowed: {names}")
    if not targets:
        what = {"publish": "publishes", "take": "reads"}.get(fault.side, "has")
        raise BadInputError(f"{fault.topic}: no node {what} it")
    return targets


def _same(value: float, after: float | int | bool | None) -> bool:
    """Whether two numbers are equal; NaN equals NaN."""
    if after is None:
        return False
    return value == after or (math.isnan(value) and math.isnan(after))
