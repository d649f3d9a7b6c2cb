"""Survey of a running graph: nodes with processes, topics with types and rates, services."""

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from typing import Any

from mavfi.errors import BadInputError
from mavfi.extras.ros.ros2.graph import AgentClient, Endpoint, GraphSnapshot, MeasuredRates, TopicInfo
from mavfi.extras.ros.ros2.processes import GraphProcesses, program_of

_WORDS = {"reliable": "reliable", "best_effort": "best effort"}


@dataclass(frozen=True, slots=True)
class SurveyedNode:
    """A node.

    Attributes:
        name: Its full name.
        pid: Its process id; None if unknown.
        problem: Why it is unknown, in one line; "" otherwise.
        executable: Its program; "" if unknown.
        publishes: Its published topics.
        reads: Its subscribed topics.
    """

    name: str
    pid: int | None
    problem: str
    executable: str
    publishes: tuple[str, ...]
    reads: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class SurveyedTopic:
    """A topic.

    Attributes:
        name: Its full name.
        kind: Its message type; "*" if unknown.
        qos: Quality of service of its publishers, e.g. "reliable, latched"; "" without a publisher.
        publishers: Nodes that publish it.
        readers: Nodes that subscribe to it.
        rate: Messages per second; None if not measured.
        problem: Why the rate could not be measured, in one line; "" otherwise.
    """

    name: str
    kind: str
    qos: str
    publishers: tuple[str, ...]
    readers: tuple[str, ...]
    rate: float | None
    problem: str = ""


@dataclass(frozen=True, slots=True)
class SurveyedService:
    """A service or an action; its type (`kind`) is "" if unknown, `servers` are nodes."""

    name: str
    kind: str
    servers: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Survey:
    """A running graph; `address`: its domain and middleware."""

    address: str
    nodes: tuple[SurveyedNode, ...]
    topics: tuple[SurveyedTopic, ...]
    services: tuple[SurveyedService, ...]
    actions: tuple[SurveyedService, ...]

    def to_json(self) -> dict[str, Any]:
        """The survey as plain data."""
        return {"ros": 2, **asdict(self)}


def survey_graph(seconds: float) -> Survey:
    """Survey the graph.

    Args:
        seconds: How long to listen to every topic for its rate (s); 0 = rates are not measured.

    Raises:
        BadInputError: ROS 2 is not installed, or the graph has no node.
        MavfiError: ROS 2 does not start.
    """
    with AgentClient() as agent:
        survey = _survey(agent, seconds)
    if not survey.nodes and not survey.topics:
        raise BadInputError(f"no ROS 2 node in {survey.address}")
    return survey


def _survey(agent: AgentClient, seconds: float) -> Survey:
    snapshot = agent.snapshot()
    measured = MeasuredRates({}, {})
    if seconds > 0:
        measured = agent.rates([topic.name for topic in snapshot.topics if topic.publishers], seconds)
    processes = GraphProcesses(snapshot)
    services = tuple(
        SurveyedService(service.name, ", ".join(service.kinds), _nodes(service.servers))
        for service in snapshot.services
        if service.servers
    )
    return Survey(
        f"domain {snapshot.domain}, {snapshot.rmw}",
        tuple(_surveyed_node(snapshot, processes, name) for name in dict.fromkeys(snapshot.nodes)),
        tuple(_surveyed_topic(topic, measured) for topic in snapshot.topics),
        services,
        tuple(_surveyed_action(snapshot, action.name, ", ".join(action.kinds)) for action in snapshot.actions),
    )


def _surveyed_node(snapshot: GraphSnapshot, processes: GraphProcesses, name: str) -> SurveyedNode:
    process = processes.pid_of_node(name)
    executable = ""
    if process.pid is not None:
        executable = program_of(process.pid)
    return SurveyedNode(
        name,
        process.pid,
        process.problem,
        executable,
        tuple(topic.name for topic in snapshot.topics if name in _nodes(topic.publishers)),
        tuple(topic.name for topic in snapshot.topics if name in _nodes(topic.subscribers)),
    )


def _surveyed_topic(topic: TopicInfo, measured: MeasuredRates) -> SurveyedTopic:
    return SurveyedTopic(
        topic.name,
        ", ".join(topic.kinds),
        " or ".join(sorted({_quality(publisher) for publisher in topic.publishers})),
        _nodes(topic.publishers),
        _nodes(topic.subscribers),
        measured.rates.get(topic.name),
        measured.reasons.get(topic.name, ""),
    )


def _surveyed_action(snapshot: GraphSnapshot, name: str, kind: str) -> SurveyedService:
    """An action, whose servers are those of its service for goals."""
    for service in snapshot.services:
        if service.name == f"{name}/_action/send_goal":
            return SurveyedService(name, kind, _nodes(service.servers))
    return SurveyedService(name, kind, ())


def _quality(publisher: Endpoint) -> str:
    """Quality of service in words."""
    words = _WORDS.get(publisher.reliability, publisher.reliability)
    if publisher.durability == "transient_local":
        words += ", latched"
    return words


def _nodes(endpoints: Iterable[Endpoint]) -> tuple[str, ...]:
    """Names of the nodes of some endpoints, each once."""
    return tuple(dict.fromkeys(endpoint.node for endpoint in endpoints))


def pid_of_node(name: str) -> int:
    """Process id of a node on this machine.

    Raises:
        BadInputError: ROS 2 is not installed, the graph has no such node, or the node's process is unknown.
        MavfiError: ROS 2 does not start.
    """
    with AgentClient() as agent:
        process = agent.find(lambda snapshot: GraphProcesses(snapshot).pid_of_node(name))
    if process.pid is None:
        raise BadInputError(f"node {process.node}: {process.problem}")
    return process.pid
