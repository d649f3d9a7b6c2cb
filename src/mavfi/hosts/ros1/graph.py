"""The ROS graph of a flight: which node runs which kernels, and who publishes and reads which topics.

Derived from the kernels' own `reads` and `writes`.  A value goes from its kernel to its consumers over one topic,
`/mavfi/<stage>/<state>`; with an injector or a detector as a gate in between, the kernel publishes on `.../raw`, the
injector on `.../injected`, and the last one on the topic itself.
"""

from collections.abc import Mapping
from dataclasses import dataclass

from mavfi.pipeline.kernel import Kernel
from mavfi.states import KERNELS, ODOMETRY, PERIODIC, STATES, Stage

WORLD, INJECTOR, DETECTOR = "world", "injector", "detector"
NODELET = "point_cloud_xyz"
"""Debian's C++ node that computes the point cloud, where it is to; the node `point_cloud` then hands images to it."""
IMAGE, INFO, POINTS = (f"/{NODELET}/{name}" for name in ("image_rect", "camera_info", "points"))
"""Topics of the nodelet."""
PREFIX = "/mavfi"
VERDICT, ALARM = f"{PREFIX}/verdict", f"{PREFIX}/alarm"
RECOMPUTE, INJECTION = f"{PREFIX}/recompute", f"{PREFIX}/injection"
JUDGED_BY_WORLD = (
    "control.command", "planning.waypoint", "planning.path", "planning.trajectory", "perception.collision_status",
    ODOMETRY["estimator"],
)  # fmt: skip
"""What the world looks into beside what it publishes: it obeys commands, stamps images with the estimated pose, and
writes down what happened."""


@dataclass(frozen=True, slots=True)
class Way:
    """How the values of a state get from the node that publishes them first to those with kernels that read them."""

    state: str
    writer: str
    readers: tuple[str, ...]
    injected: bool = False
    gated: bool = False

    @property
    def final(self) -> str:
        """Topic that consumers read."""
        return f"{PREFIX}/{self.state.replace('.', '/')}"

    @property
    def first(self) -> str:
        """Topic on which the writer publishes."""
        return f"{self.final}/raw" if self.injected or self.gated else self.final

    @property
    def after_injector(self) -> str:
        """Topic on which the injector publishes."""
        return f"{self.final}/injected" if self.gated else self.final

    @property
    def before_gate(self) -> str:
        """Topic that a gate reads."""
        return self.after_injector if self.injected else self.first

    @property
    def rejected(self) -> str:
        """Topic on which a gate publishes what it holds back."""
        return f"{self.final}/rejected"

    @property
    def taps(self) -> tuple[str, ...]:
        """Nodes in the way."""
        return (INJECTOR,) * self.injected + (DETECTOR,) * self.gated


@dataclass(frozen=True, slots=True)
class Face:
    """What other nodes know of a kernel; attributes as of `Kernel`, and the inputs that may make a step due."""

    name: str
    stage: Stage
    reads: tuple[str, ...]
    writes: tuple[str, ...]
    triggers: tuple[str, ...]


def face_of(kernel: Kernel) -> Face:
    """The face of a kernel; those that are stepped at the control period have no triggers."""
    quiet = kernel.reads if kernel.name in PERIODIC else getattr(kernel, "quiet", ())
    triggers = tuple(state for state in kernel.reads if state not in quiet)
    return Face(kernel.name, kernel.stage, kernel.reads, kernel.writes, triggers)


class Graph:
    """Nodes and topics of a flight; `injected`: state of the injector (None = none), `gate`: the detector is a gate."""

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
        """Node that runs a kernel; sensors are the world's."""
        return next((node for node, kernels in self.nodes.items() if kernel in kernels), WORLD)

    def _readers(self, state: str) -> tuple[str, ...]:
        readers = (self.node_of(face.name) for face in self.faces.values() if state in face.reads)
        return tuple(dict.fromkeys(readers))
