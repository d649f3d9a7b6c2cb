"""Survey of a ROS 1 graph."""

import os
import threading
import time
from collections import Counter
from contextlib import suppress

from mavfi.errors import MavfiError
from mavfi.extras.ros.node.master import CALLER, Master, RosGraph, call, is_here
from mavfi.extras.ros.node.peer import TopicSource
from mavfi.extras.ros.survey import Survey, SurveyedNode, SurveyedService, SurveyedTopic

_DEAD = "registered only; `rosnode cleanup` removes it"


def survey_ros1(master: Master, seconds: float) -> Survey:
    """Survey the graph, and listen to every topic for a duration (s); 0 = rates are not measured."""
    graph = master.graph()
    nodes = []
    uris = {}
    for name in graph.nodes:
        uri = ""
        with suppress(MavfiError):
            uri = master.node_uri(name)
        node = _node(graph, name, uri)
        nodes.append(node)
        if node.problem != _DEAD:
            uris[name] = uri
    rates = {}
    if seconds > 0:
        rates = _rates(graph, uris, seconds)
    topics = tuple(
        SurveyedTopic(
            name,
            graph.types.get(name, "*"),
            "",
            tuple(graph.publishers.get(name, ())),
            tuple(graph.subscribers.get(name, ())),
            rates.get(name),
        )
        for name in graph.topics
    )
    services = tuple(SurveyedService(name, "", tuple(servers)) for name, servers in sorted(graph.services.items()))
    return Survey(1, master.uri, tuple(nodes), topics, services, ())


def _node(graph: RosGraph, name: str, uri: str) -> SurveyedNode:
    """A node with its process, if it responds at its address."""
    pid = None
    problem = ""
    executable = ""
    try:
        pid = int(call(uri, "getPid", CALLER))
    except MavfiError:
        problem = _DEAD
    else:
        with suppress(OSError):
            if is_here(uri):
                executable = os.readlink(f"/proc/{pid}/exe")
    return SurveyedNode(
        name,
        pid,
        problem,
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
