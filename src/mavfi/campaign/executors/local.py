"""A pool of local processes that survives the death of a worker.

Workers are forked, so they inherit what the parent has compiled.  Results come back in the order of completion.
"""

import multiprocessing
import os
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from itertools import chain, islice
from queue import Empty, SimpleQueue
from typing import TypeVar

from pebble import ProcessExpired, ProcessPool

from mavfi.errors import BadInputError

ATTEMPTS_ALONE = 3
"""How often an item that took a worker with it is tried again, with nothing beside it."""
QUEUED_PER_WORKER = 2
TIME_LIMIT = 600.0
"""Wall time after which a worker counts as lost (s); a watchdog, hundreds of times a flight."""
MOST_WORKERS = 4 * (os.cpu_count() or 1)
_POLL = 1.0

T = TypeVar("T")
R = TypeVar("R")


@dataclass(frozen=True, slots=True)
class Lost:
    """An item that no worker brought back.

    Attributes:
        reason: What became of the last worker.
        died: Whether the worker died; otherwise it did not answer in time.
    """

    reason: str
    died: bool


class LocalPool:
    """Flies items on local processes.

    Args:
        workers: Number of processes, at most; there are never more than items.
        time_limit: Wall time after which a worker counts as lost (s).

    Raises:
        BadInputError: There would be no worker, or more than `MOST_WORKERS`.
    """

    def __init__(self, workers: int, time_limit: float = TIME_LIMIT) -> None:
        if not 1 <= workers <= MOST_WORKERS:
            raise BadInputError(f"workers: {workers}; allowed: 1 to {MOST_WORKERS} (4 per processor)")
        self._workers = workers
        self._time_limit = time_limit

    def run(self, function: Callable[[T], R], items: Iterable[T]) -> Generator[tuple[T, R | Lost], None, None]:
        """Call a function for every item; close the iterator, or leave it by an exception, to stop the workers.

        Args:
            function: Known by its module, so that a worker can be told which it is.
            items: What it is called with.

        Yields:
            Item and result, in the order of completion.  Items that took a worker with them come last: each is tried
            again alone, up to `ATTEMPTS_ALONE` times, and is `Lost` if it never comes back.

        Raises:
            Exception: Whatever the function raised.
        """
        suspects, waiting = [], list(items)
        workers = min(self._workers, max(1, len(waiting)))
        for item, result in _stream(function, waiting, workers, self._time_limit):
            if isinstance(result, Lost):
                suspects.append(item)
            else:
                yield item, result
        for item in suspects:
            yield item, self._alone(function, item)

    def _alone(self, function: Callable[[T], R], item: T) -> R | Lost:
        result: R | Lost = Lost("was never tried", died=False)
        for _ in range(ATTEMPTS_ALONE):
            for _, result in _stream(function, [item], 1, self._time_limit):
                if not isinstance(result, Lost):
                    return result
        return result


def _stream(
    function: Callable[[T], R], items: Iterable[T], workers: int, time_limit: float
) -> Iterator[tuple[T, R | Lost]]:
    """Keep the workers busy with a few items each, and replace the pool if it breaks."""
    waiting = iter(items)
    running: dict[Future[R], T] = {}
    finished: SimpleQueue[Future[R]] = SimpleQueue()
    pool = _open(workers)
    try:
        while True:
            broken = False
            for item in islice(waiting, QUEUED_PER_WORKER * workers - len(running)):
                try:
                    future = pool.schedule(function, args=(item,), timeout=time_limit)
                except RuntimeError:  # the pool broke since the last result; the item was not begun
                    waiting, broken = chain([item], waiting), True
                    break
                running[future] = item
                future.add_done_callback(finished.put)
            if not running and not broken:
                return
            done = _next(pool, finished) if running else None
            if done is not None:
                item, result = running.pop(done), _result(done)
                yield item, result
                continue
            for item in running.values():
                yield item, Lost("the pool of workers broke", died=True)
            running, finished = {}, SimpleQueue()
            _close(pool)
            pool = _open(workers)
    finally:
        _close(pool)


def _open(workers: int) -> ProcessPool:
    return ProcessPool(max_workers=workers, context=multiprocessing.get_context("fork"))


def _close(pool: ProcessPool) -> None:
    pool.stop()  # type: ignore[no-untyped-call]
    pool.join()


def _next(pool: ProcessPool, finished: "SimpleQueue[Future[R]]") -> "Future[R] | None":
    """The next future that is done; None if the pool broke and will finish nothing more."""
    while True:
        try:
            return finished.get(timeout=_POLL)
        except Empty:
            if not pool.active:
                return None


def _result(future: "Future[R]") -> R | Lost:
    try:
        return future.result()
    except ProcessExpired as error:
        return Lost(f"its worker died with exit code {error.exitcode}", died=True)
    except BrokenProcessPool as error:
        return Lost(f"the pool of workers broke ({error})", died=True)
    except TimeoutError:
        return Lost("its worker did not answer in time", died=False)
