"""Prepares a kernel for a generic x86-64 CPU, in a process without earlier compilations.

LLVM's inlining depends on whether a callee was just compiled or loaded from a cache, and its vectorization on the CPU.
So the IR of a kernel, and with it the digest of its faults, is that of a fresh process with an empty cache and baseline
x86-64 features: it depends on the source and the versions only.

To import the compiler takes a second, often longer than to prepare a kernel.  Each thread of a program has a template,
a process that has imported the compiler and compiled nothing; a fork of it prepares one kernel.
"""

import contextlib
import fcntl
import os
import pickle
import socket
import subprocess
import sys
import tempfile
import threading
import weakref
from functools import reduce
from importlib import import_module
from typing import Any

from mavfi.errors import MachineError
from mavfi.ir.forked import LENGTH_BYTES, ChildEnd, framed, run_in_child

_CPU = {"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": ""}
"""Numba's settings for machine code that runs on any x86-64 processor."""
_IDLE_S = 60.0
"""A template exits after this time without a request."""
_NOT_HERE = b"N"
"""Loaded from a file that is on no path, or compilable only where it has been compiled (recursion in Numba)."""


def run_fresh(kernel: Any, signature: tuple[Any, ...], work: Any, timeout: float) -> ChildEnd | None:
    """Call `work` with a kernel and a signature in a fresh process, for at most `timeout` seconds.

    `work` returns bytes, and can be pickled.

    Returns:
        How the process ended; None if the kernel cannot be prepared there.
    """
    function = kernel.py_func
    address = function.__module__, function.__qualname__
    if _find(*address) is not kernel:
        return None
    try:
        request = pickle.dumps((*address, signature, work))
    except Exception:  # noqa: BLE001 - types of a user may refuse in any way
        return None
    end = _ask(pickle.dumps((timeout, os.getcwd(), dict(os.environ), sys.path, request)))
    if end.payload == _NOT_HERE:
        return None
    return end


def _find(module: str, name: str) -> Any:
    """The object that another process finds under a name, or None."""
    if module == "__main__":
        return None
    with contextlib.suppress(AttributeError, KeyError):
        return reduce(getattr, name.split("."), sys.modules[module])
    return None


# ---- templates, as the program sees them ----------------------------------------------------------------------------
class _Template:
    """A template, started under the present settings, that exits with its last reader."""

    def __init__(self) -> None:
        self._settings = _settings()
        self._channel, theirs = socket.socketpair()
        self._reader = self._channel.makefile("rb")
        self.close = weakref.finalize(self, _close, self._reader, self._channel)
        variables = {
            "NUMBA_CACHE_DIR": os.devnull,
            "PYTHONHASHSEED": "0",
            "PYTHONPATH": os.pathsep.join(filter(None, sys.path)),
            **_CPU,
        }
        with theirs:
            subprocess.run(
                [sys.executable, "-P", "-m", __name__],
                env=os.environ | variables,
                process_group=0,
                stdin=theirs.fileno(),
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                check=False,
            )

    def usable(self) -> bool:
        """Whether its channel is open, and it was started by this process under the present settings."""
        return self.close.alive and self._settings == _settings()

    def ask(self, request: bytes) -> Any:  # noqa: ANN401 - what `_serve` answers
        """The answer; None if the template has exited."""
        try:
            self._channel.sendall(framed(request))
            data = _read(self._reader)
        except ConnectionError:
            data = b""
        except BaseException:
            self.close()  # the answer may still come
            raise
        if data:
            return pickle.loads(data)
        return None


_of_thread = threading.local()
"""The `template` of each thread."""


def _ask(request: bytes) -> ChildEnd:
    """How the fork of this thread's template ended that served the request."""
    for _ in range(2):  # it may have exited after a time without requests
        if not getattr(_of_thread, "template", None) or not _of_thread.template.usable():
            _of_thread.template = _Template()
        answer = _of_thread.template.ask(request)
        if isinstance(answer, ChildEnd):
            return answer
        if answer is not None:
            raise answer
        _of_thread.template = None
    raise MachineError("the process that prepares kernels has ended")


def _settings() -> tuple[object, ...]:
    """What a template inherits and its forks keep."""
    return os.getpid(), sys.executable, *sorted(item for item in os.environ.items() if item[0].startswith("NUMBA_"))


def _close(reader: Any, channel: socket.socket) -> None:
    reader.close()
    channel.close()


def _read(reader: Any) -> bytes:
    """The content of a frame, see `forked.framed`; empty at the end."""
    size = int.from_bytes(reader.read(LENGTH_BYTES), "little")
    return bytes(reader.read(size))


# ---- in the template ------------------------------------------------------------------------------------------------
def main() -> None:
    """Entry point of a template: serve requests until the program exits, or none has come for a while."""
    if os.fork():
        os._exit(0)  # the program has no child to wait for
    channel = socket.socket(fileno=os.dup(0))
    from numba.core.registry import cpu_target

    import mavfi.numerics.jit  # noqa: F401 - for the forks

    cpu_target.typing_context.refresh()
    cpu_target.target_context.refresh()
    channel.settimeout(_IDLE_S)
    with contextlib.suppress(OSError), channel.makefile("rb") as reader:
        while request := _read(reader):
            answer = _serve(channel, *pickle.loads(request))
            channel.sendall(framed(pickle.dumps(answer)))


def _serve(channel: socket.socket, timeout: float, *request: Any) -> ChildEnd | MachineError:  # noqa: ANN401 - `_prepare`
    """How a fork ended that served a request; it ends at once if the program does."""

    def work() -> bytes:
        fcntl.fcntl(channel, fcntl.F_SETOWN, os.getpid())
        flags = fcntl.fcntl(channel, fcntl.F_GETFL)
        fcntl.fcntl(channel, fcntl.F_SETFL, flags | os.O_ASYNC)  # SIGIO at the end of the channel, by default deadly
        return _prepare(folder, *request)

    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        try:
            return run_in_child(work, timeout)
        except MachineError as error:
            return error


def _prepare(folder: str, working_directory: str, variables: dict[str, str], paths: list[str], request: bytes) -> bytes:
    """The result of `work` in this process, under the settings of the program.

    Args:
        folder: For temporary files of this process.
        working_directory: That of the program.
        variables: Environment variables of the program.
        paths: `sys.path` of the program.
        request: Module and name of the kernel, signature and work, pickled.
    """
    import numba

    code = os.path.join(folder, "code")
    os.environ.clear()
    os.environ.update(variables | {"NUMBA_CACHE_DIR": code, "TMPDIR": folder, **_CPU})
    numba.config.CACHE_DIR = code  # type: ignore[attr-defined]
    tempfile.tempdir = None
    os.chdir(working_directory)
    sys.path[:] = paths
    with contextlib.suppress(Exception):
        module, name, signature, work = pickle.loads(request)
        import_module(module)
        return bytes(work(_find(module, name), signature))
    return _NOT_HERE


if __name__ == "__main__":
    main()
