"""Nodes between kernels: the injector, and the detector as gate or observer."""

import json
import threading
from contextlib import suppress
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from mavfi.detectors.detector import Alarm
from mavfi.errors import BadInputError
from mavfi.faults.state import StateInjector
from mavfi.hosts.loop.decide import Action
from mavfi.hosts.loop.recovery import DetectorTap
from mavfi.hosts.ros1.convert import to_stamp
from mavfi.hosts.ros1.folder import read_injections, write_injections
from mavfi.hosts.ros1.generate import message_type
from mavfi.hosts.ros1.graph import ALARM, DETECTOR, INJECTION, INJECTOR, RECOMPUTE, VERDICT
from mavfi.hosts.ros1.plan import Plan
from mavfi.hosts.ros1.ports import Ports, fatal
from mavfi.mission import Scenario
from mavfi.states import STATES, State, StateSpec, in_node

if TYPE_CHECKING:
    from mavfi.hosts.loop.scheduler import Loop


class Injector:
    """Injects the fault of a plan into one state's values in transit."""

    def __init__(self, plan: Plan) -> None:
        fault = plan.state_fault
        assert fault is not None
        self._inject = StateInjector(fault)
        self._spent = bool(read_injections())  # before a restart of this node
        self._ports = Ports(INJECTOR, plan)
        way = self._ports.ways[fault.where.state]
        self._injections = self._ports.publisher(INJECTION, "Injection")
        self._outlet = self._ports.outlet(way, way.after_injector)
        self._ports.read(way.state, way.first, self._arrived)

    def run(self) -> None:
        """Serve until shutdown."""
        import rospy
        from mavfi_msgs.srv import Drive

        rospy.Service(f"/{INJECTOR}/drive", Drive, fatal(self._drive))
        self._ports.offer_ready()
        rospy.spin()

    def _drive(self, request: Any) -> Any:
        """The only operation of this node: to publish around the gate, or no longer."""
        from mavfi_msgs.srv import DriveResponse

        for order in request.operations:
            self._ports.bypass(order.number > 0)
        return DriveResponse()

    def _arrived(self, state: State, number: int, time_us: int) -> None:
        if self._spent:
            self._outlet.publish(state, number, time_us)
            return
        seen = self._inject(state, time_us)
        assert seen is not None  # a plan has no faults that lose messages
        done = self._inject.injections
        if done:
            self._spent = True
            write_injections(done)
        self._outlet.publish(seen, number, time_us)
        if done:
            message = message_type("Injection")(state=state.spec.name, record=json.dumps(done[-1].to_json()))
            to_stamp(message.header.stamp, time_us)
            self._injections.publish(message)


class Shadow:
    """Stub of a loop for a `DetectorTap` in the detector's node: the world has the real loop and executes the actions.

    Attributes:
        scenario, awaited, requests, busy: As of `Loop`.
        record: Alarms only; the world records events.
    """

    def __init__(self, scenario: Scenario) -> None:
        self.scenario = scenario
        self.awaited: dict[str, Any] = {}
        self.requests: dict[str, Any] = {}
        self.busy: dict[str, Any] = {}
        self.record = SimpleNamespace(alarms=[], note=lambda *_: None)

    def charge(self, action: Action) -> int:
        """No operation: the world charges the latency."""
        return 0

    def recompute(self, action: Action, now: int) -> None:
        """No operation: the world requests the step from the node."""

    def forget(self, kernel: str, now: int = 0, after_us: int = 0) -> None:
        """Clear pending recomputations of a node that dies or restarts: its next publication is checked."""
        for name in set(self.awaited):
            if STATES[name].writer in in_node(kernel):
                del self.awaited[name]


class Watcher:
    """Runs the detector of a plan on every value: as a gate before consumers receive it, or as an observer."""

    def __init__(self, plan: Plan) -> None:
        assert plan.detector is not None
        plan.detector.start()
        self._shadow = Shadow(plan.scenario)
        self._tap = DetectorTap(cast("Loop", self._shadow), plan.detector, plan.recovery, self._shadow.forget)
        self._gated, self._free = plan.gated, plan.free_running
        self._lock = threading.Lock()
        self._ports = ports = Ports(DETECTOR, plan)
        self._verdicts = ports.publisher(VERDICT, "Verdict", awaited=not plan.free_running)
        self._alarms = ports.publisher(ALARM, "Verdict")
        self._requests = ports.publisher(RECOMPUTE, "Recompute")
        self._outlets = {}
        self._rejects = {}
        for state, way in ports.ways.items():
            if plan.gated:
                self._outlets[state] = ports.outlet(way, way.final)
                self._rejects[state] = ports.outlet(way, way.rejected)
            ports.read(state, way.before_gate if plan.gated else way.final, self._arrived)

    def run(self) -> None:
        """Serve until shutdown."""
        import rospy
        from mavfi_msgs.srv import Drive

        rospy.Service(f"/{DETECTOR}/drive", Drive, fatal(self._drive))
        self._ports.offer_ready()
        rospy.spin()

    def _drive(self, request: Any) -> Any:
        """The only operation of this node: a kernel node has died."""
        from mavfi_msgs.srv import DriveResponse

        with self._lock:
            for order in request.operations:
                self._shadow.forget(order.kernel)
        return DriveResponse()

    def _arrived(self, state: State, number: int, time_us: int) -> None:
        with self._lock, np.errstate(all="ignore"):
            with suppress(BadInputError):  # an unknown stage: the world reports it
                self._tap(state, time_us)
            alarm, action = self._tap.alarm, self._tap.action
            withheld = action is not None and action.withholds
            if self._gated:
                (self._rejects if withheld else self._outlets)[state.spec.name].publish(state, number, time_us)
            if alarm is not None or not self._free:
                self._tell(state.spec, alarm, action, number, time_us)

    def _tell(self, spec: StateSpec, alarm: Alarm | None, action: Action | None, number: int, time_us: int) -> None:
        withheld = action is not None and action.withholds
        verdict = message_type("Verdict")(number=number, state=spec.name, withheld=withheld)
        to_stamp(verdict.header.stamp, time_us)
        if alarm is not None:
            verdict.raised = True
            for field, value in alarm.to_json().items():
                setattr(verdict, field, value)
            verdict.fields = list(alarm.fields)
            self._alarms.publish(verdict)
        if action is not None and action.kernel:
            request = message_type("Recompute")(
                kind=action.kind,
                stage=str(self._ports.plan.graph.faces[action.kernel].stage),
                kernel=action.kernel,
                restores=list(action.restores),
            )
            to_stamp(request.header.stamp, time_us)
            self._requests.publish(request)
        if not self._free:
            self._verdicts.publish(verdict)
