"""The nodes between kernels: the injector, and the detector as a gate or as an observer."""

import json
import threading

import numpy as np

from mavfi.detectors.detector import Alarm
from mavfi.faults.state import StateInjector
from mavfi.hosts.ros1.convert import to_stamp
from mavfi.hosts.ros1.folder import read_strikes, write_strikes
from mavfi.hosts.ros1.generate import message_type
from mavfi.hosts.ros1.graph import ALARM, DETECTOR, INJECTION, INJECTOR, RECOMPUTE, VERDICT
from mavfi.hosts.ros1.plan import Plan
from mavfi.hosts.ros1.ports import Ports
from mavfi.platforms.compute import STAGE_KERNELS
from mavfi.states import Stage, State, StateSpec


class Injector:
    """Sits in the way of one state, and strikes it once."""

    def __init__(self, plan: Plan) -> None:
        """Take its place in the graph.

        Args:
            plan: The flight; it has a fault.
        """
        assert plan.fault is not None
        self._strike = StateInjector(plan.fault)
        self._spent = bool(read_strikes())  # in a former life
        self._ports = Ports(INJECTOR, plan)
        way = self._ports.ways[plan.fault.site.state]
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
        struck = self._strike(state, time_us)
        done = self._strike.injections
        if done:
            self._spent = True
            write_strikes(done)
        self._outlet.publish(struck, number, time_us)
        if done:
            message = message_type("Injection")(state=state.spec.name, record=json.dumps(done[-1].to_json()))
            to_stamp(message.header.stamp, time_us)
            self._injections.publish(message)


def withholds(alarm: Alarm, spec: StateSpec) -> tuple[bool, str]:
    """What an alarm does to the value that raised it, by the host's rules of recovery.

    Args:
        alarm: What the detector said.
        spec: State of the value.

    Returns:
        Whether the value is held back; and the state whose next value comes from the recomputation, "" if none.
    """
    if alarm.stop or alarm.abandon_waypoint:
        return spec.name == "planning.waypoint", "planning.waypoint"
    if spec.stage is Stage.SENSOR or alarm.stage != spec.stage:
        return False, ""
    return True, spec.name


def asked(alarm: Alarm, spec: StateSpec) -> str:
    """Name of the kernel that an alarm asks to compute again; "" = none."""
    if alarm.stop or alarm.abandon_waypoint:
        return "waypoint"
    if withholds(alarm, spec)[0]:
        scanning = STAGE_KERNELS[Stage.PERCEPTION]
        return scanning[0] if spec.writer in scanning else spec.writer
    return "pid" if alarm.stage == Stage.CONTROL else ""


class Watcher:
    """Shows every value to the detector: as a gate before consumers see it, or beside them."""

    def __init__(self, plan: Plan) -> None:
        """Take its place in the graph.

        Args:
            plan: The flight; it has a detector.
        """
        assert plan.detector is not None
        self._detector = plan.detector
        self._detector.start()
        self._gated = plan.gated
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
            alarm, withheld = self._judge(state, time_us)
            if self._gated:
                (self._rejects if withheld else self._outlets)[state.spec.name].publish(state, number, time_us)
            if alarm is not None or not self._free:
                self._tell(state.spec, alarm, withheld, number, time_us)

    def _judge(self, state: State, time_us: int) -> tuple[Alarm | None, bool]:
        """The alarm, and whether the value is held back; what comes from a recomputation passes."""
        name = state.spec.name
        if name in self._again:
            self._again.discard(name)
            self._detector.accept(state, time_us)
            return None, False
        alarm = self._detector.check(state, time_us)
        withheld, again = (False, "") if alarm is None else withholds(alarm, state.spec)
        if alarm is None or not self._gated:
            self._detector.accept(state, time_us)
        if again:
            self._again.add(again)
        return alarm, withheld and self._gated

    def _tell(self, spec: StateSpec, alarm: Alarm | None, withheld: bool, number: int, time_us: int) -> None:
        verdict = message_type("Verdict")(number=number, state=spec.name, withheld=withheld)
        to_stamp(verdict.header.stamp, time_us)
        if alarm is not None:
            verdict.raised = True
            for field, value in alarm.to_json().items():
                setattr(verdict, field, value)
            verdict.fields = list(alarm.fields)
            self._alarms.publish(verdict)
            kernel = asked(alarm, spec)
            if kernel:
                stage = str(self._ports.plan.graph.faces[kernel].stage)
                request = message_type("Recompute")(
                    stage=stage, kernel=kernel, abandon_waypoint=alarm.abandon_waypoint, stop=alarm.stop
                )
                to_stamp(request.header.stamp, time_us)
                self._requests.publish(request)
        if not self._free:
            self._verdicts.publish(verdict)
