"""Arguments of calls, copied so that they can be repeated: with the layout that selects the compiled signature."""

import ctypes
import mmap
from collections.abc import Callable
from typing import Any

import numpy as np

_KEPT_BYTES = 1 << 27
"""Most memory of the recorded arguments of one function."""
_SMALL_BYTES = 1 << 16
"""Arrays below this size are copied with the pages of a process at a fork."""
_Allocate = Callable[[int], np.ndarray]


def copied(value: Any, allocate: _Allocate = lambda size: np.empty(size, np.uint8)) -> Any:  # noqa: ANN401 - numbers, arrays and tuples of these
    """A deep copy; arrays keep strides, access and common memory, since Numba compiles by these.

    Args:
        value: What to copy.
        allocate: Allocates so many bytes. Shape of the result (size,).
    """
    return _copied(value, {}, allocate)


def shared(size: int) -> np.ndarray:
    """Memory of which a fork does not copy the page tables: a second per gigabyte and 50 forks."""
    return np.frombuffer(mmap.mmap(-1, size), np.uint8) if size >= _SMALL_BYTES else np.empty(size, np.uint8)


def _copied(value: Any, known: dict[int, tuple[int, np.ndarray]], allocate: _Allocate) -> Any:
    if isinstance(value, tuple):
        parts = [_copied(part, known, allocate) for part in value]
        return type(value)(*parts) if hasattr(value, "_fields") else tuple(parts)
    if not isinstance(value, np.ndarray) or value.dtype.hasobject:
        return value
    root = value
    while isinstance(root.base, np.ndarray):
        root = root.base
    if id(root) not in known:
        known[id(root)] = _memory(root, allocate)
    start, memory = known[id(root)]
    moved: np.ndarray = np.ndarray(value.shape, value.dtype, memory.data, value.ctypes.data - start, value.strides)
    moved.flags.writeable = value.flags.writeable
    return moved


def _memory(root: np.ndarray, allocate: _Allocate) -> tuple[int, np.ndarray]:
    """Lowest address of an array, and a copy of its memory."""
    low, high = np.lib.array_utils.byte_bounds(root) if root.size else (root.ctypes.data, root.ctypes.data)
    memory = allocate(max(high - low, 1))
    ctypes.memmove(memory.ctypes.data, low, high - low)
    return int(low), memory


def size_of(value: Any) -> int:  # noqa: ANN401
    """Bytes of the arrays in a value."""
    if isinstance(value, tuple):
        return sum(map(size_of, value))
    return value.nbytes if isinstance(value, np.ndarray) else 0


class Recording:
    """Arguments of some calls of a function, evenly spread over all of them.

    Attributes:
        total: Number of calls so far.
        kept: Arguments before the call, by its number.

    Args:
        most: At most twice as many calls are kept, fewer if they need more than `_KEPT_BYTES`.
    """

    def __init__(self, most: int = 12) -> None:
        self._most, self._stride = most, 1
        self.total = 0
        self.kept: dict[int, tuple[Any, ...]] = {}

    def note(self, args: tuple[Any, ...]) -> None:
        """Count a call that is about to be made, and keep its arguments if it is its turn."""
        call, self.total = self.total, self.total + 1
        if call % self._stride:
            return
        self.kept[call] = copied(args, shared)
        while len(self.kept) > 1 and (
            len(self.kept) * size_of(args) > _KEPT_BYTES or len(self.kept) > 2 * self._most
        ):  # fmt: skip
            self._stride *= 2
            self.kept = {kept: own for kept, own in self.kept.items() if kept % self._stride == 0}
