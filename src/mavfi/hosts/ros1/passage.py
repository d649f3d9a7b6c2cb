"""Taps of the loop in lock-step: the world sends each value through the topics and receives the result."""

import time
from collections.abc import Callable
from typing import Any

from mavfi.detectors.detector import Alarm, Detector
from mavfi.faults.state import StateInjector
from mavfi.flight_log import Injection
from mavfi.hosts.ros1.folder import read_injections
from mavfi.hosts.ros1.graph import DETECTOR, VERDICT, WORLD
from mavfi.hosts.ros1.plan import Plan
from mavfi.hosts.ros1.ports import Inbox, Ports, world_listens
from mavfi.hosts.ros1.register_injector import RegisterInjector
from mavfi.hosts.ros1.remote import PUBLISH, Counter, Link, NodeLostError, Publication
from mavfi.hosts.ros1.roll_call import is_alive
from mavfi.states import State

_LOOK_S = 0.5


class Passage:
    """The injector tap: every published value passes the topics, and returns as the injector published it."""

    spent = False

    def __init__(
        self, ports: Ports, counter: Counter, links: dict[str, Link], registers: RegisterInjector,
        on_loss: Callable[[Link, str], None],
    ) -> None:  # fmt: skip
        self.verdict: Alarm | None = None
        self._counter = counter
        self._links, self._registers = links, registers
        self._on_loss = on_loss
        self._plan = ports.plan
        self._ways = ports.ways
        self._inbox = Inbox()
        self._sensors = {
            name: ports.outlet(way, way.first) for name, way in self._ways.items() if way.writer == WORLD
        }  # fmt: skip
        for name, way in self._ways.items():
            if world_listens(self._plan, name):
                ports.read(name, way.final, self._arrived)
            if way.gated:
                ports.read(name, way.rejected, self._arrived)
        if self._plan.detector is not None:
            ports.listen(VERDICT, "Verdict", self._judged)
        self._judging = self._plan.detector is not None

    def __call__(self, state: State, time_us: int) -> State | None:
        """Publish a value; returns the output of the injector, None if the value was lost in transit."""
        if self._is_lost(state):
            return None
        try:
            return self._pass(state, time_us)
        except NodeLostError:
            return None

    def _is_lost(self, state: State) -> bool:
        """Whether a value died with its node, or its route contains a node that is down."""
        if isinstance(state, Publication) and state.is_lost:
            return True
        name = state.spec.name
        there = (*self._taps(name), *(self._plan.foreign if name == "sensor.depth" else ()))
        return any(self._links[node].lost for node in there)

    def _taps(self, name: str) -> tuple[str, ...]:
        """Nodes between writer and consumers of a state; a gate that is down is bypassed."""
        return tuple(node for node in self._ways[name].taps if node != DETECTOR or not self._links[node].lost)

    def _pass(self, state: State, time_us: int) -> State:
        if isinstance(state, Publication) and state.link is not None:
            number = state.number
            if not state.sent and state.link.call(PUBLISH, state.kernel, number, time_us) is None:
                raise NodeLostError(state.link.node)
        else:
            number = self._counter.take()
            self._sensors[state.spec.name].publish(state, number, time_us)
        self.verdict = self._await(("verdict", number), state) if self._judges() else None
        seen = state
        if world_listens(self._plan, state.spec.name):
            seen = self._await(number, state)
        return Publication(seen.spec, seen.header, seen.elements, number)

    def finish(self) -> list[Injection]:
        """State injections and register injections."""
        return state_injections(self._plan) + self._registers.injections

    def _judges(self) -> bool:
        return self._judging and not self._links[DETECTOR].lost

    def _await(self, key: Any, state: State) -> Any:
        """Wait for a node's publication; `NodeLostError` if a node on the route has died."""
        end = time.monotonic() + self._plan.patience_s
        writer, taps = self._ways[state.spec.name].writer, self._taps(state.spec.name)
        judge = (DETECTOR,) * self._judges()
        while True:
            try:
                return self._inbox.take(key, _LOOK_S)
            except TimeoutError:
                late = time.monotonic() > end
            # the writer has confirmed its publication: a timeout is attributed to the last node on the route
            slow = (*taps, *judge)[-1:] or (writer,)
            for node in dict.fromkeys((writer, *taps, *judge)):
                link = self._links.get(node)
                if link is not None and (link.lost or not is_alive(link.pid) or (late and node in slow)):
                    self._on_loss(link, "does not answer")
                    raise NodeLostError(node)

    def _arrived(self, state: State, number: int, time_us: int) -> None:
        self._inbox.put(number, state)

    def _judged(self, verdict: Any) -> None:
        alarm = None
        if verdict.raised:
            alarm = Alarm(
                verdict.source, verdict.stage, verdict.abandon_waypoint, verdict.stop, verdict.score,
                tuple(verdict.fields), verdict.hard,
            )  # fmt: skip
        self._inbox.put(("verdict", verdict.number), alarm)


def state_injections(plan: Plan) -> list[Injection]:
    """State injections, as recorded by the injector's node; a missed activation if its publication never occurred."""
    if plan.state_fault is None:
        return []
    return read_injections() or StateInjector(plan.state_fault).finish()


class LockStepDetector(Detector):
    """The loop's detector: returns the verdict of the detector's node on the last published value."""

    def __init__(self, passage: Passage) -> None:
        self._passage = passage

    def check(self, state: State, time_us: int) -> Alarm | None:
        """The verdict of the node."""
        return self._passage.verdict
