"""A pool of local processes that survives the death of a worker.

Workers are forked, so they inherit what the parent has compiled.  Each has a lane of its own: the items of a group, and
what follows from them, go to one worker, which may keep what they share.  Results come back in the order of completion.
"""

import multiprocessing
import os
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field
from queue import Empty, SimpleQueue
from typing import Generic, TypeVar

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
        return self.run_groups(function, [[item] for item in items], lambda _: ())

    def run_groups(
        self, function: Callable[[T], R], groups: Iterable[Sequence[T]], follow: Callable[[T], Iterable[T]]
    ) -> Generator[tuple[T, R | Lost], None, None]:
        """Call a function for every item of every group, and for what follows from each; otherwise as `run`.

        Args:
            function: As in `run`.
            groups: Items of a group are taken up in order by the same worker, which then goes on to another group.
            follow: Asked for each item when its result has been yielded: further items, for the same worker, next.

        Yields:
            See `run`.
        """
        waiting = [list(group) for group in groups]
        while waiting:
            suspects = []
            lanes = min(self._workers, len(waiting))
            for item, result in _stream(function, waiting, follow, lanes, self._time_limit):
                if isinstance(result, Lost):
                    suspects.append(item)
                else:
                    yield item, result
            waiting = []
            for item in suspects:
                yield item, self._alone(function, item)
                waiting.append(list(follow(item)))
            waiting = [group for group in waiting if group]

    def _alone(self, function: Callable[[T], R], item: T) -> R | Lost:
        result: R | Lost = Lost("was never tried", died=False)
        for _ in range(ATTEMPTS_ALONE):
            for _, result in _stream(function, [[item]], lambda _: (), 1, self._time_limit):
                if not isinstance(result, Lost):
                    return result
        return result


@dataclass(slots=True, eq=False)
class _Lane(Generic[T, R]):
    """A worker, what is ahead of it, and what was handed to it."""

    pool: ProcessPool
    ahead: deque[T] = field(default_factory=deque)
    running: "dict[Future[R], T]" = field(default_factory=dict)


_Finished = SimpleQueue[tuple[_Lane[T, R], "Future[R]"]]


def _stream(
    function: Callable[[T], R], groups: Iterable[Sequence[T]], follow: Callable[[T], Iterable[T]], workers: int,
    time_limit: float,
) -> Iterator[tuple[T, R | Lost]]:  # fmt: skip
    """Keep each worker busy with a few items, and replace one that breaks."""
    waiting = iter(groups)
    finished: _Finished[T, R] = SimpleQueue()
    lanes: list[_Lane[T, R]] = []
    try:
        lanes += [_Lane(_open()) for _ in range(workers)]
        while True:
            broken = [lane for lane in lanes if not _fill(lane, function, waiting, finished, time_limit)]
            if not broken and not any(lane.running for lane in lanes):
                return
            done = None if broken else _next(lanes, finished)
            if done is not None:
                yield from _told(*done, follow)
                continue
            for lane in broken or [lane for lane in lanes if not lane.pool.active]:
                for item in lane.running.values():
                    yield item, Lost("the pool of workers broke", died=True)
                lane.running.clear()
                _close(lane.pool)
                lane.pool = _open()
    finally:
        for lane in lanes:
            _close(lane.pool)


def _told(lane: _Lane[T, R], future: "Future[R]", follow: Callable[[T], Iterable[T]]) -> Iterator[tuple[T, R | Lost]]:
    """The item that is done; what follows from it is next in its lane."""
    item = lane.running.pop(future, None)
    if item is None:
        return  # it was lost with its pool, and that was told
    result = _result(future)
    yield item, result
    if not isinstance(result, Lost):
        lane.ahead.extendleft(reversed(list(follow(item))))


def _fill(
    lane: _Lane[T, R], function: Callable[[T], R], waiting: Iterator[Sequence[T]], finished: _Finished[T, R],
    time_limit: float,
) -> bool:  # fmt: skip
    """Hand items to a worker until it has enough of them; False if its pool is broken."""
    while len(lane.running) < QUEUED_PER_WORKER:
        while not lane.ahead:
            group = next(waiting, None)
            if group is None:
                return True
            lane.ahead.extend(group)
        try:
            future = lane.pool.schedule(function, args=(lane.ahead[0],), timeout=time_limit)
        except RuntimeError:  # the pool broke since the last result; the item was not begun
            return False
        lane.running[future] = lane.ahead.popleft()
        future.add_done_callback(lambda done: finished.put((lane, done)))
    return True


def _open() -> ProcessPool:
    return ProcessPool(max_workers=1, context=multiprocessing.get_context("fork"))


def _close(pool: ProcessPool) -> None:
    pool.stop()  # type: ignore[no-untyped-call]
    pool.join()


def _next(lanes: Sequence[_Lane[T, R]], finished: "_Finished[T, R]") -> "tuple[_Lane[T, R], Future[R]] | None":
    """The next future that is done; None if a pool broke and will finish nothing more."""
    while True:
        try:
            return finished.get(timeout=_POLL)
        except Empty:
            if not all(lane.pool.active for lane in lanes):
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
