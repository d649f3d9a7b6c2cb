"""The world as a node: the simulator with the clock, and in lock-step the event queue that decides all order."""

import json
import os
import signal
import time
from typing import Any

import numpy as np

from mavfi.flight_log import Event
from mavfi.hosts.inprocess import Flight, Host
from mavfi.hosts.observed import ObservedHost
from mavfi.hosts.ros1.folder import FLIGHT, TIMES, flight_folder
from mavfi.hosts.ros1.foreign import ForeignLink, ask_foreign, cause
from mavfi.hosts.ros1.graph import WORLD
from mavfi.hosts.ros1.passage import LockStepDetector, Passage
from mavfi.hosts.ros1.plan import Plan
from mavfi.hosts.ros1.ports import Ports
from mavfi.hosts.ros1.remote import Counter, Link, NodeLostError, Publication, RemoteKernel, Watchdog
from mavfi.hosts.ros1.roll_call import is_alive, wait_for
from mavfi.hosts.ros1.senses import Senses
from mavfi.hosts.ros1.strikes import PLANNED, Strikes
from mavfi.pipeline.kernel import Kernel, PipelineConfig
from mavfi.states import State

_CAMERA_PATIENCE_US = 2_000_000
"""After a node was lost: when no answer to an image comes for so long, the camera takes the next one."""


def fly(plan: Plan) -> None:
    """Fly the mission and leave its record in the flight's folder.

    Args:
        plan: The flight.
    """
    started = time.time()
    if plan.free_running:
        from mavfi.hosts.ros1.free import FreeWorld

        host: Host = FreeWorld(plan)
    else:
        host = (ObservedConductor if plan.observed else Conductor)(plan)
    ready = time.time()
    with np.errstate(all="ignore"):
        flight = host.fly()
    done = time.time()
    times = {"world_started": started, "nodes_ready": ready, "flight_done": done}
    (flight_folder() / TIMES).write_text(json.dumps(times))
    part = flight_folder() / f"part-{FLIGHT}"
    flight.log.save(part)
    part.rename(flight_folder() / FLIGHT)


class Conductor(Host):
    """The in-process host with its kernels, injector and detector in other processes, in lock-step with them."""

    def __init__(self, plan: Plan) -> None:
        """Wait until every node is there and connected.

        Args:
            plan: The flight.
        """
        self.plan = plan
        self.counter = Counter()
        watchdog = Watchdog(plan.patience_s)
        self.links = {node: Link(node, watchdog, self._lost) for node in plan.nodes}
        self.foreign = {node: ForeignLink(node, watchdog, self._lost) for node in plan.foreign}
        self.links.update(self.foreign)
        self.back_us: dict[str, int] = {}
        self.losses = 0
        self.kills = sorted(plan.kills, key=lambda kill: kill[1])
        super().__init__(plan.scenario, kernels=self._proxies)
        self.ports = Ports(WORLD, plan)
        self.passage = Passage(self.ports, self.counter, self.links, self._lost)
        self.injector = self.passage
        if plan.detector is not None:
            self.detector = LockStepDetector(self.passage)
            self.marks = True
        self.senses = Senses(self.sim, self.sensors.estimating)
        self.strikes = Strikes(plan.strikes, lambda node: self.links[node].pid, self.note, hold=True)
        self.pids = {node: wait_for(node, plan.patience_s) for node in plan.nodes}
        self.pids.update({node: wait_for(node, plan.patience_s, ask=ask_foreign) for node in plan.foreign})
        self.ports.wait_until_connected()
        for node, link in self.links.items():
            link.connect(self.pids[node], self.counter.take(0))

    def _proxies(self, config: PipelineConfig) -> dict[str, Kernel]:
        del config
        graph = self.plan.graph
        return {
            name: RemoteKernel(face, self.links[graph.node_of(name)], self.counter, self.plan)
            for name, face in graph.faces.items()
        }

    # ---- the control period -----------------------------------------------------------------------------------------
    def tick(self, now: int) -> None:
        """One control period: nodes that are killed or come back, the clock, then as in one process."""
        while self.kills and self.kills[0][1] <= now:
            self._kill(self.kills.pop(0)[0])
        self._watch_foreign()
        self.strikes.strike(now)
        for node in [node for node, then in self.back_us.items() if then <= now]:
            self._rejoin(node)
        self.senses.publish(now)
        super().tick(now)
        if self.losses and self.status is None and now - self.captured_us > _CAMERA_PATIENCE_US:
            self.capture(now)

    def deliver(self, state: State, now: int) -> None:
        """A value on its way to its consumers, unless it is lost with its node or in a gate that is away."""
        if isinstance(state, Publication) and state.is_lost:
            return
        if state.spec.name == "sensor.depth" and any(link.lost for link in self.foreign.values()):
            return
        if any(self.links[tap].lost for tap in self.passage.taps(state.spec.name)):
            return
        try:
            super().deliver(state, now)
        except NodeLostError:
            return  # on its way

    def flight(self) -> Flight:
        """What became of it; a strike that is still waiting for its node will not come any more."""
        self.strikes.finish()
        self._watch_foreign()
        return super().flight()

    # ---- nodes that die ---------------------------------------------------------------------------------------------
    def _kill(self, node: str) -> None:
        link = self.links[node]
        if not link.lost:
            self._lost(link, PLANNED)

    def _watch_foreign(self) -> None:
        """Foreign nodes may end at any time; whoever works with them ends them if they hang."""
        for link in self.foreign.values():
            if not link.lost and not is_alive(link.pid):
                self._lost(link, cause(link.pid))

    def _lost(self, link: Link, why: str) -> None:
        """A node does not answer, or is to be killed: make sure that it is dead, and expect it back later."""
        if link.lost:
            return
        self.note("node_lost", {"node": link.node, "pid": link.pid, "why": why})
        try:
            os.kill(link.pid, signal.SIGKILL)
        except ProcessLookupError:
            pass
        link.lose()
        self.losses += 1
        self.back_us[link.node] = self.now + self.plan.restart_us

    def _rejoin(self, node: str) -> None:
        """The node that roslaunch has started anew takes part again, with nothing in its memory."""
        del self.back_us[node]
        link = self.links[node]
        try:
            pid = wait_for(node, self.plan.patience_s, link.pid, ask_foreign if node in self.foreign else None)
            if node in self.foreign:
                wait_for("point_cloud", self.plan.patience_s)  # it is connected when the nodelet answers it
            self.ports.wait_until_connected()
        except Exception as error:  # noqa: BLE001 (whatever it is, the flight goes on without the node)
            self.note("node_absent", {"node": node, "why": str(error)})
            return
        link.connect(pid, self.counter.take(0))
        self.note("node_back", {"node": node, "pid": pid})

    def note(self, kind: str, data: dict[str, Any]) -> None:
        """Write an event into the flight's record."""
        self.events.append(Event(self.now, kind, data))


class ObservedConductor(Conductor, ObservedHost):
    """The same with the detector as an observer."""
