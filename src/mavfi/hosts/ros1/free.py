"""The world node in free-running mode: simulated time follows the wall clock, without synchronization of nodes."""

import os
import queue
import signal
import time
from contextlib import suppress
from typing import Any

from mavfi.flight_log import AlarmRecord, Injection
from mavfi.hosts.loop.assemble import new_loop
from mavfi.hosts.loop.sensor_faults import inject_sensor_fault
from mavfi.hosts.ros1.convert import to_stamp
from mavfi.hosts.ros1.generate import message_type
from mavfi.hosts.ros1.graph import ALARM, BYPASS, DETECTOR, WORLD
from mavfi.hosts.ros1.mirrors import Senses
from mavfi.hosts.ros1.passage import state_injections
from mavfi.hosts.ros1.plan import Plan
from mavfi.hosts.ros1.ports import Ports, probe, world_listens
from mavfi.hosts.ros1.register_injector import PLANNED, RegisterInjector
from mavfi.hosts.ros1.roll_call import ENDED, HUNG, asks, cause, is_alive, wait_for_all
from mavfi.hosts.ros1.world import CAMERA_PATIENCE_US
from mavfi.states import PERIODIC, State

_POLL_US = 4_000
_GATE_PATIENCE_US = 1_000_000
"""A gate that has passed nothing for so long counts as hung (us)."""


class GateWatch:
    """Whether the gate passes values, judged by those of one sensor, which the world publishes and receives."""

    def __init__(self, ports: Ports) -> None:
        self._passed_us = 0
        way = ports.ways[probe(ports.plan)]
        for topic in (way.final, way.rejected):
            ports.read(way.state, topic, self._passed)
        self._reports = ports.publisher(BYPASS, "Bypass", awaited=len((*ports.plan.in_front, WORLD)))

    def why_down(self, pid: int, now: int) -> str:
        """Why the gate passes nothing; empty if it does."""
        if not is_alive(pid):
            return ENDED
        return HUNG if now - self._passed_us > _GATE_PATIENCE_US else ""

    def report(self, down: bool, now: int) -> None:
        """Make the nodes in front of the gate publish around it, or no longer."""
        self._passed_us = now
        message = message_type("Bypass")(on=down)
        to_stamp(message.header.stamp, now)
        self._reports.publish(message)

    def _passed(self, state: State, number: int, time_us: int) -> None:
        self._passed_us = max(self._passed_us, time_us)


class FreeWorld:
    """Simulates in real time, executes incoming commands, and keeps the flight record.

    The constructor waits until every node is connected; `loop` has no kernels, and a tap publishes the sensor values.
    """

    spent = False

    def __init__(self, plan: Plan) -> None:
        self.plan = plan
        self.loop = loop = new_loop(plan.scenario, make_kernels=lambda config: {})
        loop.busy = dict.fromkeys(PERIODIC)  # stepped by their own nodes
        loop.taps.injector = self
        inject_sensor_fault(loop, plan.fault)
        loop.actions.update(poll=self._poll, capture=self._capture)
        loop.before_tick.append(self._before_tick)
        loop.after_tick.append(self._after_tick)
        loop.before_end.append(self._before_end)
        loop.at(_POLL_US, "poll")
        self._kills = sorted(plan.kills, key=lambda kill: kill[1])
        self._gone: dict[str, int] = {}
        self._came: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._number = 0
        self._checked = False
        self._connect()
        self._start = time.monotonic()

    def _connect(self) -> None:
        plan, loop = self.plan, self.loop
        ports = Ports(WORLD, plan)
        self._sensors = {name: ports.outlet(way, way.first) for name, way in ports.ways.items() if way.writer == WORLD}
        for name, way in ports.ways.items():
            if world_listens(plan, name) and way.writer != WORLD:
                ports.read(name, way.final, lambda state, number, time_us: self._came.put(state))
        if plan.detector is not None:
            ports.listen(ALARM, "Verdict", self._came.put)
        self._gate = GateWatch(ports) if plan.gated else None
        self._senses = Senses(loop.plant, loop.sensors.estimating, plan.sensor_fault)
        self._pids = wait_for_all(plan)
        self._registers = RegisterInjector(plan.register_faults, lambda node: self._pids[node], hold=False)
        ports.wait_until_connected()

    # ---- injector tap ------------------------------------------------------------------------------------------------
    def __call__(self, state: State, time_us: int) -> None:
        """Publish a sensor value without waiting for subscribers; injection takes place in a separate node."""
        self.loop.record.publications.note(state, time_us)
        self._number += 1
        self._sensors[state.spec.name].publish(state, self._number, time_us)

    def finish(self) -> list[Injection]:
        """State injections, as recorded by the injector's node, and register injections."""
        return state_injections(self.plan) + self._registers.injections

    # ---- time -------------------------------------------------------------------------------------------------------
    def _capture(self, now: int) -> None:
        self._checked = False
        self.loop.capture(now)

    def _publish(self, state: State, now: int) -> None:
        """Publish a value; a map and its collision check use separate topics and may arrive in either order."""
        loop, name = self.loop, state.spec.name
        if name == "perception.collision_status" and not loop.mapped:
            self._checked = True
        loop.publish(state, now)
        if name == "perception.map_update" and self._checked:
            loop.mapped = self._checked = False
            loop.at(max(now, loop.captured_us + loop.scenario.camera.period_us), "capture")

    def _poll(self, now: int) -> None:
        """Wait for the instant on the wall clock, and process messages that arrive meanwhile."""
        self._wait(now)
        self.loop.at(now + _POLL_US, "poll")

    def _wait(self, now: int) -> None:
        while time.monotonic() < (then := self._start + 1e-6 * now):
            try:
                came = self._came.get(timeout=max(1e-4, then - time.monotonic()))
            except queue.Empty:
                continue
            self._take(came, now)
        while not self._came.empty():
            self._take(self._came.get(), now)

    def _before_tick(self, now: int) -> None:
        self._wait(now)
        self._watch_nodes(now)
        self._senses.publish(now)

    def _after_tick(self, now: int) -> None:
        if self.loop.status is None and now - self.loop.captured_us > CAMERA_PATIENCE_US:
            self._capture(now)

    def _take(self, came: Any, now: int) -> None:
        if isinstance(came, State):
            self._publish(came, now)
            return
        action = "stop" if came.stop else "abandon" if came.abandon_waypoint else "recompute"
        self.loop.record.alarms.append(
            AlarmRecord(
                1e-6 * now, came.source, came.state, came.stage, came.score, tuple(came.fields), action,
                "replaced" if came.withheld else "accepted",
            )
        )  # fmt: skip

    # ---- node crashes and restarts -----------------------------------------------------------------------------------
    def _watch_nodes(self, now: int) -> None:
        """Execute scheduled kills, and record crashes and restarts."""
        while self._kills and self._kills[0][1] <= now:
            self._lose(self._kills.pop(0)[0], PLANNED, now)
        self._watch_gate(now)
        self._watch_foreign(now)
        self._registers(now)
        for node, since in list(self._gone.items()):
            if (now - since) % 200_000 == 0:
                answer = asks(self.plan)[node](node)
                if answer is not None and answer != self._pids[node]:
                    self._pids[node] = answer
                    self._note("node_back", {"node": node, "pid": answer})
                    del self._gone[node]
                    if self._gate is not None:  # a node that was down has missed the last report
                        self._gate.report(DETECTOR in self._gone, now)

    def _lose(self, node: str, why: str, now: int) -> None:
        self._note("node_lost", {"node": node, "pid": self._pids[node], "why": why})
        with suppress(ProcessLookupError):
            os.kill(self._pids[node], signal.SIGKILL)
        self._gone[node] = now
        if node == DETECTOR and self._gate is not None:
            self._gate.report(True, now)

    def _watch_gate(self, now: int) -> None:
        """End a gate that hangs; roslaunch restarts it."""
        if self._gate is not None and DETECTOR not in self._gone:
            why = self._gate.why_down(self._pids[DETECTOR], now)
            if why:
                self._lose(DETECTOR, why, now)

    def _watch_foreign(self, now: int) -> None:
        """Record terminations of foreign nodes, including those killed after a hang."""
        for node in self.plan.foreign:
            if node not in self._gone and not is_alive(self._pids[node]):
                self._note("node_lost", {"node": node, "pid": self._pids[node], "why": cause(self._pids[node])})
                self._gone[node] = now

    def _note(self, kind: str, data: dict[str, Any]) -> None:
        self.loop.record.note(self.loop.now, kind, data)

    def _before_end(self) -> None:
        self._registers.finish(self.loop.now)
        self._watch_foreign(self.loop.now)
