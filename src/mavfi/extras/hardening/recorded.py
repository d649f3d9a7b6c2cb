"""Arguments of calls, copied so that they can be repeated: with the layout that selects the compiled signature."""

import ctypes
import mmap
from collections.abc import Callable
from typing import Any

import numpy as np

_LIBC = ctypes.CDLL(None, use_errno=True)
_KEPT_BYTES = 1 << 27
"""Most memory of the recorded arguments of one function."""
_LARGE_BYTES = 1 << 16
"""Least size of an array that is worth a mapping of its own."""


def copied(value: Any) -> Any:  # noqa: ANN401 - numbers, arrays and tuples of these
    """A deep copy; arrays keep strides, access and common memory, since Numba compiles by these."""
    return _copied(value, {}, _memory)


def kept(value: Any) -> Any:  # noqa: ANN401
    """The same, to be copied again before use: large arrays are in memory that nothing can write.

    Forks share it. They do not copy its page tables, which for all recorded calls takes two thirds of a fork, and a
    fault in one of them cannot reach it.
    """
    return _copied(value, {}, _read_only)


_Memory = Callable[[np.ndarray], tuple[int, np.ndarray]]
"""Lowest address of an array, and a copy of its memory."""


def _copied(value: Any, known: dict[int, tuple[int, np.ndarray]], memory_of: _Memory) -> Any:
    if isinstance(value, tuple):
        parts = [_copied(part, known, memory_of) for part in value]
        return type(value)(*parts) if hasattr(value, "_fields") else tuple(parts)
    if not isinstance(value, np.ndarray) or value.dtype.hasobject:
        return value
    root = value
    while isinstance(root.base, np.ndarray):
        root = root.base
    if id(root) not in known:
        known[id(root)] = memory_of(root)
    start, memory = known[id(root)]
    moved: np.ndarray = np.ndarray(value.shape, value.dtype, memory.data, value.ctypes.data - start, value.strides)
    moved.flags.writeable = value.flags.writeable
    return moved


def _memory(root: np.ndarray) -> tuple[int, np.ndarray]:
    low, size = _extent(root)
    memory = np.empty(max(size, 1), np.uint8)
    ctypes.memmove(memory.ctypes.data, low, size)
    return low, memory


def _read_only(root: np.ndarray) -> tuple[int, np.ndarray]:
    low, size = _extent(root)
    if size < _LARGE_BYTES:
        return _memory(root)
    memory = np.frombuffer(mmap.mmap(-1, size), np.uint8)
    ctypes.memmove(memory.ctypes.data, low, size)
    if _LIBC.mprotect(ctypes.c_void_p(memory.ctypes.data), ctypes.c_size_t(size), mmap.PROT_READ):
        raise OSError(ctypes.get_errno(), "mprotect")
    return low, memory


def _extent(root: np.ndarray) -> tuple[int, int]:
    """Lowest address and size (bytes) of an array's memory."""
    low, high = np.lib.array_utils.byte_bounds(root) if root.size else (root.ctypes.data, root.ctypes.data)
    return int(low), int(high - low)


def same_bits(one: Any, other: Any) -> bool:  # noqa: ANN401
    """Whether numbers, arrays and tuples of these are equal bit for bit, with types and shapes."""
    if type(one) is not type(other):
        return False
    if isinstance(one, tuple | list):
        return len(one) == len(other) and all(map(same_bits, one, other))
    if isinstance(one, np.ndarray):
        return one.dtype == other.dtype and one.shape == other.shape and _same_memory(one, other)
    if isinstance(one, float | complex | np.generic):
        return np.asarray(one).tobytes() == np.asarray(other).tobytes()
    return bool(one == other)


def _same_memory(one: np.ndarray, other: np.ndarray) -> bool:
    left, right = np.ascontiguousarray(one), np.ascontiguousarray(other)
    # without temporary arrays, which large outputs would need
    places = (ctypes.c_void_p(array.ctypes.data) for array in (left, right))
    return int(_LIBC.memcmp(*places, ctypes.c_size_t(left.nbytes))) == 0


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
        self.kept[call] = kept(args)
        while len(self.kept) > 1 and (
            len(self.kept) * size_of(args) > _KEPT_BYTES or len(self.kept) > 2 * self._most
        ):  # fmt: skip
            self._stride *= 2
            self.kept = {number: own for number, own in self.kept.items() if number % self._stride == 0}
