"""Worker process that flies one mission after the other and streams their items; it ends with its parent."""

import contextlib
import ctypes
import gc
import multiprocessing
import os
import pickle
import resource
import signal
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any, Generic, TypeVar

from mavfi.campaign.executors.executor import Done, Lost
from mavfi.errors import MachineError, machine_failure
from mavfi.plugins import portable

_DIE_WITH_PARENT = 1  # PR_SET_PDEATHSIG, prctl(2)
_MUTE_EXIT = 71  # EX_OSERR, sysexits.h
_MOST_ITEMS = 200  # per batch
_FORK = multiprocessing.get_context("fork")

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Raised:
    """An exception raised by the function, as the last item."""

    error: BaseException


def is_last(item: object) -> bool:
    """Whether an item is the last of a mission."""
    return isinstance(item, (Done, Lost, Raised))


class Worker(Generic[T]):
    """A process, the pipe to it, and its current mission."""

    def __init__(self, process: Any, pipe: Connection) -> None:
        self.pipe = pipe
        self.mission: T
        self._process = process
        self._since = time.monotonic()

    @staticmethod
    def forked(function: Callable[[Any], Iterator[Any]], others: "Iterable[Worker[Any]]" = ()) -> "Worker[Any]":
        """Fork a worker, which inherits imports, compiled code and settings of this process.

        It closes the inherited pipe ends of the other workers, so that each sees end-of-file when the parent dies.
        """
        pipe, theirs = _FORK.Pipe()
        ours = [pipe, *(other.pipe for other in others)]
        process = _FORK.Process(target=_forked, args=(theirs, ours, function, os.getpid()), daemon=False)
        process.start()
        theirs.close()
        return Worker(process, pipe)

    def give(self, mission: T) -> None:
        """Send a mission; `take` reports a dead process."""
        self.mission = mission
        self._since = time.monotonic()
        try:
            self.pipe.send(mission)
        except OSError as error:
            if machine_failure(error):
                raise

    def take(self) -> list[Any]:
        """Wait for an item, and return all available ones; `Done`, `Lost` (dead process) or `Raised` is the last."""
        self._since = time.monotonic()
        items: list[Any] = []
        while not items or (len(items) < _MOST_ITEMS and not is_last(items[-1]) and self.pipe.poll()):
            items.append(self._receive())
        return items

    def _receive(self) -> Any:
        """The next item of the process; if the process has died, why."""
        try:
            return self.pipe.recv()
        except (EOFError, OSError) as error:
            if machine_failure(error):
                raise
            self._process.join()
            code = self._process.exitcode or 0
            if code == _MUTE_EXIT:
                return Raised(MachineError("a worker could not send what it had"))
            name = ""
            if -code in {int(s) for s in signal.Signals}:
                name = signal.Signals(-code).name
            return Lost(f"its worker died ({name or f'exit code {code}'})", died=True, signal=name)

    def overdue(self, limit: float) -> list[Any]:
        """A `Lost` item if the process has sent no item for `limit` (s)."""
        if time.monotonic() - self._since < limit:
            return []
        return [Lost(f"its worker gave nothing for {limit:g} s", died=False)]

    def end(self) -> None:
        """End the process."""
        self.pipe.close()
        if self._process.is_alive():
            self._process.terminate()
            self._process.join(5.0)
            if self._process.is_alive():
                self._process.kill()
        self._process.join()


def _forked(
    pipe: Connection, ours: Iterable[Connection], function: Callable[[Any], Iterator[Any]], parent: int
) -> None:
    """Main function of a forked worker."""
    if not ends_with(parent):
        return
    for end in ours:
        end.close()
    gc.freeze()  # inherited objects stay shared: a collection would copy their pages
    work(pipe, function)


def ends_with(parent: int) -> bool:
    """Let this process be killed when its parent dies; False if that has happened."""
    ctypes.CDLL(None).prctl(_DIE_WITH_PARENT, signal.SIGKILL, 0, 0, 0)
    return os.getppid() == parent


def work(pipe: Connection, function: Callable[[Any], Iterator[Any]]) -> None:
    """Fly missions until the pipe is closed or the parent is dead."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent decides when to stop
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    try:
        while True:
            items = function(pipe.recv())
            has_more = True
            while has_more:
                data, has_more = _next_of(items)
                pipe.send_bytes(data)
            # Collect reference cycles, i.e. flights with all their arrays, and return free memory to the system: few
            # large objects do not trigger a collection, the heap keeps the size of the largest mission, and forks
            # copy it.
            gc.collect()
            with contextlib.suppress(AttributeError):  # only in glibc
                ctypes.CDLL(None).malloc_trim(0)
    except (EOFError, ConnectionError):  # the parent is dead
        return
    except (OSError, MemoryError) as error:
        if machine_failure(error):
            os._exit(_MUTE_EXIT)


def _next_of(items: Iterator[Any]) -> tuple[bytes, bool]:
    """The next item, pickled, and whether further ones may follow."""
    try:
        for item in items:
            return pickle.dumps(item), True
        return pickle.dumps(Done(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)), False
    except Exception as error:  # raised in the parent
        return pickle.dumps(Raised(portable(error))), False
