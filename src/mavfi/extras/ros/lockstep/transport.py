"""The seam between lock-step flights and ROS: what a flight needs of a middleware, implemented for ROS 1 and ROS 2."""

import subprocess
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Mapping
from pathlib import Path
from typing import ClassVar

Send = Callable[[bytes], None]
"""Publishes bytes to a topic."""
OnBytes = Callable[[bytes], None]
"""Receives the bytes of one publication."""


class StandardView(ABC):
    """A topic with messages of a standard type, for people and their tools."""

    @abstractmethod
    def has_readers(self) -> bool:
        """Whether anybody is subscribed."""

    @abstractmethod
    def publish(self, content: bytes) -> None:
        """Publish a serialized message."""


class Transport(ABC):
    """The connection of one node, in its own process, to the nodes of its flight.

    Publications are reliable, ordered per topic, and never dropped.  They are received one at a time.
    """

    @abstractmethod
    def publisher(self, topic: str, greeting: bytes) -> Send:
        """Advertise a topic.

        A subscriber that connects is sent a greeting; what is published after the greeting reaches it.
        """

    @abstractmethod
    def subscribe(self, topic: str, arrived: OnBytes) -> None:
        """Subscribe to a topic; this process ends if `arrived` raises an exception."""

    @abstractmethod
    def wait(self, until: Callable[[], bool], timeout_s: float) -> bool:
        """Receive until a condition holds; returns whether it holds after the time limit (s, wall clock) at the latest.

        Publications may also be received between two calls, in other threads, but never concurrently.
        """

    @abstractmethod
    def view(self, topic: str, kind: str) -> StandardView | None:
        """Advertise a topic of a standard type, "package/Name"; None = the type is not installed."""

    def reconnect(self, topics: Collection[str]) -> None:  # noqa: B027 - nothing to do, by default
        """Called once per second while no publisher of these topics is connected."""


class Middleware(ABC):
    """ROS 1 or ROS 2 as installed here: plain data, which a flight's plan contains.

    Attributes:
        name: Of the host in campaigns, "ros1" or "ros2".
        join_example: Command that lists the topics of a flight, for the script `join`.
    """

    name: ClassVar[str]
    join_example: ClassVar[str]

    @property
    @abstractmethod
    def title(self) -> str:
        """For people, e.g. "ROS 2 jazzy"."""

    @abstractmethod
    def require(self) -> None:
        """Check that it can be used by this Python; raises `BadInputError` with the remedy."""

    @abstractmethod
    def variables(self, folder: Path) -> Mapping[str, str]:
        """Environment variables of all programs of the flight in a folder."""

    @abstractmethod
    def start(self, folder: Path) -> "subprocess.Popen[bytes] | None":
        """Prepare a flight; returns the program without which nodes cannot connect, None = there is none."""

    @abstractmethod
    def load(self) -> None:
        """Import its modules into this process, from which nodes are forked."""

    @abstractmethod
    def connect(self, node: str) -> Transport:
        """Start a node with this name in this process."""
