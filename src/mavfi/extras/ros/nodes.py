"""The process of a node, in ROS 1 or ROS 2."""

from mavfi.errors import BadInputError
from mavfi.extras.ros.node.master import Master
from mavfi.extras.ros.ros2.graph import AgentClient
from mavfi.extras.ros.ros2.processes import GraphProcesses


def pid_of_node(name: str) -> int:
    """Process id of a node in the running graph, ROS 1 if a master responds.

    Raises:
        BadInputError: There is no such node, or its process cannot be told.
    """
    try:
        master = Master()
    except BadInputError:
        master = None
    if master is not None:
        return master.node_pid(name)
    with AgentClient() as agent:
        process = agent.find(lambda snapshot: GraphProcesses(snapshot).pid_of_node(name))
    if process.pid is None:
        raise BadInputError(f"node {process.node}: {process.problem}")
    return process.pid
