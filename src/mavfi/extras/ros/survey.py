"""Survey of running ROS graphs, of ROS 1 and ROS 2: nodes with processes, topics with types and rates, services."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from mavfi.errors import BadInputError

if TYPE_CHECKING:
    from mavfi.extras.ros.node.master import Master


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
        qos: Quality of service of its publishers, e.g. "reliable, latched"; "" in ROS 1, or without a publisher.
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
    """A running graph.

    Attributes:
        ros: Its version: 1 or 2.
        address: Address of the master of ROS 1; domain and middleware of ROS 2.
    """

    ros: int
    address: str
    nodes: tuple[SurveyedNode, ...]
    topics: tuple[SurveyedTopic, ...]
    services: tuple[SurveyedService, ...]
    actions: tuple[SurveyedService, ...]

    def to_json(self) -> dict[str, Any]:
        """The survey as plain data."""
        return asdict(self)


def survey_all(seconds: float) -> list[Survey]:
    """Survey the graph of ROS 1, if a master answers, and that of ROS 2, if it has a node.

    Args:
        seconds: How long to listen for rates (s); 0 = they are not measured.

    Raises:
        BadInputError: There is no graph; the message says where it was looked for.
        MavfiError: ROS 2 is installed, but does not start.
    """
    from mavfi.extras.ros.node.master import Master
    from mavfi.extras.ros.node.survey import survey_ros1
    from mavfi.extras.ros.ros2.environment import find_installation
    from mavfi.extras.ros.ros2.graph import AgentClient
    from mavfi.extras.ros.ros2.survey import survey_ros2

    surveys = []
    absences = []
    try:
        surveys.append(survey_ros1(Master(), seconds))
    except BadInputError as error:
        absences.append(str(error))
    try:
        installation = find_installation()
    except BadInputError as error:
        absences.append(str(error))
    else:
        with AgentClient(installation) as agent:
            survey = survey_ros2(agent, seconds)
        if survey.nodes or survey.topics:
            surveys.append(survey)
        else:
            absences.append(f"no ROS 2 node in {survey.address}")
    if not surveys:
        raise BadInputError("; ".join(absences))
    return surveys


def master_of(topics: Sequence[str]) -> "Master | None":
    """The master of ROS 1, if one answers; None if the topics are those of ROS 2, or no master answers.

    Raises:
        MavfiError: ROS 2 is installed, but does not start.
    """
    from mavfi.extras.ros.node.master import Master, absolute

    try:
        master = Master()
    except BadInputError:
        return None
    names = {absolute(topic) for topic in topics}
    if names <= set(master.graph().topics) or not names <= _topics_of_ros2():
        return master
    return None


def _topics_of_ros2() -> set[str]:
    """Names of the topics in the graph of ROS 2; empty if it is not installed."""
    from mavfi.extras.ros.ros2.environment import find_installation
    from mavfi.extras.ros.ros2.graph import AgentClient

    try:
        installation = find_installation()
    except BadInputError:
        return set()
    with AgentClient(installation) as agent:
        return {topic.name for topic in agent.snapshot().topics}


def pid_of_node(name: str) -> int:
    """Process id of a node on this machine, of ROS 1 if a master answers, else of ROS 2.

    Raises:
        BadInputError: There is no graph, it has no such node, or the node's process is unknown.
        MavfiError: ROS 2 is installed, but does not start.
    """
    from mavfi.extras.ros.node.master import Master
    from mavfi.extras.ros.ros2.environment import find_installation
    from mavfi.extras.ros.ros2.graph import AgentClient
    from mavfi.extras.ros.ros2.processes import GraphProcesses

    try:
        master = Master()
    except BadInputError as absence:
        try:
            installation = find_installation()
        except BadInputError as error:
            raise BadInputError(f"{absence}; {error}") from None
        with AgentClient(installation) as agent:
            process = agent.find(lambda snapshot: GraphProcesses(snapshot).pid_of_node(name))
        if process.pid is None:
            raise BadInputError(f"node {process.node}: {process.problem}") from None
        return process.pid
    return master.node_pid(name)
