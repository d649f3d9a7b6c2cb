"""Prepares a kernel for a generic x86-64 CPU, in a process without earlier compilations.

LLVM's inlining depends on whether a callee was just compiled or loaded from a cache, and its vectorization on the CPU.
So the IR of a kernel, and with it the digest of its faults, is that of a fresh process with an empty cache and baseline
x86-64 features: it depends on the source and the versions only.
"""

import contextlib
import os
import pickle
import subprocess
import sys
import tempfile
from functools import reduce
from importlib import import_module
from typing import Any

from mavfi.ir.forked import Ended, framed, judge_exit, write_all

_CPU = {"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": ""}
_NOT_HERE = b"N"
"""Loaded from a file that is on no path, or compilable only where it has been compiled (recursion in Numba)."""


def run_fresh(kernel: Any, signature: tuple[Any, ...], make: Any, timeout: float) -> Ended | None:
    """Run `build.answer` with `make` in a fresh process, for at most `timeout` seconds.

    Returns:
        How the process ended; None if the kernel cannot be prepared there.
    """
    function = kernel.py_func
    address = function.__module__, function.__qualname__
    if _find(*address) is not kernel:
        return None
    try:
        request = pickle.dumps((sys.path, *address, signature, make))
    except Exception:  # noqa: BLE001 - types of a user may refuse in any way
        return None
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        own = {
            "NUMBA_CACHE_DIR": os.path.join(folder, "code"), "TMPDIR": folder, "PYTHONHASHSEED": "0",
            "PYTHONPATH": os.pathsep.join(filter(None, sys.path)), **_CPU,
        }  # fmt: skip
        process = subprocess.Popen(
            [sys.executable, "-P", "-m", __name__],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
            env=os.environ | own,
        )  # fmt: skip
        try:
            data, _ = process.communicate(request, timeout)
        except subprocess.TimeoutExpired:
            return Ended("hang", detail="wall clock")
        finally:
            process.kill()
            process.wait()
    ended = judge_exit(process.returncode, data)
    return None if ended.payload == _NOT_HERE else ended


def surroundings(function: Any) -> dict[str, Any]:
    """Values that a function takes from enclosing scopes and from its module, by name."""
    cells = zip(function.__code__.co_freevars, function.__closure__ or (), strict=True)
    named = {name: function.__globals__[name] for name in function.__code__.co_names if name in function.__globals__}
    return {name: cell.cell_contents for name, cell in cells} | named


def _find(module: str, name: str) -> Any:
    """The object that another process finds under a name, or None."""
    if module == "__main__":
        return None
    with contextlib.suppress(AttributeError, KeyError):
        return reduce(getattr, name.split("."), sys.modules[module])
    return None


def main() -> None:
    """Entry point of the fresh process: read the request, write the answer."""
    from mavfi.ir.build import answer

    answers = os.dup(1)
    os.dup2(2, 1)  # keep prints out of the answer
    paths, module, name, signature, make = pickle.loads(sys.stdin.buffer.read())
    sys.path[:] = paths
    result = _NOT_HERE
    with contextlib.suppress(Exception):
        import_module(module)
        result = answer(make, _find(module, name), signature)
    write_all(answers, framed(result))


if __name__ == "__main__":
    main()
