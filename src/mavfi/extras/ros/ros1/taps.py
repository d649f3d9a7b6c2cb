"""Nodes that are no kernels: the injector, in the channel of one state, and the detector, which reads all."""

from dataclasses import fields
from typing import Any

import numpy as np

from mavfi.detectors.detector import Alarm
from mavfi.extras.ros.ros1.folder import read_injections, write_injections
from mavfi.extras.ros.ros1.graph import ALARM, DETECTOR, INJECTOR
from mavfi.extras.ros.ros1.messages import Action, message_type, to_stamp
from mavfi.extras.ros.ros1.plan import Plan
from mavfi.extras.ros.ros1.ports import Inbox, Ports
from mavfi.faults.levels.state_injector import StateInjector
from mavfi.states import State


class InjectorNode:
    """Injects the fault of a plan into one state's values in transit."""

    def __init__(self, plan: Plan) -> None:
        fault = plan.state_fault
        assert fault is not None
        self._inject = StateInjector(fault)
        self._is_spent = bool(read_injections())  # before a restart of this node
        self._ports = Ports(INJECTOR, plan)
        way = self._ports.ways[fault.where.state]
        self._outlet = self._ports.outlet(way.state, way.final)
        self._ports.read(way.state, way.first, self._arrived)

    def run(self) -> None:
        """Serve until shutdown."""
        self._ports.serve()

    def _arrived(self, state: State, number: int, time_us: int) -> None:
        if self._is_spent:
            self._outlet.publish(state, number, time_us)
            return
        seen = self._inject(state, time_us)
        assert seen is not None  # a plan has no faults that lose messages
        if self._inject.injections:
            self._is_spent = True
            write_injections(self._inject.injections)
        self._outlet.publish(seen, number, time_us)


class DetectorNode:
    """Checks and records the values that the world names, and publishes its alarms for other tools."""

    def __init__(self, plan: Plan) -> None:
        assert plan.detector is not None
        import rospy

        self._detector = plan.detector
        self._detector.start()
        self._ports = Ports(DETECTOR, plan)
        self._inbox = Inbox()
        self._checked: tuple[int, State] | None = None
        self._alarms = rospy.Publisher(ALARM, message_type("Alarm"), queue_size=None)
        for state, way in self._ports.ways.items():
            self._ports.read(state, way.final, lambda state, number, time_us: self._inbox.put(number, state))

    def run(self) -> None:
        """Serve until shutdown."""
        self._ports.serve(self._drive)

    def _drive(self, request: Any) -> Any:
        from mavfi_msgs.srv import DriveResponse

        response = DriveResponse()
        with np.errstate(all="ignore"):
            for order in request.operations:
                state = self._take(order.number)
                if order.action == Action.ACCEPT:
                    self._detector.accept(state, order.time_us)
                    continue
                alarm = self._detector.check(state, order.time_us)
                if alarm is not None:
                    response.alarms = [alarm_message(alarm, state, order)]
                    self._alarms.publish(response.alarms[0])
        return response

    def _take(self, number: int) -> State:
        """A value received over a topic; the one checked last is accepted next."""
        if self._checked is None or self._checked[0] != number:
            self._checked = number, self._inbox.take(number, self._ports.plan.patience_s)
        return self._checked[1]


def alarm_message(alarm: Alarm, state: State, order: Any) -> Any:
    """An alarm as a message; `order`: the operation that asked for the check."""
    message = message_type("Alarm")(number=order.number, state=state.spec.name)
    to_stamp(message.header.stamp, order.time_us)
    for name, value in alarm.to_json().items():
        setattr(message, name, value)
    message.fields = list(alarm.fields)
    return message


def alarm_of(message: Any) -> Alarm:
    """The alarm of a message."""
    values = {field.name: getattr(message, field.name) for field in fields(Alarm)}
    return Alarm(**{**values, "fields": tuple(message.fields)})
