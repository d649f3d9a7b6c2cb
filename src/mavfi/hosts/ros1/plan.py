"""Specification of a flight on ROS, as plain data that every node loads from the flight's folder."""

import pickle
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, get_args

from mavfi.detectors.detector import Detector
from mavfi.errors import BadInputError
from mavfi.faults.fault import RegisterFault, StateFault
from mavfi.faults.sensor.fault import SensorFault
from mavfi.hosts.loop.policy import INLINE, Recovery
from mavfi.hosts.ros1.folder import flight_folder
from mavfi.hosts.ros1.graph import DETECTOR, INJECTOR, NODELET, Graph
from mavfi.mission import FROM_MEMORY, DeadNode, MissionSpec, Scenario
from mavfi.pipeline.kernel import PipelineConfig
from mavfi.pipeline.ppc import build_pipeline

_PLAN = "plan.pickle"
CloudNode = Literal["mavfi", "depth_image_proc"]


def check_supported(spec: MissionSpec) -> None:
    """Check that ROS nodes can fly a mission.

    Raises:
        BadInputError: The mission requires retransmission of messages, recomputation of a dead node's step, copies of
            the detector, or a degraded mode.
    """
    if spec.grain == "message":
        raise BadInputError("grain: 'message': on ROS, nodes keep no copy of what they sent; allowed: stage, kernel")
    if spec.protection:
        raise BadInputError(f"protection: {spec.protection!r}: not on ROS; allowed: none")
    if spec.copies != 1:
        raise BadInputError(f"copies: {spec.copies}: on ROS, the detector is one node; allowed: 1")
    if spec.degraded != "none":
        raise BadInputError(f"degraded: {spec.degraded!r}: not on ROS; allowed: none")
    if spec.dead_node in FROM_MEMORY:
        allowed = ", ".join(policy for policy in get_args(DeadNode) if policy not in FROM_MEMORY)
        raise BadInputError(
            f"dead_node: {spec.dead_node!r}: on ROS, what a process computes dies with it; allowed: {allowed}"
        )


@dataclass(frozen=True, slots=True)
class Plan:
    """A flight on ROS.

    Attributes:
        scenario: The mission; `config`: configuration of its kernels.
        fault: Fault in a state, injected by a node, or failure of a sensor or motor, in the world; None = none.
        detector: The detector in its initial state; None = none.
        recovery: The recovery policy for its alarms.
        free_running: Whether simulated time follows the wall clock instead of waiting for every node.
        kills: Scheduled kills: node and instant (us).
        restart_us: Down time of a lost node, in simulated time (us).
        patience_s: Timeout for a node's response (s, wall clock).
        cloud_node: Implementation of the point cloud: the project's kernel, or Debian's nodelet.
        register_faults: Bit flips in registers of nodes.
        forked: Whether nodes are forked from a warm process; otherwise roslaunch starts an interpreter for each.
        profile: Whether to record publication times; the world then subscribes to all states.
        nodes: All nodes of the project except the world.

    Raises:
        BadInputError: The fault is not transient (the injector's node changes one publication) or may lose a message,
            the detector acts on unpublished values, or a policy is not available in free-running mode.
    """

    scenario: Scenario
    config: PipelineConfig
    fault: StateFault | SensorFault | None = None
    detector: Detector | None = None
    recovery: Recovery = INLINE
    free_running: bool = False
    kills: tuple[tuple[str, int], ...] = ()
    restart_us: int = 1_000_000
    patience_s: float = 60.0
    cloud_node: CloudNode = "mavfi"
    register_faults: tuple[RegisterFault, ...] = ()
    profile: bool = False
    forked: bool = True
    graph: Graph = field(init=False)
    nodes: tuple[str, ...] = field(init=False)

    def __post_init__(self) -> None:
        fault = self.state_fault
        if fault is not None and fault.lasting:
            raise BadInputError(f"fault in {fault.site}: lasts_s or times: on ROS one publication is changed")
        if fault is not None and fault.of_length:
            raise BadInputError(f"fault in {fault.site}: is the length of a list; allowed on ROS: a field of the state")
        if self.detector is not None and (self.detector.seals or self.detector.duplicates):
            text = "takes part in what is not published; allowed on ROS: detectors of published values"
            raise BadInputError(f"detector {type(self.detector).__name__}: {text}")
        injected = None if fault is None else fault.where.state
        object.__setattr__(self, "graph", Graph(build_pipeline(self.config), injected, self.gated))
        taps = (INJECTOR,) * (fault is not None) + (DETECTOR,) * (self.detector is not None)
        object.__setattr__(self, "nodes", (*self.graph.nodes, *taps))
        if self.free_running:
            self._check_free_running()

    def _check_free_running(self) -> None:
        """Refuse policies that require the world to know when nodes compute."""
        recovery = self.recovery
        wanted: dict[str, tuple[object, tuple[object, ...]]] = {
            "dead_node": (self.scenario.dead_node, ("fresh",)), "grain": (recovery.grain, ("stage",)),
            "same_twice": (recovery.same_twice, ("accept", "limit")), "answer_s": (recovery.answer_s, (0.0,)),
        }  # fmt: skip
        for key, (value, allowed) in wanted.items():
            if value not in allowed:
                text = f"not with --free-running; allowed: {' or '.join(map(str, allowed))}"
                raise BadInputError(f"{key}: {value!r}: {text}")

    @property
    def state_fault(self) -> StateFault | None:
        """The fault that the injector's node injects."""
        return self.fault if isinstance(self.fault, StateFault) else None

    @property
    def sensor_fault(self) -> SensorFault | None:
        """The failure of a sensor or motor."""
        return self.fault if isinstance(self.fault, SensorFault) else None

    @property
    def foreign(self) -> tuple[str, ...]:
        """Third-party nodes."""
        return () if self.cloud_node == "mavfi" else (NODELET,)

    @property
    def gated(self) -> bool:
        """Whether the detector is a gate between publishers and consumers."""
        return self.detector is not None and self.recovery.coupling == "inline"

    @property
    def in_front(self) -> tuple[str, ...]:
        """Nodes in front of a gate."""
        return tuple(node for node in self.nodes if node != DETECTOR)

    @property
    def observed(self) -> bool:
        """Whether the detector is a subscriber."""
        return self.detector is not None and self.recovery.coupling == "observer"

    def published_at_once(self) -> frozenset[str]:
        """States whose values a node publishes immediately in lock-step, which saves one call each.

        Their stamps carry the publication instant, and no consumer takes them before.  Excluded where the order of
        transmission matters: with a detector, which may request recomputation, or an injector, which counts values.
        """
        if self.detector is not None:
            return frozenset()
        return frozenset(name for name, way in self.graph.ways.items() if not way.taps)

    def save(self, folder: Path) -> None:
        """Save the plan to the flight's folder, which only this user can access."""
        (folder / _PLAN).write_bytes(pickle.dumps(self))


def load_plan() -> Plan:
    """The plan of the flight to which this process belongs."""
    plan: Plan = pickle.loads((flight_folder() / _PLAN).read_bytes())
    return plan
