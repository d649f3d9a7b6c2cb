"""The generic kernel node: any set of kernels behind ROS topics, driven by the world in lock-step."""

from collections.abc import Callable
from dataclasses import fields
from typing import Any

import numpy as np

from mavfi.detectors.detector import Alarm, Detector
from mavfi.extras.ros.ros1.folder import read_injections, write_injections
from mavfi.extras.ros.ros1.messages import NodeAction, deserialized, message_type, to_stamp
from mavfi.extras.ros.ros1.plan import ALARM, DETECTOR, INJECTOR, FlightPlan
from mavfi.extras.ros.ros1.ports import Inbox, Ports
from mavfi.faults.levels.state_injector import injector_of
from mavfi.flight.compose import new_loop, watch
from mavfi.flight.decide import INLINE, RecoveryPolicy
from mavfi.mission import Scenario
from mavfi.pipeline.kernel import Kernel, repeat
from mavfi.pipeline.ppc import build_pipeline
from mavfi.states import State

_LOADING_FLIGHT_US = 3_000_000
"""Simulated time within which every kernel has been executed (us)."""


class KernelNode:
    """Executes the world's operations in order, on values received over the topics."""

    def __init__(self, name: str, plan: FlightPlan) -> None:
        self._ports = Ports(name, plan)
        self._build()
        self._inbox = Inbox()
        self._states_in_use: dict[int, tuple[State, int]] = {}
        self._due: dict[str, tuple[int, State]] = {}
        self._results: dict[int, State] = {}
        self._restored: dict[int, State] = {}
        self._immediate = plan.immediate_states()
        written = [state for kernel in self._kernels.values() for state in kernel.writes]
        self._outlets = {state: self._ports.outlet(state, self._ports.routes[state].first) for state in written}
        self._actions: dict[int, Callable[[Kernel, Any], Any]] = {
            NodeAction.STEP: lambda kernel, order: kernel.step(order.time_us),
            NodeAction.MARK: lambda kernel, order: kernel.mark(),
            NodeAction.ROLLBACK: lambda kernel, order: kernel.rollback(),
            NodeAction.STOP: lambda kernel, order: kernel.stop(),  # type: ignore[attr-defined]
            NodeAction.ABANDON: lambda kernel, order: kernel.abandon(order.time_us),  # type: ignore[attr-defined]
            NodeAction.AGAIN: lambda kernel, order: repeat(kernel),
            NodeAction.RECEIVE: self._receive,
            NodeAction.PUBLISH: self._publish,
            NodeAction.GIVE: self._restore,
            NodeAction.RESUME: self._resume,
            NodeAction.RESET: self._reset,
        }

    def _build(self) -> None:
        """Construct the kernels of this node."""
        plan = self._ports.plan
        built = build_pipeline(plan.config)
        self._kernels = {kernel: built[kernel] for kernel in plan.graph.nodes[self._ports.node]}

    def _reading(self, state: str) -> list[Kernel]:
        """Kernels of this node that read a state."""
        return [kernel for kernel in self._kernels.values() if state in kernel.reads]

    def run(self) -> None:
        """Serve until shutdown."""
        for state, route in self._ports.routes.items():
            if self._reading(state):
                self._ports.read(state, route.final, lambda state, number, time_us: self._inbox.put(number, state))
        self._ports.serve(self._drive)

    def _drive(self, request: Any) -> Any:
        """Execute the operations of a call in order; the response is what came of them."""
        from mavfi_msgs.srv import DriveResponse

        response = DriveResponse()
        with np.errstate(all="ignore"):
            for order in request.operations:
                answer = self._actions[order.action](self._kernels[order.kernel], order)
                if order.action in (NodeAction.STEP, NodeAction.STOP, NodeAction.ABANDON):
                    response.numbers = list(range(order.number, order.number + len(answer)))
                    response.states = [state.spec.name for state in answer]
                    self._keep_results(answer, response.numbers, order.publish_us)
                elif order.action == NodeAction.RESUME:
                    response.states = list(answer)
                elif answer:
                    response.due = True
        return response

    def _keep_results(self, states: list[State], numbers: list[int], publish_us: int) -> None:
        """Keep results until they are published, or publish them now with the stamp of that instant."""
        for state, number in zip(states, numbers, strict=True):
            if publish_us >= 0 and state.spec.name in self._immediate:
                self._outlets[state.spec.name].publish(state, number, publish_us)
            else:
                self._results[number] = state

    def _receive(self, kernel: Kernel, order: Any) -> bool:
        number = order.number
        waiting, state = self._due.get(kernel.name, (-1, None))
        if waiting != number or state is None:
            state = self._take(number)
        due = kernel.receive(state, order.time_us)
        if due:
            self._due[kernel.name] = number, state
        return due

    def _take(self, number: int) -> State:
        """A value received over a topic, for one of the kernels that read it."""
        if number in self._restored:
            return self._restored[number]
        if number not in self._states_in_use:
            state = self._inbox.take(number, self._ports.plan.patience_s)
            self._states_in_use[number] = state, len(self._reading(state.spec.name))
        state, left = self._states_in_use.pop(number)
        if left > 1:
            self._states_in_use[number] = state, left - 1
        return state

    def _publish(self, kernel: Kernel, order: Any) -> None:
        state = self._results.pop(order.number)
        self._outlets[state.spec.name].publish(state, order.number, order.time_us)

    # ---- after a restart --------------------------------------------------------------------------------------------
    def _restore(self, kernel: Kernel, order: Any) -> None:
        """Keep a value of before the restart."""
        self._restored[order.number] = deserialized(order.value, order.state)

    def _resume(self, kernel: Kernel, order: Any) -> tuple[str, ...]:
        latest = {self._restored[number].spec.name: self._restored[number] for number in sorted(self._restored)}
        return kernel.resume(latest, order.time_us)

    def _reset(self, kernel: Kernel, order: Any) -> None:
        """Initialize the memory; results already computed remain scheduled for publication."""
        self._build()
        self._due.clear()
        self._restored.clear()


def warm_up(scenario: Scenario, detector: Detector | None = None, recovery: RecoveryPolicy = INLINE) -> None:
    """Fly the first seconds in this process, so that all functions are compiled and loaded."""
    loop = new_loop(scenario)
    watch(loop, detector, recovery)
    loop.judge.limit_us = _LOADING_FLIGHT_US
    loop.fly()


# ---- nodes that are no kernels ---------------------------------------------------------------------------------------


class InjectorNode:
    """Injects the fault of a plan into one state's values in transit."""

    def __init__(self, plan: FlightPlan) -> None:
        fault = plan.state_fault
        assert fault is not None
        self._inject = injector_of(fault)
        self._is_spent = bool(read_injections())  # before a restart of this node
        self._ports = Ports(INJECTOR, plan)
        route = self._ports.routes[fault.where.state]
        self._outlet = self._ports.outlet(route.state, route.final)
        self._ports.read(route.state, route.first, self._arrived)

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

    def __init__(self, plan: FlightPlan) -> None:
        assert plan.detector is not None
        import rospy

        self._detector = plan.detector
        self._detector.start()
        self._ports = Ports(DETECTOR, plan)
        self._inbox = Inbox()
        self._checked: tuple[int, State] | None = None
        self._alarms = rospy.Publisher(ALARM, message_type("Alarm"), queue_size=None)
        for state, route in self._ports.routes.items():
            self._ports.read(state, route.final, lambda state, number, time_us: self._inbox.put(number, state))

    def run(self) -> None:
        """Serve until shutdown."""
        self._ports.serve(self._drive)

    def _drive(self, request: Any) -> Any:
        from mavfi_msgs.srv import DriveResponse

        response = DriveResponse()
        with np.errstate(all="ignore"):
            for order in request.operations:
                state = self._take(order.number)
                if order.action == NodeAction.ACCEPT:
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
