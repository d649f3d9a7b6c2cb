"""The only place where Numba flags are set.

`fastmath` would remove NaN guards and break replay, the default error model would raise where C++ yields an
infinity, and `parallel` would reorder sums: none of them is available here (see docs/fault-model.md).
"""

from collections.abc import Callable
from typing import TypeVar, cast

from numba import njit

F = TypeVar("F", bound=Callable[..., object])


def kernel_jit(function: F) -> F:
    """Compile a numeric function: cached on disk, IEEE division, no fast math, GIL released.

    Args:
        function: A function of arrays, scalars and named tuples.

    Returns:
        The compiled dispatcher; its pure Python twin is `function.py_func`.
    """
    return cast(F, njit(cache=True, error_model="numpy", fastmath=False, nogil=True)(function))
