"""Survey of a ROS 2 graph."""

from collections.abc import Iterable

from mavfi.extras.ros.ros2.graph import AgentClient, Endpoint, GraphSnapshot, MeasuredRates, TopicInfo
from mavfi.extras.ros.ros2.processes import GraphProcesses, program_of
from mavfi.extras.ros.survey import Survey, SurveyedNode, SurveyedService, SurveyedTopic

_WORDS = {"reliable": "reliable", "best_effort": "best effort"}


def survey_ros2(agent: AgentClient, seconds: float) -> Survey:
    """Survey the graph, and listen to every topic for a duration (s); 0 = rates are not measured."""
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
        2,
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
