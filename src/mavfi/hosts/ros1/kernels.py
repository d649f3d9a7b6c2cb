"""The generic kernel node: any set of kernels behind ROS topics, in lock-step or free-running."""

import queue
import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from mavfi.detectors.detector import Detector
from mavfi.hosts.loop.assemble import new_loop, watch
from mavfi.hosts.loop.decide import SCANNING
from mavfi.hosts.loop.policy import INLINE, Recovery
from mavfi.hosts.loop.scheduler import CONTROL_PERIOD_US
from mavfi.hosts.ros1.convert import MAP
from mavfi.hosts.ros1.generate import message_type
from mavfi.hosts.ros1.graph import RECOMPUTE
from mavfi.hosts.ros1.mirrors import ros_type
from mavfi.hosts.ros1.nodelet_cloud import NodeletCloud
from mavfi.hosts.ros1.plan import Plan
from mavfi.hosts.ros1.ports import Inbox, Ports, fatal
from mavfi.mission import Scenario
from mavfi.pipeline.kernel import Kernel, PipelineConfig, repeat
from mavfi.pipeline.planning import MotionPlanner
from mavfi.pipeline.ppc import build_pipeline
from mavfi.platforms.compute import latency
from mavfi.states import PERIODIC, State

_LOADING_FLIGHT_US = 3_000_000
"""Simulated time within which every kernel has been executed (us)."""


class KernelNode:
    """Constructs the kernels of a node, and advertises their outputs."""

    def __init__(self, name: str, plan: Plan) -> None:
        self.ports = Ports(name, plan)
        self.kernels: dict[str, Kernel] = {}
        self.renew()
        self.lock = threading.Lock()
        written = [state for kernel in self.kernels.values() for state in kernel.writes]
        self._outlets = {
            state: self.ports.outlet(way, way.first) for state in written if (way := self.ports.ways[state])
        }
        if "planner" in self.kernels:
            offer_planning(lambda: self.kernels["planner"], plan.config, self.lock)

    def renew(self) -> None:
        """Construct the kernels; a stateless nodelet proxy is kept."""
        plan, cloud = self.ports.plan, self.kernels.get("point_cloud")
        built = build_pipeline(plan.config)
        if plan.foreign and "point_cloud" in plan.graph.nodes[self.ports.node]:
            built["point_cloud"] = cloud or NodeletCloud(plan, self.ports)
        self.kernels = {kernel: built[kernel] for kernel in plan.graph.nodes[self.ports.node]}

    def reading(self, state: str) -> list[Kernel]:
        """Kernels of this node that read a state."""
        return [kernel for kernel in self.kernels.values() if state in kernel.reads]

    def listen(self, arrived: Callable[[State, int, int], None]) -> None:
        """Subscribe to all inputs of the kernels."""
        for state, way in self.ports.ways.items():
            if self.reading(state):
                self.ports.read(state, way.final, arrived)


class LockStepNode(KernelNode):
    """Executes the world's operations in order, on values received over the topics."""

    def __init__(self, name: str, plan: Plan) -> None:
        super().__init__(name, plan)
        self._inbox = Inbox()
        self._taken: dict[int, tuple[State, int]] = {}
        self._due: dict[str, tuple[int, State]] = {}
        self._results: dict[int, State] = {}
        self._recalled: dict[int, State | None] = {}
        self._at_once = plan.published_at_once()
        operation = message_type("Operation")
        self._actions: dict[int, Callable[[Kernel, Any], Any]] = {
            operation.STEP: lambda kernel, order: kernel.step(order.time_us),
            operation.MARK: lambda kernel, order: kernel.mark(),
            operation.ROLLBACK: lambda kernel, order: kernel.rollback(),
            operation.STOP: lambda kernel, order: kernel.stop(),  # type: ignore[attr-defined]
            operation.ABANDON: lambda kernel, order: kernel.abandon(order.time_us),  # type: ignore[attr-defined]
            operation.AGAIN: lambda kernel, order: repeat(kernel),
            operation.RECEIVE: self._receive,
            operation.PUBLISH: self._publish,
            operation.RECALL: self._recall,
            operation.RESUME: self._resume,
            operation.RESET: self._reset,
            operation.BYPASS: lambda kernel, order: self.ports.bypass(order.number > 0),
        }
        self._resuming = operation.RESUME
        self._giving = (operation.STEP, operation.STOP, operation.ABANDON)

    def run(self) -> None:
        """Serve until shutdown."""
        import rospy
        from mavfi_msgs.srv import Drive

        self.listen(lambda state, number, time_us: self._inbox.put(number, state))
        rospy.Service(f"/{self.ports.node}/drive", Drive, fatal(self._drive), buff_size=1 << 16)
        self.ports.offer_ready()
        rospy.spin()

    def _drive(self, request: Any) -> Any:
        from mavfi_msgs.srv import DriveResponse

        response = DriveResponse()
        with self.lock, np.errstate(all="ignore"):
            for order in request.operations:
                answer = self._actions[order.action](self.kernels[order.kernel], order)
                if order.action in self._giving:
                    response.numbers = list(range(order.number, order.number + len(answer)))
                    response.states = [state.spec.name for state in answer]
                    self._keep(answer, response.numbers, order.publish_us)
                elif order.action == self._resuming:
                    response.states = list(answer)
                elif answer:
                    response.due = True
        return response

    def _keep(self, states: list[State], numbers: list[int], publish_us: int) -> None:
        for state, number in zip(states, numbers, strict=True):
            if publish_us >= 0 and state.spec.name in self._at_once:
                self._outlets[state.spec.name].publish(state, number, publish_us)
            else:
                self._results[number] = state

    def _receive(self, kernel: Kernel, order: Any) -> bool:
        number = order.number
        if self._recalled.get(number, self) is None:
            return False  # no peer holds it
        waiting, state = self._due.get(kernel.name, (-1, None))
        if waiting != number or state is None:
            state = self._take(number)
        due = kernel.receive(state, order.time_us)
        if due:
            self._due[kernel.name] = number, state
        return due

    def _take(self, number: int) -> State:
        """A value received over a topic, for one of the kernels that read it."""
        recalled = self._recalled.get(number)
        if recalled is not None:
            return recalled
        if number not in self._taken:
            state: State = self._inbox.take(number, self.ports.plan.patience_s)
            self.ports.kept.put(state, number)
            self._taken[number] = state, len(self.reading(state.spec.name))
        state, left = self._taken.pop(number)
        if left > 1:
            self._taken[number] = state, left - 1
        return state

    # ---- after a restart --------------------------------------------------------------------------------------------
    def _recall(self, kernel: Kernel, order: Any) -> None:
        """Request a value from the peers."""
        state = self.ports.recall(order.state, order.number)
        self._recalled[order.number] = state
        if state is not None:
            self.ports.kept.put_late(state, order.number)

    def _resume(self, kernel: Kernel, order: Any) -> tuple[str, ...]:
        known = sorted((number, state) for number, state in self._recalled.items() if state is not None)
        return kernel.resume({state.spec.name: state for _, state in known}, order.time_us)

    def _reset(self, kernel: Kernel, order: Any) -> None:
        """Initialize the memory; results already computed remain scheduled for publication."""
        self.renew()
        self._due.clear()
        self._recalled.clear()

    def _publish(self, kernel: Kernel, order: Any) -> None:
        state = self._results.pop(order.number)
        self._outlets[state.spec.name].publish(state, order.number, order.time_us)


class FreeNode(KernelNode):
    """Computes as values arrive, and publishes after the latency of the modelled platform."""

    def __init__(self, name: str, plan: Plan) -> None:
        super().__init__(name, plan)
        self._latency_us = {kernel: latency(plan.scenario.platform, kernel) for kernel in self.kernels}
        self._queue: queue.SimpleQueue[tuple[State | None, int, Any]] = queue.SimpleQueue()
        self._triggers = {kernel: plan.graph.faces[kernel].triggers for kernel in self.kernels}
        self._marks = plan.detector is not None
        self._number = 0

    def run(self) -> None:
        """Run until shutdown."""
        if not self.ports.plan.forked:
            fly_begin(self.ports.plan.scenario)
        self.listen(lambda state, number, time_us: self._queue.put((state, time_us, None)))
        if self._marks:
            self.ports.listen(RECOMPUTE, "Recompute", lambda request: self._queue.put((None, 0, request)))
        self.ports.offer_ready()
        now = 0
        with np.errstate(all="ignore"):
            while True:
                state, time_us, request = self._queue.get()
                now = max(now, time_us)
                if state is None:
                    self._recompute(request, now)
                else:
                    self._take(state, now)

    def _take(self, state: State, now: int) -> None:
        for kernel in self.reading(state.spec.name):
            if self._marks and kernel.name in SCANNING and state.spec.name in self._triggers[kernel.name]:
                kernel.mark()  # a recomputation starts from the memory before the new scan
            due = kernel.receive(state, now)
            if due if kernel.name not in PERIODIC else self._begins_period(state, now):
                self._step(kernel, now)

    def _begins_period(self, state: State, now: int) -> bool:
        """Whether a value starts a control period: odometry stamped at a multiple of the period."""
        return state.spec.name == self.ports.plan.config.odometry and now % CONTROL_PERIOD_US == 0

    def _step(self, kernel: Kernel, now: int) -> None:
        if self._marks and kernel.name not in SCANNING:
            kernel.mark()
        self._publish(kernel, lambda: kernel.step(now), now)

    def _publish(self, kernel: Kernel, compute: Callable[[], list[State]], now: int) -> None:
        began = time.monotonic()
        with self.lock:
            states = compute()
        latency_us = self._latency_us[kernel.name]
        time.sleep(max(0.0, 1e-6 * latency_us - (time.monotonic() - began)))
        for state in states:
            self._number += 1
            self._outlets[state.spec.name].publish(state, self._number, now + latency_us)

    def _recompute(self, request: Any, now: int) -> None:
        """Execute a detector's request, as far as it concerns this node's kernels."""
        for name in request.restores:
            if name in self.kernels:
                self.kernels[name].rollback()
        kernel: Any = self.kernels.get(request.kernel)
        if kernel is None:
            return
        if request.kind == "recompute":
            self._step(kernel, now)
        else:
            self._publish(kernel, kernel.stop if request.kind == "stop" else lambda: kernel.abandon(now), now)


def fly_begin(scenario: Scenario, detector: Detector | None = None, recovery: Recovery = INLINE) -> None:
    """Fly the first seconds in this process, so that all functions are compiled and loaded."""
    loop = new_loop(scenario)
    watch(loop, detector, recovery)
    loop.judge.limit_us = _LOADING_FLIGHT_US
    loop.fly()


def find_path(planner: MotionPlanner, start: np.ndarray, goal: np.ndarray) -> np.ndarray:
    """A path on the current map (m), shape (n, 3), empty = none.

    It is planned with the planner's radius or, if that fails, the checker's.  The planner's random state is restored,
    so that the flight is unaffected.
    """
    routes = planner.routes
    before = routes.search.random.copy()
    found = None
    if np.isfinite(start).all() and np.isfinite(goal).all():
        for counter in (routes.clearance_map.wide, routes.clearance_map.narrow):
            found = found if found is not None else routes.between(start, counter, goal)
    routes.search.random[:] = before
    if found is None:
        return np.zeros((0, 3))
    return found if np.array_equal(found[0], start) else np.vstack([start, found])


def offer_planning(present: Callable[[], Kernel], config: PipelineConfig, lock: threading.Lock) -> None:
    """Offer the service `/plan` of type `nav_msgs/GetPlan` on the current planner and its map.

    A goal of (0, 0, 0) is replaced by the mission's goal; `lock` is held while the planner computes.
    """
    import rospy
    from nav_msgs.srv import GetPlan, GetPlanResponse

    def answer(request: Any) -> Any:
        start, goal = (_position(pose) for pose in (request.start, request.goal))
        planner = present()
        assert isinstance(planner, MotionPlanner)
        with lock, np.errstate(all="ignore"):
            path = find_path(planner, start, goal if goal.any() else config.goal)
        response = GetPlanResponse()
        response.plan.header.frame_id = MAP
        for vertex in path:
            pose = ros_type("geometry_msgs/PoseStamped")(header=response.plan.header)
            pose.pose.position.x, pose.pose.position.y, pose.pose.position.z = map(float, vertex)
            pose.pose.orientation.w = 1.0
            response.plan.poses.append(pose)
        return response

    rospy.Service("/plan", GetPlan, answer)


def _position(pose: Any) -> np.ndarray:
    position = pose.pose.position
    return np.array([position.x, position.y, position.z])
