"""A running ROS 2 graph as seen and touched by an agent: its nodes and topics, messages in, messages out.

The agent (`agent.py`) is a process under the Python of a ROS 2 installation; mavfi itself never imports rclpy:

    with AgentClient() as agent:
        print(agent.snapshot().nodes)
        agent.subscribe("/odom")
        for message in agent.messages(5.0):
            print(message.topic, message.wall_ns, len(message.data))

Messages are serialized ones, as on the wire: CDR with its header of 4 bytes; see `TypeLibrary` in `message_types`.
All calls block, with a limit of time. A client may be used by several threads; requests are met one after the other.
"""

import json
import os
import queue
import socket
import subprocess
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from mavfi.errors import BadInputError, MavfiError, allowed, hint
from mavfi.extras.ros.ros2.environment import Installation, find_installation

START_LIMIT_S = 30.0
"""Time limit for the agent to join the graph (s); it takes half a second on a quiet machine."""
ANSWER_LIMIT_S = 10.0
"""Time limit for an answer, in addition to what a request may wait for (s)."""
DISCOVERY_S = 3.5
"""Time from the start of the agent until all of the graph is discovered (s): Fast DDS announces itself every 3 s."""
DISCOVERY_LIMIT_S = 10.0
"""Time limit for what is awaited in the graph (s)."""
_END_LIMIT_S = 12.0
"""Time limit for the agent to end by itself (s); it takes 20 ms on a quiet machine."""
_Result = TypeVar("_Result")
OF_EVERY_NODE = ("rcl_interfaces/", "type_description_interfaces/")
"""Packages of the services that every node has: of its parameters, of its types, of its logger."""
_AGENT = Path(__file__).with_name("agent.py")
_RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"


class Endpoint(NamedTuple):
    """A publisher or a subscription.

    Attributes:
        node: Full name of its node.
        kind: Message type, e.g. "std_msgs/msg/String".
        gid: Its identifier in hexadecimal digits.
        reliability: "reliable" or "best_effort".
        durability: "volatile" or "transient_local".
    """

    node: str
    kind: str
    gid: str
    reliability: str
    durability: str


class TopicInfo(NamedTuple):
    """A topic; more than one type (`kinds`) if its endpoints disagree."""

    name: str
    kinds: tuple[str, ...]
    publishers: tuple[Endpoint, ...]
    subscribers: tuple[Endpoint, ...]


class ServiceInfo(NamedTuple):
    """A service, with the readers of its requests (`servers`) and their writers (`clients`)."""

    name: str
    kinds: tuple[str, ...]
    servers: tuple[Endpoint, ...]
    clients: tuple[Endpoint, ...]

    @property
    def is_of_every_node(self) -> bool:
        """Whether every node has such a service: for its parameters, its types, its logger."""
        return all(kind.startswith(OF_EVERY_NODE) for kind in self.kinds)


class ActionInfo(NamedTuple):
    """An action."""

    name: str
    kinds: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class GraphSnapshot:
    """What a graph consists of; mavfi's own agents are left out.

    Attributes:
        nodes: Full names; a name occurs twice if two nodes have it.
        rmw: Middleware of the agent, e.g. "rmw_fastrtps_cpp".
        domain: Number of the graph's domain.
    """

    nodes: tuple[str, ...]
    topics: tuple[TopicInfo, ...]
    services: tuple[ServiceInfo, ...]
    actions: tuple[ActionInfo, ...]
    rmw: str
    domain: int

    def topic(self, name: str) -> TopicInfo:
        """A topic; `BadInputError` if the graph has none of this name."""
        for topic in self.topics:
            if topic.name == absolute(name):
                return topic
        raise _absent("topic", name, [topic.name for topic in self.topics])

    def service(self, name: str) -> ServiceInfo:
        """A service; `BadInputError` if the graph has none of this name."""
        for service in self.services:
            if service.name == absolute(name):
                return service
        names = [service.name for service in self.services if not service.is_of_every_node]
        raise _absent("service", name, names)


class RawMessage(NamedTuple):
    """A message that the agent received.

    Attributes:
        wall_ns: Instant of its arrival (ns since 1970).
        sim_ns: The same by /clock (ns); None if nobody publishes it.
        data: Its serialized bytes.
    """

    topic: str
    wall_ns: int
    sim_ns: int | None
    data: bytes


class GraphTime(NamedTuple):
    """An instant by the wall (ns since 1970) and by /clock (ns); the latter is None if nobody publishes it."""

    wall_ns: int
    sim_ns: int | None


class MeasuredRates(NamedTuple):
    """Messages per second (`rates`) by topic, or why they could not be counted (`reasons`)."""

    rates: dict[str, float]
    reasons: dict[str, str]


class Matched(NamedTuple):
    """Type and quality of service of a subscription."""

    kind: str
    reliability: str
    durability: str


class AgentClient:
    """Starts an agent and talks to it, from `__enter__` to `__exit__`.

    The agent is in the domain and uses the middleware that the environment variables say. Since Iron it stays on this
    machine unless they say otherwise. It ends when this process ends, also if it is killed.

    Args:
        installation: Whose Python runs the agent; None = the first that is found.
        variables: Environment variables in addition to those of this process, e.g. `{"ROS_DOMAIN_ID": "7"}`.

    Attributes:
        notices: What the agent had to say, one line each, e.g. that a publisher does not match a subscription.

    Raises:
        BadInputError: There is no ROS 2 here, or a request names what is not there.
        MavfiError: The agent does not start, has ended, or does not answer in time.
    """

    def __init__(self, installation: Installation | None = None, variables: dict[str, str] | None = None) -> None:
        self.installation = installation or find_installation()
        self.notices: list[str] = []
        self._variables = dict(variables or {})
        self._messages: queue.Queue[RawMessage] = queue.Queue()
        self._replies: queue.Queue[dict[str, Any]] = queue.Queue()
        self._ready: queue.Queue[dict[str, Any]] = queue.Queue()
        self._request_lock = threading.Lock()
        self._number = 0

    def __enter__(self) -> "AgentClient":
        # start the process, with one end of a pair of sockets
        ours, theirs = socket.socketpair()
        self._socket = ours
        self._stream = ours.makefile("rb")
        self._errors = tempfile.TemporaryFile()
        command = [self.installation.python, str(_AGENT), str(theirs.fileno())]
        try:
            self._process = subprocess.Popen(
                command,
                env=self._environment(),
                pass_fds=[theirs.fileno()],
                stdin=subprocess.DEVNULL,
                stdout=self._errors,
                stderr=self._errors,
            )
        except OSError as error:
            self._stream.close()
            ours.close()
            self._errors.close()
            raise MavfiError(f"{self.installation.python}: cannot be started ({error.strerror})") from None
        finally:
            theirs.close()
        self._listener = threading.Thread(target=self._listen, daemon=True)
        self._listener.start()

        # wait until it is in the graph
        try:
            event = self._ready.get(timeout=START_LIMIT_S)
        except queue.Empty:
            event = {"event": "failed", "text": f"not ready within {START_LIMIT_S:g} s"}
        if event["event"] != "ready":
            reason = event.get("text") or self._last_error()
            self.close()
            raise MavfiError(f"ROS 2 {self.installation.distribution} ({self.installation.python}): {reason}")
        self.pid: int = event["pid"]
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Let the agent leave the graph and end; kill it if it does not."""
        with suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
        try:
            self._process.wait(_END_LIMIT_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._listener.join()
        self._stream.close()
        self._socket.close()
        self._errors.close()

    # ---- the graph ---------------------------------------------------------------------------------------------------
    def snapshot(self, least_s: float = DISCOVERY_S, limit_s: float = DISCOVERY_LIMIT_S) -> GraphSnapshot:
        """The graph, once it is quiet, or after a limit (s).

        Args:
            least_s: Earliest instant, from the start of the agent (s). Before the default, parts may be missing; 0 is
                enough for what `wait_for` has seen.
            limit_s: Time limit (s).
        """
        reply = self._request("snapshot", limit_s, least_s=least_s, limit_s=limit_s)
        return GraphSnapshot(
            tuple(reply["nodes"]),
            tuple(
                TopicInfo(
                    topic["name"],
                    tuple(topic["kinds"]),
                    _endpoints(topic["publishers"]),
                    _endpoints(topic["subscribers"]),
                )
                for topic in reply["topics"]
            ),
            tuple(
                ServiceInfo(
                    service["name"],
                    tuple(service["kinds"]),
                    _endpoints(service["servers"]),
                    _endpoints(service["clients"]),
                )
                for service in reply["services"]
            ),
            tuple(ActionInfo(action["name"], tuple(action["kinds"])) for action in reply["actions"]),
            reply["rmw"],
            reply["domain"],
        )

    def find(self, search: Callable[[GraphSnapshot], _Result], limit_s: float = 3.0) -> _Result:
        """What a search returns for the graph; repeated until it finds what it looks for, at the latest at a limit (s).

        Raises:
            BadInputError: That of the search.
        """
        end = time.monotonic() + limit_s
        while True:
            try:
                return search(self.snapshot())
            except BadInputError:
                if time.monotonic() > end:
                    raise

    def wait_for(
        self, topic: str, publishers: int = 1, subscribers: int = 0, limit_s: float = DISCOVERY_LIMIT_S
    ) -> bool:
        """Wait until a topic has at least so many publishers and subscriptions of others; returns whether it has."""
        reply = self._request(
            "wait", limit_s, topic=absolute(topic), publishers=publishers, subscribers=subscribers, limit_s=limit_s
        )
        return bool(reply["holds"])

    def rates(self, topics: Sequence[str], seconds: float = 1.0) -> MeasuredRates:
        """Count messages for a duration (s)."""
        names = [absolute(topic) for topic in topics]
        reply = self._request("rates", seconds, topics=names, seconds=seconds)
        return MeasuredRates(reply["rates"], reply["reasons"])

    def now(self, limit_s: float = 1.0) -> GraphTime:
        """The instant by the wall and by /clock; waits up to a limit (s) for the first message on /clock."""
        reply = self._request("time", limit_s, limit_s=limit_s)
        return GraphTime(reply["wall_ns"], reply["sim_ns"])

    def definition(self, kind: str) -> str:
        """Text of the `.msg` file of a message type in the agent's installation.

        Raises:
            BadInputError: It has none.
        """
        return str(self._request("definition", kind=kind)["text"])

    # ---- messages in -------------------------------------------------------------------------------------------------
    def subscribe(
        self, topic: str, kind: str = "", *, reliable: bool | None = None, limit_s: float = DISCOVERY_LIMIT_S
    ) -> Matched:
        """Receive the messages of a topic from now on, with `receive` or `messages`.

        Args:
            topic: Its name.
            kind: Its message type; "" = as its publishers say.
            reliable: Whether lost messages are sent again; then publishers with best effort are not read. None = if all
                publishers offer it.
            limit_s: Time limit for the first publisher (s), unless type and reliability are given.

        Raises:
            BadInputError: Nobody publishes the topic, or the installation lacks its type.
        """
        reply = self._request(
            "subscribe", limit_s, topic=absolute(topic), kind=kind, reliable=reliable, limit_s=limit_s
        )
        return Matched(reply["kind"], reply["reliability"], reply["durability"])

    def unsubscribe(self, topic: str) -> None:
        """Receive no further messages of a topic but those that have arrived."""
        self._request("unsubscribe", topic=absolute(topic))

    def receive(self, limit_s: float) -> RawMessage | None:
        """The next message of any subscribed topic, in order of arrival; None if none comes within the limit (s)."""
        end = time.monotonic() + limit_s
        while True:
            left = end - time.monotonic()
            try:
                return self._messages.get(timeout=max(0.0, min(left, 0.1)))
            except queue.Empty:
                if left <= 0:
                    return None
                self._check_alive()

    def messages(self, seconds: float) -> Iterator[RawMessage]:
        """Messages of all subscribed topics in order of arrival, for a duration (s)."""
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            message = self.receive(left)
            if message is not None:
                yield message

    # ---- messages out ------------------------------------------------------------------------------------------------
    def advertise(
        self,
        topic: str,
        kind: str,
        *,
        reliable: bool = True,
        latched: bool = False,
        subscribers: int | None = None,
        limit_s: float = DISCOVERY_LIMIT_S,
    ) -> bool:
        """Be a publisher of a topic from now on; returns whether it has at least so many subscriptions.

        Args:
            topic: Its name.
            kind: Its message type.
            reliable: Whether lost messages are sent again.
            latched: Whether subscriptions that come later get earlier messages.
            subscribers: Number of subscriptions to wait for; None = those that the agent has discovered.
            limit_s: Time limit for them (s).

        Raises:
            BadInputError: The installation lacks the type.
        """
        reply = self._request(
            "advertise",
            limit_s,
            topic=absolute(topic),
            kind=kind,
            reliable=reliable,
            latched=latched,
            subscribers=subscribers,
            limit_s=limit_s,
        )
        return bool(reply["holds"])

    def publish(self, topic: str, data: bytes, count: int = 1, period_s: float = 0.0) -> int:
        """Publish serialized bytes on an advertised topic; returns the instant of the last message (ns since 1970).

        Args:
            topic: Its name.
            data: The message.
            count: How many times.
            period_s: Time between them (s).
        """
        reply = self._request("publish", count * period_s, data, topic=absolute(topic), count=count, period_s=period_s)
        return int(reply["wall_ns"])

    def say(self, topic: str, text: str) -> None:
        """Publish a text on an advertised topic of type std_msgs/msg/String."""
        self._request("say", topic=absolute(topic), text=text)

    # ---- frames ------------------------------------------------------------------------------------------------------
    def _environment(self) -> dict[str, str]:
        variables = self.installation.environment(**self._variables)
        # A node of Humble that is restricted so (ROS_LOCALHOST_ONLY) would not see others that are not.
        variables.setdefault(_RANGE, "LOCALHOST")
        return variables

    def _request(self, action: str, waits_s: float = 0.0, content: bytes = b"", **keys: Any) -> dict[str, Any]:
        """Send a request; return its reply."""
        with self._request_lock:
            self._number += 1
            header = {"id": self._number, "do": action, **keys}
            if content:
                header["bytes"] = len(content)
            try:
                self._socket.sendall(json.dumps(header).encode() + b"\n" + content)
            except OSError:
                raise self._ended() from None
            reply = self._reply(action, waits_s + ANSWER_LIMIT_S)
        if "error" in reply:
            raise BadInputError(reply["error"])
        return reply

    def _reply(self, action: str, limit_s: float) -> dict[str, Any]:
        """The reply to the last request; replies to earlier ones, given up since, are dropped."""
        end = time.monotonic() + limit_s
        while True:
            try:
                reply = self._replies.get(timeout=max(0.0, end - time.monotonic()))
            except queue.Empty:
                raise MavfiError(f"agent in ROS 2: no answer to {action} within {limit_s:g} s") from None
            if "id" not in reply:
                self._replies.put(reply)  # for whoever asks next
                raise self._ended()
            if reply["id"] == self._number:
                return reply

    def _listen(self) -> None:
        """Sort what the agent sends; runs in a thread until it closes the socket."""
        with suppress(OSError, ValueError):
            while line := self._stream.readline():
                header = json.loads(line)
                content = self._stream.read(header.pop("bytes", 0))
                event = header.get("event")
                if event == "message":
                    self._messages.put(RawMessage(header["topic"], header["wall_ns"], header["sim_ns"], content))
                elif event == "notice":
                    self.notices.append(header["text"])
                elif event is not None:
                    self._ready.put(header)
                else:
                    self._replies.put(header)
        self._ready.put({"event": "ended"})
        self._replies.put({})

    def _check_alive(self) -> None:
        if not self._listener.is_alive():
            raise self._ended()

    def _ended(self) -> MavfiError:
        return MavfiError(f"agent in ROS 2: has ended ({self._last_error()})")

    def _last_error(self) -> str:
        """Last line that the agent printed, or its exit code."""
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(1.0)
        self._errors.seek(0, os.SEEK_SET)
        lines = self._errors.read().decode(errors="replace").split("\n")
        printed = [line.strip() for line in lines if line.strip()]
        if printed:
            return printed[-1]
        return f"exit code {self._process.returncode}"


def absolute(name: str) -> str:
    """Name of a topic, node or service, with the slash that may be omitted."""
    return "/" + name.removeprefix("/")


def _endpoints(rows: list[dict[str, str]]) -> tuple[Endpoint, ...]:
    return tuple(Endpoint(**row) for row in rows)


def _absent(what: str, name: str, names: Sequence[str]) -> BadInputError:
    question = hint(absolute(name), names)
    names_shown = allowed(names, absolute(name))
    return BadInputError(f"{what} {absolute(name)}: not in the graph{question}; allowed: {names_shown}")
