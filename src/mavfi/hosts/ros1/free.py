"""The world in free-running mode: time passes as on the wall, and nobody waits for anybody."""

import os
import queue
import signal
import time
from typing import Any

from mavfi.detectors.detector import Alarm
from mavfi.faults.fault import Fault, Injection
from mavfi.faults.state import StateInjector
from mavfi.flight_log import Event
from mavfi.hosts.inprocess import Flight, Host
from mavfi.hosts.ros1.folder import read_strikes
from mavfi.hosts.ros1.foreign import ask_foreign, cause
from mavfi.hosts.ros1.graph import ALARM, WORLD
from mavfi.hosts.ros1.plan import Plan
from mavfi.hosts.ros1.ports import Ports, world_listens
from mavfi.hosts.ros1.roll_call import ask_ours, is_alive, wait_for
from mavfi.hosts.ros1.senses import Senses
from mavfi.hosts.ros1.strikes import PLANNED, Strikes
from mavfi.pipeline.ppc import PERIODIC
from mavfi.states import State

_POLL_US = 4_000
_CAMERA_PATIENCE_US = 2_000_000


class FreeWorld(Host):
    """Simulates as time passes, obeys the commands that come, and keeps the record."""

    def __init__(self, plan: Plan) -> None:
        """Wait until every node is there and connected.

        Args:
            plan: The flight.
        """
        super().__init__(plan.scenario, kernels=lambda config: {})
        self.busy = dict.fromkeys(PERIODIC)  # they are stepped by their own nodes
        self.plan = plan
        self.pids: dict[str, int] = {}
        self.kills = sorted(plan.kills, key=lambda kill: kill[1])
        self._gone: dict[str, int] = {}
        self._came: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._number = 0
        self._checked = False
        self._ports = ports = Ports(WORLD, plan)
        self._sensors = {name: ports.outlet(way, way.first) for name, way in ports.ways.items() if way.writer == WORLD}
        for name, way in ports.ways.items():
            if world_listens(plan, name) and way.writer != WORLD:
                ports.read(name, way.final, lambda state, number, time_us: self._came.put(state))
        if plan.detector is not None:
            ports.listen(ALARM, "Verdict", self._came.put)
        self._senses = Senses(self.sim, self.sensors.estimating)
        self.pids = {node: wait_for(node, plan.patience_s) for node in plan.nodes}
        self.pids.update({node: wait_for(node, plan.patience_s, ask=ask_foreign) for node in plan.foreign})
        self._strikes = Strikes(plan.strikes, lambda node: self.pids[node], self._note, hold=False)
        ports.wait_until_connected()
        self.injector = None if plan.fault is None else _Elsewhere(plan.fault)
        self._start = time.monotonic()

    def fly(self) -> Flight:
        """Run until the mission has a status."""
        self.at(_POLL_US, "poll")
        return super().fly()

    def capture(self, now: int) -> None:
        """Take a depth image."""
        self._checked = False
        super().capture(now)

    def publish(self, state: State, now: int) -> None:
        """Of the map and its check, which come on ways of their own, either may be the first to arrive."""
        name = state.spec.name
        if name == "perception.collision_status" and not self.mapped:
            self._checked = True
        super().publish(state, now)
        if name == "perception.map_update" and self._checked:
            self.mapped = self._checked = False
            self.at(max(now, self.captured_us + self.scenario.camera.period_us), "capture")

    def poll(self, now: int) -> None:
        """Wait until it is that late on the wall, and obey what comes meanwhile."""
        self._wait(now)
        self.at(now + _POLL_US, "poll")

    def _wait(self, now: int) -> None:
        while time.monotonic() < (then := self._start + 1e-6 * now):
            try:
                came = self._came.get(timeout=max(1e-4, then - time.monotonic()))
            except queue.Empty:
                continue
            self._take(came, now)
        while not self._came.empty():
            self._take(self._came.get(), now)

    def tick(self, now: int) -> None:
        """One control period."""
        self._wait(now)
        self._watch_nodes(now)
        self._senses.publish(now)
        super().tick(now)
        if self.status is None and now - self.captured_us > _CAMERA_PATIENCE_US:
            self.capture(now)

    def _take(self, came: Any, now: int) -> None:
        if isinstance(came, State):
            self.publish(came, now)
            return
        alarm = Alarm(
            came.source, came.stage, came.abandon_waypoint, came.stop, came.score, tuple(came.fields)
        )  # fmt: skip
        action = "stop" if came.stop else "abandon" if came.abandon_waypoint else "recompute"
        record = {"time_s": 1e-6 * now, **alarm.to_json(), "state": came.state, "action": action}
        self.alarms.append({**record, "outcome": "replaced" if came.withheld else "accepted"})

    def deliver(self, state: State, now: int) -> None:
        """Publish what sensors measure; nobody waits until it has been seen."""
        self.publications.note(state, now)
        self._number += 1
        self._sensors[state.spec.name].publish(state, self._number, now)

    # ---- nodes that die ---------------------------------------------------------------------------------------------
    def _watch_nodes(self, now: int) -> None:
        """Kill those that are to be killed, and see whether they are back."""
        while self.kills and self.kills[0][1] <= now:
            node = self.kills.pop(0)[0]
            self._note("node_lost", {"node": node, "pid": self.pids[node], "why": PLANNED})
            os.kill(self.pids[node], signal.SIGKILL)
            self._gone[node] = now
        self._watch_foreign(now)
        self._strikes.strike(now)
        for node, since in list(self._gone.items()):
            if (now - since) % 200_000 == 0:
                answer = (ask_foreign if node in self.plan.foreign else ask_ours)(node)
                if answer is not None and answer != self.pids[node]:
                    self.pids[node] = answer
                    self._note("node_back", {"node": node, "pid": answer})
                    del self._gone[node]

    def _watch_foreign(self, now: int) -> None:
        """Foreign nodes may end at any time; whoever works with them ends them if they hang."""
        for node in self.plan.foreign:
            if node not in self._gone and not is_alive(self.pids[node]):
                self._note("node_lost", {"node": node, "pid": self.pids[node], "why": cause(self.pids[node])})
                self._gone[node] = now

    def _note(self, kind: str, data: dict[str, Any]) -> None:
        self.events.append(Event(self.now, kind, data))

    def flight(self) -> Flight:
        """What became of it."""
        self._strikes.finish()
        self._watch_foreign(self.now)
        return super().flight()


class _Elsewhere:
    """The host's injector, which is a node: values do not come by here."""

    spent = False

    def __init__(self, fault: Fault) -> None:
        self._fault = fault

    def __call__(self, state: State, time_us: int) -> State:
        """Values go through the node itself."""
        return state

    def finish(self) -> list[Injection]:
        """All that the node did."""
        return read_strikes() or StateInjector(self._fault).finish()
