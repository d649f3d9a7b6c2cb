"""The nodes between kernels: the injector, and the detector as a gate or as an observer."""

import json
import threading
from contextlib import suppress

import numpy as np

from mavfi.detectors.detector import Alarm
from mavfi.errors import BadInputError
from mavfi.faults.state import StateInjector
from mavfi.hosts.loop.recovery import Action, Recovery, decide
from mavfi.hosts.ros1.convert import to_stamp
from mavfi.hosts.ros1.folder import read_injections, write_injections
from mavfi.hosts.ros1.generate import message_type
from mavfi.hosts.ros1.graph import ALARM, DETECTOR, INJECTION, INJECTOR, RECOMPUTE, VERDICT
from mavfi.hosts.ros1.plan import Plan
from mavfi.hosts.ros1.ports import Ports
from mavfi.states import State, StateSpec


class Injector:
    """Injects the fault of a plan into the values of one state on their way."""

    def __init__(self, plan: Plan) -> None:
        assert plan.fault is not None
        self._inject = StateInjector(plan.fault)
        self._spent = bool(read_injections())  # in a former life
        self._ports = Ports(INJECTOR, plan)
        way = self._ports.ways[plan.fault.where.state]
        self._injections = self._ports.publisher(INJECTION, "Injection")
        self._outlet = self._ports.outlet(way, way.after_injector)
        self._ports.read(way.state, way.first, self._arrived)

    def run(self) -> None:
        """Serve until the end."""
        import rospy

        self._ports.offer_ready()
        rospy.spin()

    def _arrived(self, state: State, number: int, time_us: int) -> None:
        if self._spent:
            self._outlet.publish(state, number, time_us)
            return
        seen = self._inject(state, time_us)
        done = self._inject.injections
        if done:
            self._spent = True
            write_injections(done)
        self._outlet.publish(seen, number, time_us)
        if done:
            message = message_type("Injection")(state=state.spec.name, record=json.dumps(done[-1].to_json()))
            to_stamp(message.header.stamp, time_us)
            self._injections.publish(message)


class Watcher:
    """Shows every value to the detector of a plan: as a gate before consumers see it, or as an observer."""

    def __init__(self, plan: Plan) -> None:
        assert plan.detector is not None
        self._detector = plan.detector
        self._detector.start()
        self._recovery, self._gated = Recovery(plan.coupling), plan.gated
        self._free = plan.free_running
        self._again: set[str] = set()
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
        """Serve until the end."""
        import rospy

        self._ports.offer_ready()
        rospy.spin()

    def _arrived(self, state: State, number: int, time_us: int) -> None:
        with self._lock, np.errstate(all="ignore"):
            alarm, action = self._judge(state, time_us)
            withheld = action is not None and action.withholds
            if self._gated:
                (self._rejects if withheld else self._outlets)[state.spec.name].publish(state, number, time_us)
            if alarm is not None or not self._free:
                self._tell(state.spec, alarm, action, number, time_us)

    def _judge(self, state: State, time_us: int) -> tuple[Alarm | None, Action | None]:
        """The alarm, and the response to it; the result of a recomputation passes."""
        name = state.spec.name
        if name in self._again:
            self._again.discard(name)
            self._detector.accept(state, time_us)
            return None, None
        alarm = self._detector.check(state, time_us)
        if alarm is None or not self._gated:
            self._detector.accept(state, time_us)
        action = None
        if alarm is not None:
            with suppress(BadInputError):  # an unknown stage, which the world reports
                action = decide(alarm, state.spec, self._recovery)
        if action is not None and action.awaited:
            self._again.add(action.awaited)
        return alarm, action

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
