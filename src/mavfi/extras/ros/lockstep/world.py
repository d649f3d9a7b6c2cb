"""The world node: simulator, clock, and the event queue that determines the order of all events."""

import json
import os
import signal
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any

from mavfi.extras.ros.lockstep.encoding import NodeAction
from mavfi.extras.ros.lockstep.folder import FLIGHT, TIMES, flight_folder, read_injections, write_profile
from mavfi.extras.ros.lockstep.plan import DETECTOR, INJECTOR, WORLD
from mavfi.extras.ros.lockstep.ports import Client, Inbox, Loss, NodeLostError, Ports
from mavfi.extras.ros.lockstep.register_injector import PLANNED, RegisterInjector
from mavfi.extras.ros.lockstep.remote import Counter, Link, RemoteDetector, RemoteKernel, RemotePublication
from mavfi.extras.ros.lockstep.views import Views
from mavfi.flight.compose import new_loop, watch
from mavfi.flight.loop import Listener, Loop
from mavfi.flight.observers import ObserverListener
from mavfi.flight.restarts import Restarts
from mavfi.levels.sensor.injector import inject_sensor_fault
from mavfi.levels.state.injector import StateInjector
from mavfi.pipeline.kernel import Kernel, PipelineConfig
from mavfi.record import Injection
from mavfi.states import State

CAMERA_PATIENCE_US = 2_000_000
"""After a node loss: time without a response to an image after which the camera takes the next one (us)."""


def fly(ports: Ports) -> None:
    """Fly the mission and write its record to the flight's folder."""
    started = time.time()
    loop = Conductor(ports).loop
    ready = time.time()
    flight = loop.fly()
    times = {"world_started": started, "nodes_ready": ready, "flight_done": time.time()}
    (flight_folder() / TIMES).write_text(json.dumps(times))
    if flight.profile is not None:
        write_profile(flight.profile)
    part = flight_folder() / f"part-{FLIGHT}"
    flight.log.save(part)
    part.rename(flight_folder() / FLIGHT)


class Conductor(Listener):
    """The loop with its kernels, injector and detector in other processes, in lock-step with them.

    The constructor waits until every node is connected; its `loop` has not started.
    """

    def __init__(self, ports: Ports) -> None:
        plan = ports.plan
        self.plan = plan
        self.ports = ports
        self.counter = Counter()
        self.links = {node: Link(node, self._lost) for node in plan.nodes}
        self.back_us: dict[str, int] = {}
        self.losses = 0
        self.kills = sorted(plan.kills, key=lambda kill: kill[1])
        self.registers = RegisterInjector(plan.register_faults, lambda node: self.links[node].pid)
        self.loop = self._compose()
        self.restarts = Restarts(self.loop, plan.scenario.dead_node)
        self.loop.renew = self._renew
        self._connect()
        self._began = time.monotonic()

    def _compose(self) -> Loop:
        """The loop with the proxies, taps and callbacks of this flight."""
        plan = self.plan
        loop = new_loop(plan.scenario, profile=plan.profile, make_kernels=self._proxies)
        loop.taps.injector = TopicTap(self.ports, self.counter, self.links, self.registers, self._lost)
        inject_sensor_fault(loop, plan.fault)
        detector = None
        if plan.detector is not None:
            detector = RemoteDetector(self.links[DETECTOR])
        watch(loop, detector, plan.recovery)
        loop.listeners.append(self)
        loop.attach(ObserverListener(Views(self.ports.transport, plan)))
        return loop

    def _connect(self) -> None:
        """Wait for all nodes; the injector's answers no calls."""
        for node, link in self.links.items():
            if node != INJECTOR:
                link.advertise(Client(self.ports, node))
        self.ports.wait_until_connected()
        for node, link in self.links.items():
            link.connect(self.ports.wait_for(node), self.counter.take(0))

    def _proxies(self, config: PipelineConfig) -> dict[str, Kernel]:
        graph = self.plan.graph
        return {
            name: RemoteKernel(interface, self.links[graph.node_of(name)], self.counter, self.plan)
            for name, interface in graph.interfaces.items()
        }

    # ---- the control period -----------------------------------------------------------------------------------------
    def before_tick(self, now: int) -> None:
        """Wait for the wall clock if requested; kill, inject and reconnect nodes."""
        if self.plan.pace > 0:
            time.sleep(max(0.0, self._began + 1e-6 * now / self.plan.pace - time.monotonic()))
        while self.kills and self.kills[0][1] <= now:
            node, _ = self.kills.pop(0)
            self._lost(self.links[node], PLANNED)
        self.registers(now)
        for node in [node for node, back_us in self.back_us.items() if back_us <= now]:
            del self.back_us[node]
            self._rejoin(node)

    def after_tick(self, now: int) -> None:
        """Take the image that a lost node did not ask for."""
        loop = self.loop
        if self.losses and loop.status is None and now - loop.state.captured_us > CAMERA_PATIENCE_US:
            loop.capture(now)

    def before_end(self) -> None:
        """Close the record of faults in registers."""
        self.registers.finish(self.loop.now)

    # ---- node crashes and restarts -----------------------------------------------------------------------------------
    def _lost(self, link: Link, why: str) -> None:
        """A node does not respond or is to be killed: kill its process, and schedule its return."""
        if link.is_lost:
            return
        self._note("node_lost", {"node": link.node, "pid": link.pid, "why": why})
        with suppress(ProcessLookupError):
            os.kill(link.pid, signal.SIGKILL)
        link.lose()
        self.losses += 1
        kernels = self.plan.graph.nodes.get(link.node)
        if kernels is None:
            self.back_us[link.node] = self.loop.now + self.plan.restart_us
        else:
            self.restarts.die(kernels[0], self.loop.now, self.plan.restart_us)

    def _renew(self, kernel: str) -> Mapping[str, Kernel]:
        """Reconnect a restarted node, or reset a live one; pending operations are flushed to its peers first."""
        link = self.links[self.plan.graph.node_of(kernel)]
        for other in self.links.values():
            other.flush()
        if link.is_lost:
            self._rejoin(link.node)
        else:
            link.reset(kernel, self.counter.take(0))
        if link.is_lost:
            return {}
        return self._proxies(self.plan.config)

    def _rejoin(self, node: str) -> None:
        """Reconnect a node that the supervisor has restarted, with initialized memory."""
        link = self.links[node]
        try:
            pid = self.ports.wait_for(node, link.pid)
        except Exception as error:  # noqa: BLE001 (any cause: the flight continues without the node)
            self._note("node_absent", {"node": node, "why": str(error)})
            return
        link.connect(pid, self.counter.take(0))
        self._note("node_back", {"node": node, "pid": pid})

    def _note(self, kind: str, data: dict[str, Any]) -> None:
        self.loop.record.note(self.loop.now, kind, data)


class TopicTap:
    """The injector tap: every published value passes the topics, and returns as its consumers receive it."""

    spent = False

    def __init__(
        self,
        ports: Ports,
        counter: Counter,
        links: dict[str, Link],
        registers: RegisterInjector,
        on_loss: Callable[[Link, str], None],
    ) -> None:
        self._counter = counter
        self._links = links
        self._registers = registers
        self._on_loss = on_loss
        self._plan = ports.plan
        self._routes = ports.routes
        self._inbox = Inbox(ports)
        self._sensors = {
            name: ports.outlet(name, route.first) for name, route in self._routes.items() if route.writer == WORLD
        }
        for name, route in self._routes.items():
            if self._plan.world_listens(name):
                self._inbox.read(name, route.final)

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
        if isinstance(state, RemotePublication) and state.is_lost:
            return True
        nodes = self._routes[state.spec.name].nodes
        return any(node in self._links and self._links[node].is_lost for node in nodes[1:])

    def _pass(self, state: State, time_us: int) -> State:
        """Publish a value, by its node or here, and wait until it has passed its route."""
        if isinstance(state, RemotePublication) and state.link is not None:
            number = state.number
            if not state.sent and state.link.call(NodeAction.PUBLISH, state.kernel, number, time_us) is None:
                raise NodeLostError(state.link.node)
        else:
            number = self._counter.take()
            self._sensors[state.spec.name].publish_state(state, number, time_us)
        if self._plan.world_listens(state.spec.name):
            seen = self._await(number, state)
        else:
            seen = state
        return RemotePublication(seen.spec, seen.header, seen.elements, number)

    def _await(self, number: int, state: State) -> State:
        """Wait until a value has passed its route; `NodeLostError` if a node on the route is lost."""
        # The writer has confirmed its publication: if nothing comes, that is due to the last node on the route.
        links = [self._links[node] for node in self._routes[state.spec.name].nodes if node in self._links]
        seen = self._inbox.take_from(number, [link.pid for link in links])
        if not isinstance(seen, Loss):
            return seen
        lost = next(link for link in links if link.pid == seen.pid)
        self._on_loss(lost, seen.why)
        raise NodeLostError(lost.node)

    def finish(self) -> list[Injection]:
        """State injections, as recorded by the injector's node, and register injections.

        A state fault whose publication never occurred is a missed activation.
        """
        injections: list[Injection] = []
        if self._plan.state_fault is not None:
            injections = read_injections() or StateInjector(self._plan.state_fault).finish()
        return injections + self._registers.injections
