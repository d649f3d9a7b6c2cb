"""What a campaign knows of processes: `Executor.map(function, missions)`."""

import functools
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import closing
from dataclasses import dataclass
from typing import Protocol, TypeVar

from mavfi.errors import MavfiError

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
    ) -> Generator[tuple[T, R | Done | Lost], None, None]:  # fmt: skip
        """Call a function for every mission; close the iterator, or leave it by an exception, to stop the workers.

        Args:
            function: A generator function, known by its module.
            missions: What it is called with.

        Yields:
            Mission and item, each as soon as the function yields it, and `Done` or `Lost` as the last of a mission.

        Raises:
            Exception: Whatever the function raised.
        """


def map_each(executor: Executor, function: Callable[[T], R], items: Iterable[T]) -> Iterator[tuple[T, R]]:
    """Call a function once for every item.

    Args:
        executor: Who works.
        function: Known by its module; it returns one result.
        items: What it is called with.

    Yields:
        Item and result, in the order of completion.

    Raises:
        MavfiError: A worker was lost.
        Exception: Whatever the function raised.
    """
    with closing(executor.map(functools.partial(_once, function), items)) as results:
        for item, result in results:
            if isinstance(result, Lost):
                raise MavfiError(f"{item}: {result.reason}")
            if not isinstance(result, Done):
                yield item, result


def _once(function: Callable[[T], R], item: T) -> Iterator[R]:
    yield function(item)
