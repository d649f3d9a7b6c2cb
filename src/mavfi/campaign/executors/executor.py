"""The campaign's only interface to processes: `Executor.map(function, missions)`."""

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

    peak_kib: int = field(default=0, compare=False)  # peak resident memory of its worker so far (KiB); 0 = unknown


@dataclass(frozen=True, slots=True)
class Lost:
    """The last item of a mission whose worker was lost."""

    reason: str  # what became of the worker, as text
    died: bool  # False = it did not respond in time
    signal: str = ""  # signal that killed it


class Executor(Protocol):
    """Runs missions in workers: local processes, or other machines.

    Attributes:
        forks: Whether workers are forked from this process, and so inherit compiled code.
        workers: Number of processes started by this one; 0 = workers are started elsewhere.
    """

    forks: bool
    workers: int

    def map(
        self, function: Callable[[T], Iterator[R]], missions: Iterable[T]
    ) -> Generator[tuple[T, Sequence[R | Done | Lost]], None, None]:
        """Call a function for every mission; closing the iterator, or an exception, stops the workers.

        The function is a generator function that workers can import; its exceptions are raised here.

        Yields:
            Mission and its new items, as soon as they arrive; `Done` or `Lost` is the last item of a mission.
        """


def map_each(executor: Executor, function: Callable[[T], R], items: Iterable[T]) -> Iterator[tuple[T, R]]:
    """Call an importable function once for every item; yields pairs of item and result in order of completion.

    Raises:
        MavfiError: A worker was lost.
    """
    with closing(executor.map(functools.partial(_once, function), items)) as results:
        for item, new_results in results:
            for result in new_results:
                if isinstance(result, Lost):
                    raise MavfiError(f"{item}: {result.reason}")
                if not isinstance(result, Done):
                    yield item, result


def _once(function: Callable[[T], R], item: T) -> Iterator[R]:
    yield function(item)
