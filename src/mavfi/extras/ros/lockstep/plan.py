"""Specification of a flight on ROS, as plain data that every node loads from the flight's folder."""

import pickle
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import cast

from mavfi.detectors.detector import Detector
from mavfi.errors import BadInputError
from mavfi.extras.registers.fault import RegisterFault
from mavfi.extras.ros.lockstep.folder import flight_folder
from mavfi.extras.ros.lockstep.transport import Middleware
from mavfi.flight.decide import INLINE, RecoveryPolicy
from mavfi.levels.sensor.fault import SensorFault
from mavfi.levels.state.fault import StateFault
from mavfi.mission import MissionSpec, Scenario
from mavfi.pipeline.kernel import Kernel, PipelineConfig
from mavfi.pipeline.ppc import build_pipeline
from mavfi.states import KERNELS, PERIODIC, STATES, Stage

# ---- the graph: nodes with their kernels, topics with their publishers and subscribers -------------------------------
WORLD = "world"
INJECTOR = "injector"
DETECTOR = "detector"
PREFIX = "/mavfi"


def calls_topic(node: str) -> str:
    """Topic of the world's calls to a node."""
    return f"{PREFIX}/{node}/calls"


def answers_topic(node: str) -> str:
    """Topic of a node's answers to the world."""
    return f"{PREFIX}/{node}/answers"


@dataclass(frozen=True, slots=True)
class Route:
    """Route of a state's values from the publishing node to the nodes whose kernels read them."""

    state: str
    writer: str
    readers: tuple[str, ...]
    injected: bool = False

    @property
    def final(self) -> str:
        """Topic to which consumers subscribe."""
        return f"{PREFIX}/{self.state.replace('.', '/')}"

    @property
    def first(self) -> str:
        """Topic to which the writer publishes."""
        if self.injected:
            return f"{self.final}/raw"
        return self.final

    @property
    def sender(self) -> str:
        """Node that publishes to the consumers."""
        if self.injected:
            return INJECTOR
        return self.writer

    @property
    def nodes(self) -> tuple[str, ...]:
        """Nodes that a value passes before its consumers receive it, in order."""
        if self.injected:
            return (self.writer, INJECTOR)
        return (self.writer,)


@dataclass(frozen=True, slots=True)
class KernelInterface:
    """Interface of a kernel to other nodes: attributes as of `Kernel`, and the inputs that can make a step due."""

    name: str
    stage: Stage
    reads: tuple[str, ...]
    writes: tuple[str, ...]
    triggers: tuple[str, ...]


def interface_of(kernel: Kernel) -> KernelInterface:
    """The interface of a kernel; kernels stepped at the control period have no triggers."""
    if kernel.name in PERIODIC:
        quiet = kernel.reads
    else:
        quiet = getattr(kernel, "quiet", ())
    triggers = tuple(state for state in kernel.reads if state not in quiet)
    return KernelInterface(kernel.name, kernel.stage, kernel.reads, kernel.writes, triggers)


class FlightGraph:
    """Nodes and topics of a flight; `injected`: state with an injector, None = none."""

    def __init__(self, kernels: Mapping[str, Kernel], injected: str | None = None) -> None:
        self.interfaces = {name: interface_of(kernel) for name, kernel in kernels.items()}
        self.nodes: dict[str, tuple[str, ...]] = {}
        for name in kernels:
            node = KERNELS[name].node
            self.nodes[node] = (*self.nodes.get(node, ()), name)
        self.routes = {
            name: Route(name, self.node_of(spec.writer), self._readers(name), name == injected)
            for name, spec in STATES.items()
            if spec.writer in self.interfaces or self._readers(name)
        }

    def node_of(self, kernel: str) -> str:
        """Node that runs a kernel; sensors belong to the world."""
        return next((node for node, kernels in self.nodes.items() if kernel in kernels), WORLD)

    def _readers(self, state: str) -> tuple[str, ...]:
        readers = (self.node_of(interface.name) for interface in self.interfaces.values() if state in interface.reads)
        return tuple(dict.fromkeys(readers))


# ---- the plan --------------------------------------------------------------------------------------------------------
_PLAN = "plan.pickle"


def check_supported(spec: MissionSpec) -> None:
    """Check that ROS nodes can fly a mission.

    Raises:
        BadInputError: The mission requires retransmission of messages, protected kernels, a degraded mode, or a
            detector at the producer.
    """
    if spec.grain == "message":
        raise BadInputError("grain: 'message': on ROS, nodes keep no copy of what they sent; allowed: stage, kernel")
    if spec.protection:
        raise BadInputError(f"protection: {spec.protection!r}: not on ROS; allowed: none")
    if spec.degraded != "none":
        raise BadInputError(f"degraded: {spec.degraded!r}: not on ROS; allowed: none")
    if spec.detector_place != "consumer":
        raise BadInputError(f"detector_place: {spec.detector_place!r}: not on ROS; allowed: consumer")


@dataclass(frozen=True, slots=True)
class FlightPlan:
    """A flight on ROS.

    Attributes:
        middleware: ROS 2 as the flight uses it.
        scenario: The mission; `config`: configuration of its kernels.
        fault: Fault in a state, injected by a node, or failure of a sensor or motor, in the world; None = none.
        detector: The detector in its initial state; None = none.
        recovery: The recovery policy for its alarms.
        kills: Scheduled kills: node and instant (us).
        restart_us: Down time of a lost node, in simulated time (us).
        patience_s: Timeout for a node's response (s, wall clock).
        register_faults: Bit flips in registers of nodes.
        profile: Whether to record publication times.
        pace: Flight time per wall time; 0 = as fast as possible.
        nodes: All nodes except the world.

    Raises:
        BadInputError: The fault is not transient (the injector's node changes one publication) or may lose a message,
            or the detector acts on unpublished values.
    """

    middleware: Middleware
    scenario: Scenario
    config: PipelineConfig
    fault: StateFault | SensorFault | None = None
    detector: Detector | None = None
    recovery: RecoveryPolicy = INLINE
    kills: tuple[tuple[str, int], ...] = ()
    restart_us: int = 1_000_000
    patience_s: float = 60.0
    register_faults: tuple[RegisterFault, ...] = ()
    profile: bool = False
    pace: float = 0.0
    graph: FlightGraph = field(init=False)
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
        injected_state = None
        if fault is not None:
            injected_state = fault.where.state
        graph = FlightGraph(build_pipeline(self.config), injected_state)
        nodes = list(graph.nodes)
        if fault is not None:
            nodes.append(INJECTOR)
        if self.detector is not None:
            nodes.append(DETECTOR)
        object.__setattr__(self, "graph", graph)
        object.__setattr__(self, "nodes", tuple(nodes))

    @property
    def state_fault(self) -> StateFault | None:
        """The fault that the injector's node injects."""
        if self.fault is None or not self.fault.changed_state:
            return None
        return cast(StateFault, self.fault)

    def immediate_states(self) -> frozenset[str]:
        """States whose values a node publishes immediately, which saves one call each.

        Their stamps carry the publication instant, and no consumer takes them before.  Excluded where the order of
        transmission matters: with a detector, which may request recomputation, or an injector, which counts values.
        """
        if self.detector is not None:
            return frozenset()
        return frozenset(name for name, route in self.graph.routes.items() if not route.injected)

    def world_listens(self, state: str) -> bool:
        """Whether the world subscribes to the values of a state: to all but its own."""
        return self.graph.routes[state].sender != WORLD

    def readers(self, state: str, topic: str) -> list[str]:
        """Nodes of the flight that subscribe to one of the topics on the route of a state."""
        route = self.graph.routes[state]
        if topic != route.final:
            return [INJECTOR]
        nodes = list(route.readers)
        if self.world_listens(state):
            nodes.append(WORLD)
        if self.detector is not None:
            nodes.append(DETECTOR)
        return nodes

    def save(self, folder: Path) -> None:
        """Save the plan to the flight's folder, which only this user can access."""
        (folder / _PLAN).write_bytes(pickle.dumps(self))


def load_plan() -> FlightPlan:
    """The plan of the flight to which this process belongs."""
    plan: FlightPlan = pickle.loads((flight_folder() / _PLAN).read_bytes())
    return plan
