"""Executor on local processes, forked from this one."""

import itertools
import os
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from multiprocessing.connection import wait
from typing import TypeVar

from mavfi.campaign.executors.executor import Done, Lost
from mavfi.campaign.executors.process import Raised, Worker
from mavfi.errors import BadInputError

TIME_LIMIT = 600.0
"""Wall time without an item after which a worker counts as lost (s); a watchdog, hundreds of times a flight's time."""
MOST_WORKERS = 4 * (os.cpu_count() or 1)

T = TypeVar("T")
R = TypeVar("R")


class LocalExecutor:
    """Runs missions on this machine, in at most `workers` processes, and no more than there are missions.

    Args:
        workers: Number of processes.
        time_limit: Wall time without an item after which a worker counts as lost (s).

    Raises:
        BadInputError: `workers` is below 1 or above `MOST_WORKERS`.
    """

    forks = True

    def __init__(self, workers: int, time_limit: float = TIME_LIMIT) -> None:
        if not 1 <= workers <= MOST_WORKERS:
            raise BadInputError(f"workers: {workers}; allowed: 1 to {MOST_WORKERS} (4 per processor)")
        self.workers = workers
        self._time_limit = time_limit

    def map(
        self, function: Callable[[T], Iterator[R]], missions: Iterable[T]
    ) -> Generator[tuple[T, Sequence[R | Done | Lost]], None, None]:
        """See `Executor.map`."""
        waiting = iter(missions)
        workers: list[Worker[T]] = []
        try:
            for mission in itertools.islice(waiting, self.workers):
                workers.append(Worker.forked(function, workers))
                workers[-1].give(mission)
            while workers:
                yield from self._next(workers, function, waiting)
        finally:
            for worker in workers:
                worker.end()

    def _next(
        self, workers: list[Worker[T]], function: Callable[[T], Iterator[R]], waiting: Iterator[T]
    ) -> Iterator[tuple[T, Sequence[R | Done | Lost]]]:
        """Wait for workers, yield their items, and send the next mission to idle ones."""
        ready = wait([worker.pipe for worker in workers], timeout=1.0)
        for index, worker in reversed(list(enumerate(workers))):  # from the end: idle workers are deleted
            mission = worker.mission
            if worker.pipe in ready:
                items = worker.take()
            else:
                items = worker.overdue(self._time_limit)
            if not items:
                continue
            last = items[-1]
            if isinstance(last, Raised):  # flights completed before the error are yielded first
                if items[:-1]:
                    yield mission, items[:-1]
                raise last.error
            if isinstance(last, Lost):  # another worker takes its place
                worker.end()
                others = [other for other in workers if other is not worker]
                worker = Worker.forked(function, others)
                workers[index] = worker
            # The next mission is sent before the caller handles the items, so that the worker does not wait.
            if isinstance(last, (Done, Lost)):
                try:
                    worker.give(next(waiting))
                except StopIteration:
                    worker.end()
                    del workers[index]
            yield mission, items
