"""Nodes: any set of kernels behind topics, driven by the world in lock-step; injector; detector."""

from collections.abc import Callable
from typing import Any, NoReturn

import numpy as np

from mavfi.detectors.detector import Detector
from mavfi.extras.ros.lockstep.encoding import (
    HELD,
    Answer,
    NodeAction,
    NodeOrder,
    answer_to_bytes,
    from_bytes,
    operations_from_bytes,
)
from mavfi.extras.ros.lockstep.folder import read_injections, write_injections
from mavfi.extras.ros.lockstep.ports import Inbox, Ports
from mavfi.flight.compose import new_loop, watch
from mavfi.flight.decide import INLINE, RecoveryPolicy
from mavfi.levels.state.injector import StateInjector
from mavfi.mission import Scenario
from mavfi.pipeline.kernel import Kernel, repeat
from mavfi.pipeline.ppc import build_pipeline
from mavfi.states import STATES, State

_LOADING_FLIGHT_US = 3_000_000
"""Simulated time within which every kernel has been executed (us)."""


class KernelNode:
    """Executes the world's operations in order, on values received over the topics."""

    def __init__(self, ports: Ports) -> None:
        self._ports = ports
        self._build()
        self._inbox = Inbox(ports)
        self._states_in_use: dict[int, tuple[State, int]] = {}
        self._due: dict[str, tuple[int, State]] = {}
        self._results: dict[int, State] = {}
        self._restored: dict[int, State] = {}
        self._immediate = ports.plan.immediate_states()
        written = [state for kernel in self._kernels.values() for state in kernel.writes]
        self._outlets = {state: ports.outlet(state, ports.routes[state].first) for state in written}
        self._actions: dict[NodeAction, Callable[[Kernel, NodeOrder], Any]] = {
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

    def run(self) -> NoReturn:
        """Serve until this process is ended."""
        for state, route in self._ports.routes.items():
            if self._reading(state):
                self._inbox.read(state, route.final)
        self._ports.serve(self._drive)

    def _drive(self, call: bytes) -> bytes:
        """Execute the operations of a call in order; the answer is what came of them."""
        answer = Answer()
        with np.errstate(all="ignore"):
            for order in operations_from_bytes(call):
                result = self._actions[order.action](self._kernels[order.kernel], order)
                if order.action in (NodeAction.STEP, NodeAction.STOP, NodeAction.ABANDON):
                    answer.numbers = list(range(order.number, order.number + len(result)))
                    answer.states = [state.spec.name for state in result]
                    self._keep_results(result, answer.numbers, order.publish_us)
                elif order.action == NodeAction.RESUME:
                    answer.states = list(result)
                elif result:
                    answer.due = True
        return answer_to_bytes(answer)

    def _keep_results(self, states: list[State], numbers: list[int], publish_us: int) -> None:
        """Keep results until they are published, or publish them now with the stamp of that instant."""
        for state, number in zip(states, numbers, strict=True):
            if publish_us != HELD and state.spec.name in self._immediate:
                self._outlets[state.spec.name].publish_state(state, number, publish_us)
            else:
                self._results[number] = state

    def _receive(self, kernel: Kernel, order: NodeOrder) -> bool:
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
            state = self._inbox.take(number)
            self._states_in_use[number] = state, len(self._reading(state.spec.name))
        state, left = self._states_in_use.pop(number)
        if left > 1:
            self._states_in_use[number] = state, left - 1
        return state

    def _publish(self, kernel: Kernel, order: NodeOrder) -> None:
        state = self._results.pop(order.number)
        self._outlets[state.spec.name].publish_state(state, order.number, order.time_us)

    # ---- after a restart --------------------------------------------------------------------------------------------
    def _restore(self, kernel: Kernel, order: NodeOrder) -> None:
        """Keep a value of before the restart."""
        self._restored[order.number] = from_bytes(STATES[order.state], bytes.fromhex(order.value))

    def _resume(self, kernel: Kernel, order: NodeOrder) -> tuple[str, ...]:
        latest = {self._restored[number].spec.name: self._restored[number] for number in sorted(self._restored)}
        return kernel.resume(latest, order.time_us)

    def _reset(self, kernel: Kernel, order: NodeOrder) -> None:
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

    def __init__(self, ports: Ports) -> None:
        fault = ports.plan.state_fault
        assert fault is not None
        self._inject = StateInjector(fault)
        self._is_spent = bool(read_injections())  # before a restart of this node
        self._ports = ports
        route = ports.routes[fault.where.state]
        self._outlet = ports.outlet(route.state, route.final)
        ports.read(route.state, route.first, self._arrived)

    def run(self) -> NoReturn:
        """Serve until this process is ended."""
        self._ports.serve()

    def _arrived(self, state: State, number: int, time_us: int) -> None:
        if self._is_spent:
            self._outlet.publish_state(state, number, time_us)
            return
        seen = self._inject(state, time_us)
        assert seen is not None  # a plan has no faults that lose messages
        if self._inject.injections:
            self._is_spent = True
            write_injections(self._inject.injections)
        self._outlet.publish_state(seen, number, time_us)


class DetectorNode:
    """Checks and records the values that the world names."""

    def __init__(self, ports: Ports) -> None:
        assert ports.plan.detector is not None
        self._detector = ports.plan.detector
        self._detector.start()
        self._ports = ports
        self._inbox = Inbox(ports)
        self._checked: tuple[int, State] | None = None
        for state, route in ports.routes.items():
            self._inbox.read(state, route.final)

    def run(self) -> NoReturn:
        """Serve until this process is ended."""
        self._ports.serve(self._drive)

    def _drive(self, call: bytes) -> bytes:
        answer = Answer()
        with np.errstate(all="ignore"):
            for order in operations_from_bytes(call):
                state = self._take(order.number)
                if order.action == NodeAction.ACCEPT:
                    self._detector.accept(state, order.time_us)
                else:
                    answer.alarm = self._detector.check(state, order.time_us)
        return answer_to_bytes(answer)

    def _take(self, number: int) -> State:
        """A value received over a topic; the one checked last is accepted next."""
        if self._checked is None or self._checked[0] != number:
            self._checked = number, self._inbox.take(number)
        return self._checked[1]
