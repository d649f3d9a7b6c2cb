"""Survey of a ROS graph: nodes with their processes, topics with their types and rates."""

import os
import threading
import time
from collections import Counter
from contextlib import suppress
from dataclasses import asdict, dataclass
from typing import Any

from mavfi.errors import MavfiError
from mavfi.extras.ros.node.master import CALLER, Master, RosGraph, call, is_here
from mavfi.extras.ros.node.peer import TopicSource


@dataclass(frozen=True, slots=True)
class Node:
    """A node; `pid` is None if only its registration is left, `executable` "" if unknown."""

    name: str
    uri: str
    pid: int | None
    executable: str
    publishes: tuple[str, ...]
    reads: tuple[str, ...]

    @property
    def is_alive(self) -> bool:
        """Whether it responds."""
        return self.pid is not None


@dataclass(frozen=True, slots=True)
class Topic:
    """A topic; its type (`kind`) is "*" if unknown, its rate (1/s) None if not measured."""

    name: str
    kind: str
    publishers: tuple[str, ...]
    readers: tuple[str, ...]
    rate: float | None


@dataclass(frozen=True, slots=True)
class Survey:
    """Nodes and topics of a graph, and the address of its master."""

    master: str
    nodes: tuple[Node, ...]
    topics: tuple[Topic, ...]

    def to_json(self) -> dict[str, Any]:
        """The survey as plain data."""
        return asdict(self)


def survey(master: Master, seconds: float = 1.0) -> Survey:
    """Survey the graph, and listen to every topic for a duration (s); 0 = rates are not measured."""
    graph = master.graph()
    nodes = tuple(_node(master, graph, name) for name in graph.nodes)
    rates = {}
    if seconds > 0:
        rates = _rates(graph, {node.name: node.uri for node in nodes if node.is_alive}, seconds)
    topics = tuple(
        Topic(
            name,
            graph.types.get(name, "*"),
            tuple(graph.publishers.get(name, ())),
            tuple(graph.subscribers.get(name, ())),
            rates.get(name),
        )
        for name in graph.topics
    )
    return Survey(master.uri, nodes, topics)


def _node(master: Master, graph: RosGraph, name: str) -> Node:
    uri = ""
    pid = None
    executable = ""
    with suppress(MavfiError):
        uri = master.node_uri(name)
        pid = int(call(uri, "getPid", CALLER))
        if is_here(uri):
            executable = os.readlink(f"/proc/{pid}/exe")
    return Node(
        name,
        uri,
        pid,
        executable,
        tuple(topic for topic, nodes in graph.publishers.items() if name in nodes),
        tuple(topic for topic, nodes in graph.subscribers.items() if name in nodes),
    )


def _rates(graph: RosGraph, uris: dict[str, str], seconds: float) -> dict[str, float]:
    """Messages per second of each topic with a live publisher, excluding earlier latched messages."""
    sources: list[TopicSource] = []
    for topic, nodes in graph.publishers.items():
        for node in nodes:
            with suppress(MavfiError):
                if node in uris:
                    sources.append(TopicSource(node, uris[node], topic))
    counts: Counter[str] = Counter({source.topic: 0 for source in sources})
    latched = Counter(source.topic for source in sources if source.is_latched)

    def listen(source: TopicSource) -> None:
        for _ in source.messages():
            counts[source.topic] += 1

    began = time.monotonic()
    for source in sources:
        threading.Thread(target=listen, args=(source,), daemon=True).start()
    time.sleep(seconds)
    spent = time.monotonic() - began
    rates = {topic: max(0, count - latched[topic]) / spent for topic, count in counts.items()}
    for source in sources:
        source.close()
    return rates
