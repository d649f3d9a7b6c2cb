"""Processes behind the nodes, topics and services of a ROS 2 graph, where the middleware is Fast DDS.

Fast DDS puts the low 16 bits of the process id in each endpoint's identifier (bytes 4 and 5). A process with such an id
is the one that was meant if it has loaded ROS, is in the same network, and is the only one of this kind; otherwise the
answer is a reason, never a guess.
"""

import os
from collections import defaultdict
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from mavfi.errors import BadInputError, allowed, hint
from mavfi.extras.ros.ros2.graph import Endpoint, GraphSnapshot, absolute

_FAST_DDS = "010f"
"""First two bytes of its identifiers: the vendor, in hexadecimal digits."""
_LIBRARIES = ("/librcl.so", "/librmw_", "/libfastrtps.so", "/libfastdds.so")
"""Parts of paths of libraries; a node has at least one of them loaded."""
_INTERPRETERS = ("python", "node")
"""Begin of names of programs that run a script."""


class NodeProcess(NamedTuple):
    """The process of a node.

    Attributes:
        node: Full name of the node.
        kind: Type of the topic or service that was asked for, e.g. "std_msgs/msg/String"; "" if a node was.
        pid: Its process id; None if unknown.
        problem: Why it is unknown, in one line; "" otherwise.
    """

    node: str
    kind: str
    pid: int | None
    problem: str = ""


class GraphProcesses:
    """Finds processes by the identifiers of a snapshot's endpoints."""

    def __init__(self, snapshot: GraphSnapshot) -> None:
        self._snapshot = snapshot
        self._found: dict[str, tuple[int | None, str]] = {}  # by identifier of the participant
        self._pids_by_low_bits: dict[int, list[int]] | None = None

    def pids_of_publishers(self, topic: str) -> tuple[NodeProcess, ...]:
        """Processes that publish a topic; `BadInputError` if the graph does not have it."""
        return tuple(self._process(endpoint) for endpoint in self._snapshot.topic(topic).publishers)

    def pids_of_subscribers(self, topic: str) -> tuple[NodeProcess, ...]:
        """Processes that read a topic; `BadInputError` if the graph does not have it."""
        return tuple(self._process(endpoint) for endpoint in self._snapshot.topic(topic).subscribers)

    def pids_of_service(self, name: str) -> tuple[NodeProcess, ...]:
        """Processes that serve a service; `BadInputError` if the graph does not have it."""
        service = self._snapshot.service(name)
        kind = ", ".join(service.kinds)
        return tuple(self._process(endpoint)._replace(kind=kind) for endpoint in service.servers)

    def pids_of_clients(self, name: str) -> tuple[NodeProcess, ...]:
        """Processes that call a service; `BadInputError` if the graph does not have it."""
        service = self._snapshot.service(name)
        kind = ", ".join(service.kinds)
        return tuple(self._process(endpoint)._replace(kind=kind) for endpoint in service.clients)

    def pid_of_node(self, name: str) -> NodeProcess:
        """The process of a node; `BadInputError` if the graph has no node of this name."""
        node = absolute(name)
        if node not in self._snapshot.nodes:
            nodes = self._snapshot.nodes
            raise BadInputError(f"node {node}: not in the graph{hint(node, nodes)}; allowed: {allowed(nodes, node)}")
        gids = {_participant(endpoint.gid): endpoint.gid for endpoint in self._endpoints() if endpoint.node == node}
        if not gids:
            return NodeProcess(node, "", None, "has no topic and no service by which its process could be told")
        answers = {self._pid(gid) for gid in gids.values()}
        pids = sorted(pid for pid, _ in answers if pid is not None)
        if len(pids) > 1:
            return NodeProcess(node, "", None, f"nodes of several processes have this name: {_listed(pids)}")
        if len(answers) > 1:
            return NodeProcess(node, "", None, "several nodes have this name, not all of them with a known process")
        pid, problem = answers.pop()
        return NodeProcess(node, "", pid, problem)

    def _endpoints(self) -> Iterable[Endpoint]:
        """All endpoints of the graph."""
        for topic in self._snapshot.topics:
            yield from topic.publishers
            yield from topic.subscribers
        for service in self._snapshot.services:
            yield from service.servers
            yield from service.clients

    def _process(self, endpoint: Endpoint) -> NodeProcess:
        pid, problem = self._pid(endpoint.gid)
        return NodeProcess(endpoint.node, endpoint.kind, pid, problem)

    def _pid(self, gid: str) -> tuple[int | None, str]:
        """Process id of an endpoint, or why it is unknown."""
        participant = _participant(gid)
        if participant not in self._found:
            self._found[participant] = self._search(gid)
        return self._found[participant]

    def _search(self, gid: str) -> tuple[int | None, str]:
        if not gid.startswith(_FAST_DDS):
            return None, f"{self._snapshot.rmw} does not say in which process it is"
        low_bits = int.from_bytes(bytes.fromhex(gid)[4:6], "little")

        # processes with these bits that are part of a ROS graph in this network
        if self._pids_by_low_bits is None:
            self._pids_by_low_bits = _pids_by_low_bits()
        pids = []
        locked = []  # of other users: what they have loaded cannot be seen
        for pid in self._pids_by_low_bits[low_bits]:
            try:
                if _has_loaded_ros(pid) and _is_in_this_network(pid):
                    pids.append(pid)
            except PermissionError:
                locked.append(pid)
            except OSError:  # it has ended
                continue

        # of several, those in the domain: the variable is not asked first, as a program may set the domain itself
        if len(pids) > 1:
            pids = [pid for pid in pids if _domain(pid) == self._snapshot.domain]
        if len(pids) == 1 and not locked:
            return pids[0], ""
        if pids or locked:
            candidates = _listed(sorted(pids + locked))
            if locked:
                return None, f"may be process {candidates}: run mavfi as its user, or as root"
            return None, f"may be process {candidates}: their ids have the same low 16 bits ({low_bits})"
        return None, "no process on this machine and in this network: it may be in a container, or elsewhere"


def program_of(pid: int) -> str:
    """The program of a process: its executable, or the script that an interpreter runs; "" if it has ended."""
    try:
        executable = os.readlink(f"/proc/{pid}/exe")
        words = Path(f"/proc/{pid}/cmdline").read_bytes().decode(errors="replace").split("\0")
    except OSError:
        return ""
    if Path(executable).name.startswith(_INTERPRETERS):
        for word in words[1:]:
            if word and not word.startswith("-"):
                return word
    return executable


def _participant(gid: str) -> str:
    """The part of an identifier that all endpoints of a process's context share: its first 12 bytes."""
    return gid[:24]


def _pids_by_low_bits() -> defaultdict[int, list[int]]:
    """Processes by the low 16 bits of the id that they have for themselves, which differs in containers."""
    pids: defaultdict[int, list[int]] = defaultdict(list)
    for folder in Path("/proc").iterdir():
        if folder.name.isdigit():
            with suppress(OSError):
                for line in (folder / "status").read_text().splitlines():
                    if line.startswith("NSpid:"):
                        pids[int(line.split()[-1]) & 0xFFFF].append(int(folder.name))
    return pids


def _has_loaded_ros(pid: int) -> bool:
    maps = Path(f"/proc/{pid}/maps").read_text(errors="replace")
    return any(library in maps for library in _LIBRARIES)


def _is_in_this_network(pid: int) -> bool:
    return os.stat(f"/proc/{pid}/ns/net").st_ino == os.stat("/proc/thread-self/ns/net").st_ino


def _domain(pid: int) -> int:
    """The domain in a process's environment."""
    for variable in Path(f"/proc/{pid}/environ").read_bytes().split(b"\0"):
        name, _, value = variable.partition(b"=")
        if name == b"ROS_DOMAIN_ID" and value.isdigit():
            return int(value)
    return 0


def _listed(pids: list[int]) -> str:
    return " or ".join(map(str, pids))
