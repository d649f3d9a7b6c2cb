"""The ROS graph of a flight: nodes with their kernels, topics with their publishers and subscribers.

Derived from the kernels' own `reads` and `writes`.  A value passes from its kernel to its consumers over one topic,
`/mavfi/<stage>/<state>`.  With an injector in between, the kernel publishes on `.../raw`, and the injector on the topic
itself.  A detector reads all topics; the world delays the consumers until it has its answer.
"""

from collections.abc import Mapping
from dataclasses import dataclass

from mavfi.pipeline.kernel import Kernel
from mavfi.states import KERNELS, PERIODIC, STATES, Stage

WORLD, INJECTOR, DETECTOR = "world", "injector", "detector"
PREFIX = "/mavfi"
ALARM = f"{PREFIX}/alarm"


@dataclass(frozen=True, slots=True)
class Way:
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
        return f"{self.final}/raw" if self.injected else self.final

    @property
    def sender(self) -> str:
        """Node that publishes to the consumers."""
        return INJECTOR if self.injected else self.writer

    @property
    def nodes(self) -> tuple[str, ...]:
        """Nodes that a value passes before its consumers receive it, in order."""
        return (self.writer, INJECTOR) if self.injected else (self.writer,)


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
    """Nodes and topics of a flight; `injected`: state with an injector, None = none."""

    def __init__(self, kernels: Mapping[str, Kernel], injected: str | None = None) -> None:
        self.faces = {name: face_of(kernel) for name, kernel in kernels.items()}
        self.nodes: dict[str, tuple[str, ...]] = {}
        for name in kernels:
            node = KERNELS[name].node
            self.nodes[node] = (*self.nodes.get(node, ()), name)
        self.ways = {
            name: Way(name, self.node_of(spec.writer), self._readers(name), name == injected)
            for name, spec in STATES.items()
            if spec.writer in self.faces or self._readers(name)
        }

    def node_of(self, kernel: str) -> str:
        """Node that runs a kernel; sensors belong to the world."""
        return next((node for node, kernels in self.nodes.items() if kernel in kernels), WORLD)

    def _readers(self, state: str) -> tuple[str, ...]:
        readers = (self.node_of(face.name) for face in self.faces.values() if state in face.reads)
        return tuple(dict.fromkeys(readers))
