"""Starts a program with fixed addresses, so that faults in addresses can be replayed too.

The memory at a corrupted address is the same in two processes only if nothing is placed at random.  Faults in data need
none of this.
"""

import contextlib
import ctypes
import resource
import sys
from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")

_NO_RANDOMIZE = 0x0040000  # ADDR_NO_RANDOMIZE, personality(2)
_QUERY = 0xFFFFFFFF
_STACK = 8 << 20


def addresses_are_fixed() -> bool:
    """Whether neither addresses nor hashes of this process are random."""
    return _personality() & _NO_RANDOMIZE != 0 and not sys.flags.hash_randomization


def with_fixed_addresses(start: Callable[[], T]) -> T:
    """Start a program with fixed addresses; where that is not allowed, with random ones.

    `start` does it from this thread, with the environment variable `PYTHONHASHSEED` set.
    """
    before, stack = _personality(), resource.getrlimit(resource.RLIMIT_STACK)
    _personality(before | _NO_RANDOMIZE)
    with contextlib.suppress(ValueError):  # libraries lie below the room that the stack may take
        resource.setrlimit(resource.RLIMIT_STACK, (_STACK, stack[1]))
    try:
        return start()
    finally:
        resource.setrlimit(resource.RLIMIT_STACK, stack)
        _personality(before)


def _personality(wanted: int = _QUERY) -> int:
    return int(ctypes.CDLL(None).personality(ctypes.c_ulong(wanted)))
