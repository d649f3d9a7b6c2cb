"""Calls of libraries whose results depend on the processor, in a process with their baseline code paths for x86-64.

NumPy, its BLAS and the C library dispatch by processor: order of summation and fused multiply-add differ.  Iterations
such as training amplify these differences.
"""

import os
import pickle
import subprocess
import sys
from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar

from mavfi.errors import MachineError

BASELINE = {
    "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA,-FMA4,-AVX512F,-AVX512VL,-AVX512DQ",
    "OPENBLAS_CORETYPE": "Nehalem",
    "NPY_DISABLE_CPU_FEATURES": "X86_V3,X86_V4,AVX512_ICL",
}
"""Environment variables that disable FMA and AVX in these libraries."""

P = ParamSpec("P")
R = TypeVar("R")


def call_portably(function: Callable[P, R], *args: P.args, **kwargs: P.kwargs) -> R:
    """The result of an importable function, the same on every x86-64 processor; arguments and result are pickled.

    Raises:
        MachineError: The process ended without a result.
    """
    done = subprocess.run(
        [sys.executable, "-P", "-W", "ignore", "-m", __name__],
        input=pickle.dumps((sys.path, pickle.dumps((function, args, kwargs)))),
        env={**os.environ, **BASELINE},
        capture_output=True,
        check=False,
    )
    if done.returncode != 0:
        reason = done.stderr.decode(errors="replace").strip().rpartition("\n")[2] or f"status {done.returncode}"
        raise MachineError(f"{function.__name__}: its process failed ({reason})")
    result: R = pickle.loads(done.stdout)
    return result


def _answer() -> None:
    paths, call = pickle.load(sys.stdin.buffer)
    sys.path[:] = paths
    function, args, kwargs = pickle.loads(call)
    answer: Any = pickle.dumps(function(*args, **kwargs))
    sys.stdout.buffer.write(answer)


if __name__ == "__main__":
    _answer()
