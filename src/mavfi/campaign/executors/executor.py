"""What a campaign knows of processes: `Executor.map(function, missions)`."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Protocol, TypeVar

T = TypeVar("T")
R = TypeVar("R")


@dataclass(frozen=True, slots=True)
class Done:
    """A mission is through: everything that it gave has been handed over."""


@dataclass(frozen=True, slots=True)
class Lost:
    """A mission whose worker is gone; what it gave before has been handed over.

    Attributes:
        reason: What became of the worker.
        died: Whether it died; otherwise it did not answer in time.
    """

    reason: str
    died: bool


class Executor(Protocol):
    """Who works: local processes, or other machines."""

    def map(
        self, function: Callable[[T], Iterator[R]], missions: Iterable[T]
    ) -> Iterator[tuple[T, R | Done | Lost]]:  # fmt: skip
        """Call a function for every mission; close the iterator, or leave it by an exception, to stop the workers.

        Args:
            function: A generator function, known by its module.
            missions: What it is called with.

        Yields:
            Mission and item, each as soon as the function yields it, and `Done` or `Lost` as the last of a mission.

        Raises:
            Exception: Whatever the function raised.
        """
