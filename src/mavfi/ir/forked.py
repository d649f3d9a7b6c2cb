"""Work in a forked child: a fault there cannot affect the parent, which continues from the instant of the fork.

The child reports through a pipe and exits without the parent's clean-up code.  It ends with its parent, writes no core
file, and leaves no zombie and no open file.
"""

import contextlib
import ctypes
import faulthandler
import gc
import os
import resource
import select
import signal
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Literal, NoReturn

from mavfi.errors import FROM_OUTSIDE, MachineError, machine_failure

How = Literal["done", "crash", "hang", "exception"]
"""How a forked child ended."""
_EXCEPTION_EXIT = 70
"""Exit status of a child whose work raised an exception."""
_MACHINE_EXIT = 71
"""Exit status of a child that failed for reasons of the machine, e.g. without memory."""
HANG_EXIT = 77
"""Exit status of a process whose kernel exhausted its instruction budget."""
WILD_EXIT = 78
"""Exit status of a process whose kernel accessed memory that it does not own."""
LENGTH_BYTES = 8
"""Bytes of the length in front of a message between processes."""
WALL_CLOCK = "wall clock"
"""Detail of a child killed at its time limit."""
WILD = "access outside its memory"
"""Detail of a child whose kernel accessed memory that it does not own."""
_CHUNK = 1 << 16
"""Bytes that are read from a pipe at a time."""
_SIGNALS = {int(number): number.name for number in signal.Signals}
"""Names of signals by number."""
_DIE_WITH_PARENT = 1  # PR_SET_PDEATHSIG, prctl(2)


@dataclass(frozen=True, slots=True)
class ChildEnd:
    """How a child ended.

    Attributes:
        how: "done": it reported; "crash": a signal, or an access outside the kernel's memory; "hang": it exhausted its
            instruction budget or wall-clock limit; "exception": it raised, or exited in another way.
        payload: Its report.
        detail: Name of the signal, text of the exception, or "wall clock".
    """

    how: How
    payload: bytes = b""
    detail: str = ""


Attend = Callable[[int], ChildEnd | None]
"""Called in the parent with the child's pid before waiting for its report, e.g. to trace it.  A result other than None
states how the child ended; it has then been waited for."""


class ForkPoint:
    """A single fork: the child continues, the parent waits for its end."""

    def __init__(self) -> None:
        self._pipe = -1

    @property
    def in_child(self) -> bool:
        """Whether this is the child."""
        return self._pipe >= 0

    def split(self, timeout: float = 60.0, attend: Attend | None = None) -> ChildEnd | None:
        """Fork; `timeout` is the wall-clock limit of the child (s).

        Returns:
            None in the child, immediately; in the parent how the child ended.

        Raises:
            MachineError: A failure of the machine occurred in the child, or it was killed from outside.
        """
        reading, writing = os.pipe()
        parent = os.getpid()
        pid = os.fork()
        if pid == 0:
            os.close(reading)
            self._pipe = writing
            _isolate(parent)
            return None
        os.close(writing)
        try:
            end = None
            if attend is not None:
                end = attend(pid)
            if end is None:
                return _wait(pid, reading, timeout)
            return end
        finally:
            os.close(reading)

    def finish(self, payload: bytes) -> NoReturn:
        """End the child and report."""
        self._end(payload, 0)

    @contextlib.contextmanager
    def guard(self) -> Iterator[None]:
        """In the child, report an exception and exit; no effect in the parent."""
        try:
            yield
        except BaseException as error:
            if not self.in_child:
                raise
            why = machine_failure(error)
            if why:
                self._end(why.encode(errors="replace"), _MACHINE_EXIT)
            self._end(f"{type(error).__name__}: {error}".encode(errors="replace"), _EXCEPTION_EXIT)

    def _end(self, payload: bytes, status: int) -> NoReturn:
        try:
            write_all(self._pipe, framed(payload))
        except BaseException as error:
            if machine_failure(error):
                status = _MACHINE_EXIT
        finally:
            os._exit(status)


def framed(payload: bytes) -> bytes:
    """A report as written by a child: prefixed by its length, so that `judge_exit` can check completeness."""
    return len(payload).to_bytes(LENGTH_BYTES, "little") + payload


def write_all(handle: int, data: bytes) -> None:
    """Write all data to a pipe, in as many writes as needed."""
    left = memoryview(data)
    while left:
        left = left[os.write(handle, left) :]


def run_in_child(work: Callable[[], bytes], timeout: float = 60.0, attend: Attend | None = None) -> ChildEnd:
    """Run `work`, which returns the report, in a forked child; otherwise as `ForkPoint.split`."""
    point = ForkPoint()
    with point.guard():
        end = point.split(timeout, attend)
        if end is None:
            point.finish(work())
    return end


def _isolate(parent: int) -> None:
    """In the child: it dies with its parent, and has no core dumps, signal wake-ups or timers."""
    ctypes.CDLL(None).prctl(_DIE_WITH_PARENT, signal.SIGKILL, 0, 0, 0)
    if os.getppid() != parent:
        os._exit(_EXCEPTION_EXIT)  # the parent ended before the death signal was set
    gc.freeze()  # inherited objects stay shared: a collection would copy their pages
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    faulthandler.disable()
    signal.set_wakeup_fd(-1)
    signal.setitimer(signal.ITIMER_REAL, 0.0)


def _wait(pid: int, pipe: int, timeout: float) -> ChildEnd:
    """Read the child's output until it exits, or kill it at the timeout."""
    deadline = time.monotonic() + timeout
    data = bytearray()
    is_late = False
    handle = os.pidfd_open(pid)
    try:
        # Read while it runs: a child with a full pipe would wait for us.
        sources = [handle, pipe]
        while True:
            ready, _, _ = select.select(sources, [], [], max(0.0, deadline - time.monotonic()))
            if not ready and time.monotonic() >= deadline:
                is_late = True
                break
            if pipe in ready:
                chunk = os.read(pipe, _CHUNK)
                data += chunk
                if not chunk:
                    sources.remove(pipe)
            elif handle in ready:
                break  # it exited, and the pipe is empty
    finally:
        # Kill it if it still runs, also if this process was interrupted, and leave no zombie.
        if is_late or not select.select([handle], [], [], 0.0)[0]:
            signal.pidfd_send_signal(handle, signal.SIGKILL)
        _, status = os.waitpid(pid, 0)
        os.close(handle)
    if is_late:
        return ChildEnd("hang", detail=WALL_CLOCK)
    return judge_exit(os.waitstatus_to_exitcode(status), bytes(data))


def judge_exit(code: int, data: bytes = b"") -> ChildEnd:
    """How a child ended, from its exit code (negative = signal number) and the data that it wrote to its pipe.

    Raises:
        MachineError: A failure of the machine occurred in the child, or it was killed from outside.
    """
    if code < 0:
        name = _SIGNALS.get(-code, f"signal {-code}")
        if name in FROM_OUTSIDE:
            raise MachineError(f"the process of a flight was killed by {name}")
        return ChildEnd("crash", detail=name)
    if code == HANG_EXIT:
        return ChildEnd("hang", detail="instruction budget")
    if code == WILD_EXIT:
        return ChildEnd("crash", detail=WILD)
    payload = data[LENGTH_BYTES:]
    is_complete = len(data) >= LENGTH_BYTES and int.from_bytes(data[:LENGTH_BYTES], "little") == len(payload)
    if code == 0 and is_complete:
        return ChildEnd("done", payload)
    if code == _MACHINE_EXIT and is_complete:
        raise MachineError(payload.decode(errors="replace"))
    if code == _MACHINE_EXIT:
        raise MachineError("the process of a flight could not report")
    if code == _EXCEPTION_EXIT and is_complete:
        return ChildEnd("exception", detail=payload.decode(errors="replace"))
    return ChildEnd("exception", detail=f"ended with status {code} without a report")
