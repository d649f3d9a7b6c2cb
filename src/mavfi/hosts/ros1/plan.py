"""A flight on ROS, as plain data that every node reads from the flight's folder."""

import pickle
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, get_args

from mavfi.detectors.detector import Detector
from mavfi.errors import BadInputError
from mavfi.faults.fault import RegisterFault, StateFault
from mavfi.hosts.loop.recovery import INLINE, Recovery
from mavfi.hosts.ros1.folder import flight_folder
from mavfi.hosts.ros1.graph import DETECTOR, INJECTOR, NODELET, Graph
from mavfi.mission import DeadNode, MissionSpec, Scenario
from mavfi.pipeline.kernel import PipelineConfig
from mavfi.pipeline.ppc import build_pipeline

_PLAN = "plan.pickle"
CloudNode = Literal["mavfi", "depth_image_proc"]


def check_supported(spec: MissionSpec) -> None:
    """Check that nodes of ROS can fly a mission as it is wanted.

    Raises:
        BadInputError: The step of a node that dies is to be repeated, a message to be sent again, or there is to be a
            degraded mode.
    """
    if spec.grain == "message":
        raise BadInputError("grain: 'message': on ROS, nodes keep no copy of what they sent; allowed: stage, kernel")
    if spec.degraded != "none":
        raise BadInputError(f"degraded: {spec.degraded!r}: not on ROS; allowed: none")
    if spec.dead_node == "recompute":
        allowed = ", ".join(policy for policy in get_args(DeadNode) if policy != spec.dead_node)
        raise BadInputError(
            f"dead_node: {spec.dead_node!r}: on ROS, what a process computes dies with it; allowed: {allowed}"
        )


@dataclass(frozen=True, slots=True)
class Plan:
    """A flight on ROS.

    Attributes:
        scenario: The mission; `config` of its kernels.
        fault: What to inject into a state.
        detector: What watches, as it is before the flight.
        recovery: How its alarms are answered.
        free_running: Whether time passes as on the wall, instead of waiting for every node.
        kills: Nodes that are killed, and when (us).
        restart_us: For how long a lost node is away, in simulated time.
        patience_s: How long to wait for a node (s, wall clock).
        cloud_node: Who computes the point cloud: the project's kernel, or Debian's nodelet.
        register_faults: Bits flipped in registers of nodes.
        forked: Whether nodes are forked from a warm process; otherwise roslaunch starts an interpreter for each.
        profile: Whether to note when which state was published; the world then listens to all of them.
        nodes: All nodes of the project except the world.

    Raises:
        BadInputError: The fault lasts: the injector's node changes one publication.
    """

    scenario: Scenario
    config: PipelineConfig
    fault: StateFault | None = None
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
        if self.fault is not None and self.fault.lasting:
            raise BadInputError(f"fault in {self.fault.site}: lasts_s or times: on ROS one publication is changed")
        if hasattr(self.detector, "seal") or hasattr(self.detector, "duplicates"):
            text = "takes part in what is not published; allowed on ROS: detectors of published values"
            raise BadInputError(f"detector {type(self.detector).__name__}: {text}")
        injected = None if self.fault is None else self.fault.where.state
        object.__setattr__(self, "graph", Graph(build_pipeline(self.config), injected, self.gated))
        taps = (INJECTOR,) * (self.fault is not None) + (DETECTOR,) * (self.detector is not None)
        object.__setattr__(self, "nodes", (*self.graph.nodes, *taps))
        if self.free_running:
            self._check_free_running()

    def _check_free_running(self) -> None:
        """Refuse what needs the world to know when nodes compute."""
        wanted = {"dead_node": (self.scenario.dead_node, "fresh")}
        wanted |= {
            key: (getattr(self.recovery, key), getattr(INLINE, key)) for key in ("grain", "same_twice", "answer_s")
        }
        for key, (value, allowed) in wanted.items():
            if value != allowed:
                raise BadInputError(f"{key}: {value!r}: not with --free-running; allowed: {allowed}")

    @property
    def foreign(self) -> tuple[str, ...]:
        """Nodes that nobody here wrote."""
        return () if self.cloud_node == "mavfi" else (NODELET,)

    @property
    def gated(self) -> bool:
        """Whether the detector stands in the way of what it watches."""
        return self.detector is not None and self.recovery.coupling == "inline"

    @property
    def observed(self) -> bool:
        """Whether the detector is a subscriber."""
        return self.detector is not None and self.recovery.coupling == "observer"

    def published_at_once(self) -> frozenset[str]:
        """States whose values a node publishes as soon as it has them, in lock-step, which saves a call for each.

        Their stamps say when they count, and no consumer takes them before.  Where a detector may request a
        recomputation, or an injector counts publications, the order of sending matters.
        """
        if self.detector is not None:
            return frozenset()
        return frozenset(name for name, way in self.graph.ways.items() if not way.taps)

    def save(self, folder: Path) -> None:
        """Write it into the flight's folder, which belongs to the user alone."""
        (folder / _PLAN).write_bytes(pickle.dumps(self))


def load_plan() -> Plan:
    """The plan of the flight that this process belongs to."""
    plan: Plan = pickle.loads((flight_folder() / _PLAN).read_bytes())
    return plan
