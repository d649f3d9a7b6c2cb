"""The ROS graph of a flight: nodes with their kernels, topics with their publishers and subscribers.

Derived from the kernels' own `reads` and `writes`.  A value passes from its kernel to its consumers over one topic,
`/mavfi/<stage>/<state>`; with an injector or a gating detector in between, the kernel publishes on `.../raw`, the
injector on `.../injected`, and the last node of this chain on the topic itself.  While a gate is down, the node in
front of it publishes on the topic itself.
"""

from collections.abc import Mapping
from dataclasses import dataclass

from mavfi.pipeline.kernel import Kernel
from mavfi.states import KERNELS, ODOMETRY, PERIODIC, STATES, Stage

WORLD, INJECTOR, DETECTOR = "world", "injector", "detector"
NODELET = "point_cloud_xyz"
"""Debian's C++ nodelet for the point cloud, if selected; the node `point_cloud` then sends it the images."""
IMAGE, INFO, POINTS = (f"/{NODELET}/{name}" for name in ("image_rect", "camera_info", "points"))
"""Topics of the nodelet."""
PREFIX = "/mavfi"
VERDICT, ALARM = f"{PREFIX}/verdict", f"{PREFIX}/alarm"
RECOMPUTE, INJECTION = f"{PREFIX}/recompute", f"{PREFIX}/injection"
BYPASS = f"{PREFIX}/bypass"
JUDGED_BY_WORLD = (
    "control.command", "planning.waypoint", "planning.path", "planning.trajectory", "perception.collision_status",
    ODOMETRY["estimator"],
)  # fmt: skip
"""States that the world subscribes to: it executes commands, adds the estimated pose to images, and records events."""


@dataclass(frozen=True, slots=True)
class Way:
    """Route of a state's values from the publishing node to the nodes whose kernels read them."""

    state: str
    writer: str
    readers: tuple[str, ...]
    injected: bool = False
    gated: bool = False

    @property
    def final(self) -> str:
        """Topic to which consumers subscribe."""
        return f"{PREFIX}/{self.state.replace('.', '/')}"

    @property
    def first(self) -> str:
        """Topic to which the writer publishes."""
        return f"{self.final}/raw" if self.injected or self.gated else self.final

    @property
    def after_injector(self) -> str:
        """Topic to which the injector publishes."""
        return f"{self.final}/injected" if self.gated else self.final

    @property
    def before_gate(self) -> str:
        """Topic to which a gating detector subscribes."""
        return self.after_injector if self.injected else self.first

    @property
    def rejected(self) -> str:
        """Topic to which a gating detector publishes withheld values."""
        return f"{self.final}/rejected"

    @property
    def senders(self) -> tuple[str, ...]:
        """Nodes that publish to consumers: the last one of the chain, and the one in front of a gate."""
        return (self.writer, *self.taps)[-1 - self.gated :]

    @property
    def taps(self) -> tuple[str, ...]:
        """Nodes between writer and consumers, in order."""
        return (INJECTOR,) * self.injected + (DETECTOR,) * self.gated


@dataclass(frozen=True, slots=True)
class Face:
    """Interface of a kernel to other nodes: attributes as of `Kernel`, and the inputs that can make a step due."""

    name: str
    stage: Stage
    reads: tuple[str, ...]
    writes: tuple[str, ...]
    triggers: tuple[str, ...]


def face_of(kernel: Kernel) -> Face:
    """The face of a kernel; kernels stepped at the control period have no triggers."""
    quiet = kernel.reads if kernel.name in PERIODIC else getattr(kernel, "quiet", ())
    triggers = tuple(state for state in kernel.reads if state not in quiet)
    return Face(kernel.name, kernel.stage, kernel.reads, kernel.writes, triggers)


class Graph:
    """Nodes and topics of a flight; `injected`: state with an injector or None, `gate`: the detector is a gate."""

    def __init__(self, kernels: Mapping[str, Kernel], injected: str | None = None, gate: bool = False) -> None:
        self.faces = {name: face_of(kernel) for name, kernel in kernels.items()}
        self.nodes: dict[str, tuple[str, ...]] = {}
        for name in kernels:
            node = KERNELS[name].node
            self.nodes[node] = (*self.nodes.get(node, ()), name)
        self.ways = {
            name: Way(name, self.node_of(spec.writer), self._readers(name), name == injected, gate)
            for name, spec in STATES.items()
            if spec.writer in self.faces or self._readers(name)
        }

    def node_of(self, kernel: str) -> str:
        """Node that runs a kernel; sensors belong to the world."""
        return next((node for node, kernels in self.nodes.items() if kernel in kernels), WORLD)

    def _readers(self, state: str) -> tuple[str, ...]:
        readers = (self.node_of(face.name) for face in self.faces.values() if state in face.reads)
        return tuple(dict.fromkeys(readers))
