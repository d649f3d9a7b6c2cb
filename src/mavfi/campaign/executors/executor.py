"""What a campaign knows of processes: `Executor.map(function, missions)`."""

import functools
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from typing import Protocol, TypeVar

from mavfi.errors import MavfiError

T = TypeVar("T")
R = TypeVar("R")


@dataclass(frozen=True, slots=True)
class Done:
    """The last item of a mission whose function has returned."""

    peak_kib: int = field(default=0, compare=False)  # largest resident memory of its worker so far; 0 = not known


@dataclass(frozen=True, slots=True)
class Lost:
    """The last item of a mission whose worker is gone."""

    reason: str  # what became of the worker
    died: bool  # otherwise it did not answer in time
    signal: str = ""  # that killed it


class Executor(Protocol):
    """Runs missions in workers: local processes, or other machines.

    Attributes:
        forks: Whether workers are forked from this process, and so inherit compiled code.
        workers: Number of processes that this one starts; 0 = none, the workers are others'.
    """

    forks: bool
    workers: int

    def map(
        self, function: Callable[[T], Iterator[R]], missions: Iterable[T]
    ) -> Generator[tuple[T, Sequence[R | Done | Lost]], None, None]:  # fmt: skip
        """Call a function for every mission; close the iterator, or leave it by an exception, to stop the workers.

        The function is a generator function that workers can import; its exceptions are raised here.

        Yields:
            Mission and those of its items that have come since the last time, as soon as there are any; `Done` or
            `Lost` is the last of a mission.
        """


def map_each(executor: Executor, function: Callable[[T], R], items: Iterable[T]) -> Iterator[tuple[T, R]]:
    """Call a function, which workers can import, once for every item; pairs of item and result as they are completed.

    Raises:
        MavfiError: A worker was lost.
    """
    with closing(executor.map(functools.partial(_once, function), items)) as results:
        for item, found in results:
            for result in found:
                if isinstance(result, Lost):
                    raise MavfiError(f"{item}: {result.reason}")
                if not isinstance(result, Done):
                    yield item, result


def _once(function: Callable[[T], R], item: T) -> Iterator[R]:
    yield function(item)
