"""Candidates for `campaign.shrink`: faults smaller than a given one, by level, smallest first.

`fewer`, `narrower` and `lower` take a fault and the record of its injection (None = not known).
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from mavfi.faults.fault import Fault, InstructionFault, MemoryFault, StateFault
from mavfi.faults.strata import WORD_BITS
from mavfi.record import Injection
from mavfi.states import STATES

_SHORTER = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64)
"""Numbers of corrupted publications to try."""


def can_be_smaller(fault: Fault) -> bool:
    """Whether faults of this level can be reduced."""
    return isinstance(fault, (StateFault, MemoryFault, InstructionFault))


def fewer(fault: Fault, _: Injection | None) -> Iterator[Fault]:
    """Shorter faults for a lasting one: by increasing number of publications, then fractions of its duration."""
    if not isinstance(fault, StateFault) or not fault.lasting:
        return
    once = replace(fault, lasts_s=0.0, share=1.0, times=1)
    yield from (replace(once, times=times) for times in _SHORTER if fault.lasts_s > 0 or times < fault.times)
    if 0 < fault.lasts_s < float("inf"):
        yield from (replace(fault, lasts_s=round(fault.lasts_s * part, 3)) for part in (0.125, 0.25, 0.5))


def narrower(fault: Fault, _: Injection | None) -> Iterator[Fault]:
    """Single-bit faults for a multi-bit one."""
    if isinstance(fault, StateFault) and fault.bit is not None and fault.width > 1:
        yield from (replace(fault, bit=fault.bit + place, width=1) for place in range(fault.width))
    if isinstance(fault, InstructionFault) and len(fault.bits) > 1:
        yield from (replace(fault, bits=(bit,)) for bit in sorted(fault.bits))


def lower(fault: Fault, injection: Injection | None) -> Iterator[Fault]:
    """Faults in other bits of the word that change its value less; for instructions, in less significant bits."""
    if isinstance(fault, InstructionFault):
        yield from (replace(fault, bits=(bit,), stratum="") for bit in range(fault.bit or 0))
    elif isinstance(fault, (StateFault, MemoryFault)) and fault.bit is not None:
        dtype = fault.dtype if isinstance(fault, MemoryFault) else _dtype(fault)
        before = None if injection is None else injection.before
        sizes = {bit: change_of(before, dtype, bit) for bit in range(WORD_BITS[dtype])}
        smaller = [bit for bit, size in sizes.items() if size < sizes[fault.bit]]
        yield from (
            replace(fault, bit=bit, stratum="", weight=1.0) for bit in sorted(smaller, key=lambda bit: sizes[bit])
        )


def _dtype(fault: StateFault) -> str:
    return STATES[fault.where.state].find(fault.where.field).dtype


def change_of(before: object, dtype: str, bit: int) -> float:
    """Absolute change of a value by a bit flip; infinite if not finite, the bit's index if the value is unknown."""
    if not isinstance(before, (int, float)):
        return float(bit)
    size = np.dtype("u1" if dtype == "?" else dtype).itemsize
    word = np.array([before]).astype("u1" if dtype == "?" else dtype)
    flipped = (word.view(f"u{size}") ^ np.array(1 << bit, f"u{size}")).view(word.dtype)
    change = abs(float(flipped[0]) - float(word[0]))
    return change if np.isfinite(change) else float("inf")
