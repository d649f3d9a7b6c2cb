"""A worker process in a new interpreter: Dask's workers have threads and sockets, and must not fork.

Run as `python -m mavfi.extras.dask.worker HANDLE PARENT`, with the handle of its end of the pipe and its parent's id.
"""

import contextlib
import gc
import multiprocessing
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from multiprocessing.connection import Connection
from typing import Any

from mavfi.campaign.executors.process import Raised, Worker, ends_with, work
from mavfi.errors import MavfiError


class _StartedProcess:
    """A started process with the interface of a forked one."""

    def __init__(self, process: "subprocess.Popen[bytes]") -> None:
        self._process = process
        self.terminate = process.terminate
        self.kill = process.kill

    def is_alive(self) -> bool:
        return self._process.poll() is None

    def join(self, timeout: float | None = None) -> None:
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(timeout)

    @property
    def exitcode(self) -> int | None:
        return self._process.returncode


def start_worker(function: Callable[[Any], Iterator[Any]]) -> Worker[Any]:
    """Start a worker that calls a function, which it imports, for each mission."""
    pipe, theirs = multiprocessing.Pipe()
    command = [sys.executable, "-m", __name__, str(theirs.fileno()), str(os.getpid())]
    process = subprocess.Popen(command, stdin=subprocess.DEVNULL, pass_fds=[theirs.fileno()])
    theirs.close()
    with contextlib.suppress(OSError):
        pipe.send(function)
    return Worker(_StartedProcess(process), pipe)


def main(handle: int, parent: int) -> None:
    """Main function of the worker."""
    if not ends_with(parent):
        return
    pipe = Connection(handle)
    with contextlib.suppress(EOFError, OSError):
        try:
            function = pipe.recv()  # imports its module: seconds
        except (AttributeError, ImportError) as error:
            pipe.recv_bytes()
            pipe.send(Raised(MavfiError(f"workers cannot import what they should call: {error}")))
            return
        gc.freeze()  # modules would take 0.1 s of the collection after each mission
        work(pipe, function)


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]))
