"""Memory of an injected call: one range of planned addresses, the same in every process and on every machine.

The call receives copies of its arguments in the arena, which also holds its stack frames, constants and new arrays.
From the injection on, each load and store is checked: an access outside the arena ends the call as a crash.  Hence the
effect of a corrupted address does not depend on the other contents of a process.  There is one arena per process: one
instrumented call at a time.
"""

import ctypes
import mmap
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from mavfi.errors import MavfiError

BASE = 1 << 44
"""Far from the addresses that Linux assigns to programs, libraries, heaps and stacks."""
SIZE = 1 << 26
"""`BASE` is a multiple of it: an address with one of its lowest 26 bits flipped stays inside."""
RESULT = BASE
"""Address of the kernel's result, in Numba's wrapper."""
EXCEPTION = BASE + 0x4000
"""Address of the pointer to the kernel's exception, in the wrapper."""
FRAMES = BASE + 0x5000
"""First address of stack frames, which grow upwards to `CONSTANTS`."""
CONSTANTS = BASE + 0x100000
"""First address of the constant arrays that the kernel reads."""
_ARGUMENTS = BASE + SIZE // 2
"""In the middle, so that accesses shortly before and after the arguments are equally possible."""
LINE = 64
"""Size of a cache line (bytes), to which everything in the arena is aligned."""
_NORESERVE = 0x4000  # mmap(2): pages are taken when they are written
_FIXED_NOREPLACE = 0x100000  # mmap(2): fail if the addresses are occupied
_FLAGS = mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS | _NORESERVE | _FIXED_NOREPLACE
_SCALARS = (bool, int, float, complex, np.generic, type(None))
"""Types of arguments that are passed by value, and so need no place."""


class CopiedRange(NamedTuple):
    """A range of memory that is copied into the arena."""

    original: int  # address
    copy: int  # address in the arena
    size: int  # bytes


@dataclass(frozen=True, slots=True)
class PlacedArguments:
    """Arguments in the arena.

    Attributes:
        args: The arguments, with arrays in the arena.
        heap: First free address after them.
        ranges: The copied memory ranges.
    """

    args: tuple[Any, ...]
    heap: int
    ranges: list[CopiedRange]

    def take_back(self) -> None:
        """Copy the arrays, as modified by the call, back to their original addresses."""
        for original, copy, size in self.ranges:
            ctypes.memmove(original, copy, size)


class Arena:
    """The memory, mapped at its fixed address.

    Raises:
        MavfiError: The address range is occupied.
    """

    def __init__(self) -> None:
        library = ctypes.CDLL(None, use_errno=True)
        library.mmap.restype = ctypes.c_void_p
        library.mmap.argtypes = [ctypes.c_void_p, ctypes.c_size_t, *[ctypes.c_int] * 3, ctypes.c_long]
        library.madvise.argtypes = [ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int]
        address = library.mmap(BASE, SIZE, mmap.PROT_READ | mmap.PROT_WRITE, _FLAGS, -1, 0)
        if address != BASE:
            raise MavfiError(f"no memory at address {BASE:#x}: faults in instructions are injected there")
        self._madvise = library.madvise
        self._memory = memoryview((ctypes.c_uint8 * SIZE).from_address(BASE))

    def clear(self) -> None:
        """Fill it with zeros."""
        self._madvise(BASE, SIZE, mmap.MADV_DONTNEED)

    def place(self, args: tuple[Any, ...]) -> PlacedArguments | None:
        """Clear the arena and copy arguments into it, preserving shared memory between arrays.

        Returns:
            None if they contain anything but numbers, numeric arrays and tuples of these, or are too large.
        """
        arrays = list(_arrays(args))
        if any(array is None for array in arrays):
            return None
        ranges, heap = _plan([_bounds(array) for array in arrays])
        if heap > BASE + SIZE * 3 // 4:
            return None
        self.clear()
        for original, copy, size in ranges:
            ctypes.memmove(copy, original, size)
        return PlacedArguments(self._moved(args, ranges), heap, ranges)

    def _moved(self, value: Any, ranges: list[CopiedRange]) -> Any:
        """An argument with its arrays replaced by those in the arena."""
        if isinstance(value, tuple):
            parts = (self._moved(part, ranges) for part in value)
            if hasattr(value, "_fields"):
                return type(value)(*parts)
            return tuple(parts)
        if not isinstance(value, np.ndarray):
            return value
        low, high = _bounds(value)
        target = CopiedRange(low, _ARGUMENTS, 0)  # of an array without elements
        for candidate in ranges:
            if candidate.original <= low and high <= candidate.original + candidate.size:
                target = candidate
                break
        offset = target.copy - BASE + value.ctypes.data - target.original
        moved: np.ndarray = np.ndarray(value.shape, value.dtype, self._memory, offset, value.strides)
        moved.flags.writeable = value.flags.writeable
        return moved


@cache
def arena() -> Arena:
    """The arena of this process; forked children have a copy."""
    return Arena()


def copy_result(value: Any) -> Any:
    """A result with its arrays copied, since the next call reuses the arena."""
    if isinstance(value, tuple):
        parts = (copy_result(part) for part in value)
        if hasattr(value, "_fields"):
            return type(value)(*parts)
        return tuple(parts)
    if isinstance(value, np.ndarray):
        return value.copy()
    return value


def _arrays(value: Any) -> Iterator[Any]:
    """Arrays in arguments; None for anything but arrays, numbers and tuples."""
    if isinstance(value, tuple):
        for part in value:
            yield from _arrays(part)
    elif isinstance(value, np.ndarray) and not value.dtype.hasobject:
        yield value
    elif not isinstance(value, _SCALARS):
        yield None


def _bounds(array: np.ndarray) -> tuple[int, int]:
    """First address and end address of its elements."""
    if array.size:
        low, high = np.lib.array_utils.byte_bounds(array)
    else:
        low = array.ctypes.data
        high = array.ctypes.data
    return int(low), int(high)


def _plan(bounds: list[tuple[int, int]]) -> tuple[list[CopiedRange], int]:
    """The memory ranges of arrays, given their bounds, and the first free address after them in the arena.

    Ranges are in the order of their first array.
    """
    # Arrays that share memory are copied as one range.
    merged: list[list[int]] = []
    for low, high in sorted(pair for pair in bounds if pair[0] < pair[1]):
        if merged and low < merged[-1][1]:
            merged[-1][1] = max(high, merged[-1][1])
        else:
            merged.append([low, high])
    # The order of addresses depends on the process, the order of arguments does not.
    ranges: list[CopiedRange] = []
    free = _ARGUMENTS
    for low, _ in bounds:
        for start, end in merged:
            if start <= low < end and all(start != copied.original for copied in ranges):
                ranges.append(CopiedRange(start, free, end - start))
                free += -(-(end - start) // LINE) * LINE
    return ranges, free
