"""The world node: simulator and clock, and in lock-step the event queue that determines the order of all events."""

import json
import os
import signal
import time
from collections.abc import Mapping
from contextlib import suppress
from typing import Any

from mavfi.hosts.loop.assemble import new_loop, watch
from mavfi.hosts.loop.restarts import Restarts
from mavfi.hosts.loop.scheduler import Loop
from mavfi.hosts.loop.sensor_faults import inject_sensor_fault
from mavfi.hosts.ros1.folder import FLIGHT, PROFILE, TIMES, flight_folder, write_file
from mavfi.hosts.ros1.graph import DETECTOR, WORLD
from mavfi.hosts.ros1.mirrors import Senses
from mavfi.hosts.ros1.passage import LockStepDetector, Passage
from mavfi.hosts.ros1.plan import Plan
from mavfi.hosts.ros1.ports import Ports
from mavfi.hosts.ros1.register_injector import PLANNED, RegisterInjector
from mavfi.hosts.ros1.remote import BYPASS, FORGET, Counter, ForeignLink, Link, RemoteKernel, Watchdog
from mavfi.hosts.ros1.roll_call import asks, cause, is_alive, wait_for, wait_for_all
from mavfi.pipeline.kernel import Kernel, PipelineConfig

CAMERA_PATIENCE_US = 2_000_000
"""After a node loss: time without a response to an image after which the camera takes the next one (us)."""


def fly(plan: Plan) -> None:
    """Fly the mission and write its record to the flight's folder."""
    started = time.time()
    if plan.free_running:
        from mavfi.hosts.ros1.free import FreeWorld

        loop = FreeWorld(plan).loop
    else:
        loop = Conductor(plan).loop
    ready = time.time()
    flight = loop.fly()
    times = {"world_started": started, "nodes_ready": ready, "flight_done": time.time()}
    (flight_folder() / TIMES).write_text(json.dumps(times))
    if flight.profile is not None:
        write_file(PROFILE, flight.profile.to_bytes())
    part = flight_folder() / f"part-{FLIGHT}"
    flight.log.save(part)
    part.rename(flight_folder() / FLIGHT)


class Conductor:
    """The loop with its kernels, injector and detector in other processes, in lock-step with them.

    The constructor waits until every node is connected; its `loop` has not started.
    """

    def __init__(self, plan: Plan) -> None:
        self.plan = plan
        self.counter = Counter()
        watchdog = Watchdog(plan.patience_s)
        self.links = {node: Link(node, watchdog, self._lost) for node in plan.nodes}
        self.foreign = {node: ForeignLink(node, watchdog, self._lost) for node in plan.foreign}
        self.links.update(self.foreign)
        self.back_us: dict[str, int] = {}
        self.losses = 0
        self.kills = sorted(plan.kills, key=lambda kill: kill[1])
        self.registers = RegisterInjector(plan.register_faults, lambda node: self.links[node].pid, hold=True)
        self.loop = self._compose()
        self.restarts = Restarts(self.loop, plan.scenario.dead_node)
        self.loop.renew = self._renew
        self.senses = Senses(self.loop.plant, self.loop.sensors.estimating, self.plan.sensor_fault)
        self.ports.offer_recall()
        pids = wait_for_all(plan)
        self.ports.wait_until_connected()
        for node, link in self.links.items():
            link.connect(pids[node], self.counter.take(0))

    def _compose(self) -> Loop:
        """The loop with the proxies, taps and callbacks of this flight."""
        plan = self.plan
        loop = new_loop(plan.scenario, profile=plan.profile, make_kernels=self._proxies)
        self.ports = Ports(WORLD, plan)
        passage = Passage(self.ports, self.counter, self.links, self.registers, self._lost)
        loop.taps.injector = passage
        inject_sensor_fault(loop, plan.fault)
        watch(loop, None if plan.detector is None else LockStepDetector(passage), plan.recovery)
        loop.before_tick.append(self._before_tick)
        loop.after_tick.append(self._after_tick)
        loop.before_end.append(self._before_end)
        return loop

    def _proxies(self, config: PipelineConfig) -> dict[str, Kernel]:
        graph = self.plan.graph
        return {
            name: RemoteKernel(face, self.links[graph.node_of(name)], self.counter, self.plan)
            for name, face in graph.faces.items()
        }

    # ---- the control period -----------------------------------------------------------------------------------------
    def _before_tick(self, now: int) -> None:
        """Kill, inject and reconnect nodes; publish the clock."""
        while self.kills and self.kills[0][1] <= now:
            self._lost(self.links[self.kills.pop(0)[0]], PLANNED)
        self._watch_foreign()
        self.registers(now)
        for node in [node for node, then in self.back_us.items() if then <= now]:
            del self.back_us[node]
            self._rejoin(node)
        self.senses.publish(now)

    def _after_tick(self, now: int) -> None:
        loop = self.loop
        if self.losses and loop.status is None and now - loop.captured_us > CAMERA_PATIENCE_US:
            loop.capture(now)

    def _before_end(self) -> None:
        self.registers.finish(self.loop.now)
        self._watch_foreign()

    # ---- node crashes and restarts -----------------------------------------------------------------------------------
    def _watch_foreign(self) -> None:
        """Detect terminations of foreign nodes, including those killed after a hang."""
        for link in self.foreign.values():
            if not link.lost and not is_alive(link.pid):
                self._lost(link, cause(link.pid))

    def _lost(self, link: Link, why: str) -> None:
        """A node does not respond or is to be killed: kill its process, and schedule its return."""
        if link.lost:
            return
        self._note("node_lost", {"node": link.node, "pid": link.pid, "why": why})
        with suppress(ProcessLookupError):
            os.kill(link.pid, signal.SIGKILL)
        link.lose()
        self.losses += 1
        kernels = self.plan.graph.nodes.get(link.node)
        if kernels is None:
            self.back_us[link.node] = self.loop.now + self.plan.restart_us
            if link.node == DETECTOR and self.plan.gated:
                self._report_gate()
            return
        self.restarts.die(kernels[0], self.loop.now, self.plan.restart_us)
        if self.plan.detector is not None:
            self.links[DETECTOR].call(FORGET, kernels[0], 0, 0)

    def _renew(self, kernel: str) -> Mapping[str, Kernel]:
        """Reconnect a restarted node, or reset a live one; pending operations are flushed to its peers first."""
        link = self.links[self.plan.graph.node_of(kernel)]
        for other in self.links.values():
            other.flush()
        if link.lost:
            self._rejoin(link.node)
        else:
            link.reset(kernel, self.counter.take(0))
        return {} if link.lost else self._proxies(self.plan.config)

    def _rejoin(self, node: str) -> None:
        """Reconnect a node that roslaunch has restarted, with initialized memory."""
        link = self.links[node]
        try:
            pid = wait_for(node, self.plan.patience_s, link.pid, asks(self.plan)[node])
            if node in self.foreign:
                wait_for("point_cloud", self.plan.patience_s)  # ready once the nodelet responds to its probe
            self.ports.wait_until_connected()
        except Exception as error:  # noqa: BLE001 (any cause: the flight continues without the node)
            self._note("node_absent", {"node": node, "why": str(error)})
            return
        link.connect(pid, self.counter.take(0))
        self._note("node_back", {"node": node, "pid": pid})
        if self.plan.gated:
            self._report_gate()

    def _report_gate(self) -> None:
        """Make the nodes in front of the gate publish around it while it is down, and no longer after its return."""
        down = self.links[DETECTOR].lost
        self.ports.bypass(down)
        for node in self.plan.in_front:
            kernels = self.plan.graph.nodes.get(node, ("",))
            self.links[node].call(BYPASS, kernels[0], int(down), 0)

    def _note(self, kind: str, data: dict[str, Any]) -> None:
        self.loop.record.note(self.loop.now, kind, data)
