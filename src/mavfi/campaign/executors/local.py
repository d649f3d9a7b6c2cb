"""Local processes, forked from this one: each takes one mission after the other and streams what it gives."""

import ctypes
import itertools
import multiprocessing
import os
import pickle
import signal
import time
from collections.abc import Callable, Generator, Iterable, Iterator
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any, Generic, TypeVar

from mavfi.campaign.executors.executor import Done, Lost
from mavfi.errors import BadInputError, MachineError, MavfiError, machine_failure

TIME_LIMIT = 600.0
"""Wall time without an item after which a worker counts as lost (s); a watchdog, hundreds of times a flight."""
MOST_WORKERS = 4 * (os.cpu_count() or 1)
_MUTE_EXIT = 71  # EX_OSERR, sysexits.h
_DIE_WITH_PARENT = 1  # PR_SET_PDEATHSIG, prctl(2)
_FORK = multiprocessing.get_context("fork")

T = TypeVar("T")
R = TypeVar("R")


class LocalExecutor:
    """Runs missions on this machine, in at most `workers` processes; there are never more than missions.

    Args:
        workers: Number of processes.
        time_limit: Wall time without an item after which a worker counts as lost (s).

    Raises:
        BadInputError: There would be no worker, or more than `MOST_WORKERS`.
    """

    def __init__(self, workers: int, time_limit: float = TIME_LIMIT) -> None:
        if not 1 <= workers <= MOST_WORKERS:
            raise BadInputError(f"workers: {workers}; allowed: 1 to {MOST_WORKERS} (4 per processor)")
        self._workers = workers
        self._time_limit = time_limit

    def map(
        self, function: Callable[[T], Iterator[R]], missions: Iterable[T]
    ) -> Generator[tuple[T, R | Done | Lost], None, None]:  # fmt: skip
        """See `Executor.map`."""
        waiting = iter(missions)
        workers: list[_Worker[T]] = []
        try:
            for mission in itertools.islice(waiting, self._workers):
                workers.append(_Worker(function, workers))
                workers[-1].give(mission)
            while workers:
                yield from self._next(workers, function, waiting)
        finally:
            for worker in workers:
                worker.end()

    def _next(
        self, workers: "list[_Worker[T]]", function: Callable[[T], Iterator[R]], waiting: Iterator[T]
    ) -> Iterator[tuple[T, Any]]:
        """Wait for workers, yield their items, and give those that are done the next mission."""
        ready = wait([worker.pipe for worker in workers], timeout=1.0)
        for place, worker in reversed(list(enumerate(workers))):
            mission = worker.mission
            item = worker.take() if worker.pipe in ready else worker.overdue(self._time_limit)
            if item is _NOTHING:
                continue
            if isinstance(item, _Raised):
                raise item.error
            if isinstance(item, (Done, Lost)):
                if isinstance(item, Lost):
                    worker.end()
                    others = [other for other in workers if other is not worker]
                    workers[place] = worker = _Worker(function, others)
                following = next(waiting, _NOTHING)
                if following is _NOTHING:
                    worker.end()
                    del workers[place]
                else:
                    worker.give(following)
            yield mission, item


_NOTHING: Any = object()


@dataclass(frozen=True, slots=True)
class _Raised:
    """An exception of the function."""

    error: Exception


class _Worker(Generic[T]):
    """A process, the pipe to it, and its present mission."""

    def __init__(self, function: Callable[[Any], Iterator[Any]], others: "Iterable[_Worker[Any]]") -> None:
        """Fork a worker, without the pipe ends of the other workers: each sees end-of-file when the parent dies."""
        self.pipe, theirs = _FORK.Pipe()
        ours = [self.pipe, *(other.pipe for other in others)]
        self._process: BaseProcess = _FORK.Process(
            target=_work, args=(theirs, ours, function, os.getpid()), daemon=False
        )
        self._process.start()
        theirs.close()
        self.mission: T
        self._since = time.monotonic()

    def give(self, mission: T) -> None:
        """Send a mission; a process that is gone is noticed by `take`."""
        self.mission, self._since = mission, time.monotonic()
        try:
            self.pipe.send(mission)
        except OSError as error:
            if machine_failure(error):
                raise

    def take(self) -> Any:
        """The next item; `Lost` if the process is gone, a `MachineError` if it could not send what it had."""
        self._since = time.monotonic()
        try:
            return self.pipe.recv()
        except (EOFError, OSError) as error:
            if machine_failure(error):
                raise
            self._process.join()
            code = self._process.exitcode or 0
            if code == _MUTE_EXIT:
                return _Raised(MachineError("a worker could not send what it had"))
            name = signal.Signals(-code).name if -code in {int(s) for s in signal.Signals} else ""
            return Lost(f"its worker died ({name or f'exit code {code}'})", died=True, signal=name)

    def overdue(self, limit: float) -> Any:
        """`Lost` if the process has sent nothing for too long."""
        if time.monotonic() - self._since < limit:
            return _NOTHING
        return Lost(f"its worker gave nothing for {limit:g} s", died=False)

    def end(self) -> None:
        """End the process."""
        self.pipe.close()
        if self._process.is_alive():
            self._process.terminate()
            self._process.join(5.0)
            if self._process.is_alive():
                self._process.kill()
        self._process.join()


def _work(
    pipe: Connection, ours: Iterable[Connection], function: Callable[[Any], Iterator[Any]], parent: int
) -> None:  # fmt: skip
    """Main function of a worker: fly missions until there are none."""
    ctypes.CDLL(None).prctl(_DIE_WITH_PARENT, signal.SIGKILL, 0, 0, 0)
    if os.getppid() != parent:
        return
    for end in ours:
        end.close()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent decides when to stop
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    try:
        _fly_all(pipe, function)
    except (EOFError, ConnectionError):  # the parent is gone
        return
    except (OSError, MemoryError) as error:
        if machine_failure(error):
            os._exit(_MUTE_EXIT)


def _fly_all(pipe: Connection, function: Callable[[T], Iterator[R]]) -> None:
    """Fly missions until there are none; what a pipe does not take, not even as an exception, is raised."""
    while True:
        mission = pipe.recv()
        answers, goes_on = function(mission), True
        while goes_on:
            data, goes_on = _next_of(answers)
            pipe.send_bytes(data)


def _next_of(answers: Iterator[Any]) -> tuple[bytes, bool]:
    """The next item, pickled, and whether more may follow."""
    try:
        item = next(answers, Done())
        return pickle.dumps(item), not isinstance(item, Done)
    except Exception as error:  # whoever asked raises it
        return pickle.dumps(_Raised(_portable(error))), False


def _portable(error: Exception) -> Exception:
    """The exception if another process can unpickle it, else its text."""
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:  # whatever a class of somebody else's does with its arguments
        return MavfiError(f"{type(error).__name__}: {error}")
    return error
