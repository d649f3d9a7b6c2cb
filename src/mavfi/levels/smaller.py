"""Smaller faults, for `mavfi shrink`: what several levels share."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from mavfi.faults.changes import Change
from mavfi.faults.fault import Fault
from mavfi.faults.strata import WORD_BITS
from mavfi.record import Injection

FEWER = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64)
"""Numbers of changed messages that are tried."""


def fewer_changes(fault: Any, change: Change) -> Iterator[Fault]:
    """Faults that change fewer messages or publications than one that lasts, by increasing number."""
    for times in FEWER:
        if change.when.times == 0 or times < change.when.times:
            yield replace(fault, change=change._replace(when=replace(change.when, times=times)))


def smaller_changes(fault: Any, injection: Injection | None) -> Iterator[Fault]:
    """Faults in other bits of the word, of a state or a memory, that change its value less."""
    if fault.bit is None:
        return
    before = None
    if injection is not None:
        before = injection.before
    sizes = {bit: change_of(before, fault.dtype, bit) for bit in range(WORD_BITS[fault.dtype])}
    smaller = [bit for bit, size in sizes.items() if size < sizes[fault.bit]]
    for bit in sorted(smaller, key=lambda bit: sizes[bit]):
        yield replace(fault, bit=bit, stratum="", weight=1.0)


def change_of(before: object, dtype: str, bit: int) -> float:
    """Absolute change of a value by a bit flip; infinite if not finite, the bit's index if the value is unknown."""
    if not isinstance(before, (int, float)):
        return float(bit)
    if dtype == "?":
        dtype = "u1"  # flags have no arithmetic
    size = np.dtype(dtype).itemsize
    word = np.array([before]).astype(dtype)
    flipped = (word.view(f"u{size}") ^ np.array(1 << bit, f"u{size}")).view(word.dtype)
    change = abs(float(flipped[0]) - float(word[0]))
    if np.isfinite(change):
        return change
    return float("inf")
