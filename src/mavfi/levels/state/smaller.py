"""Smaller faults in states, for `mavfi shrink`."""

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations

from mavfi.faults.fault import Fault
from mavfi.levels.smaller import FEWER, fewer_changes
from mavfi.levels.state.fault import StateFault
from mavfi.record import Injection

_SHORTER_PARTS = (0.125, 0.25, 0.5)
"""Parts of a fault's duration that `shorter_faults` tries."""


def fewer_fields(fault: StateFault, _: Injection | None) -> Iterator[Fault]:
    """Faults in fewer fields for one in several: in each field alone, then in two of them, and so on."""
    if fault.bit is None:
        return
    flips = [(fault.where.field, fault.bit), *fault.also]
    for count in range(1, len(flips)):
        for (name, bit), *others in combinations(flips, count):
            where = replace(fault.where, field=name)
            yield replace(fault, where=where, bit=bit, also=tuple(others), stratum="", weight=1.0)


def shorter_faults(fault: StateFault, _: Injection | None) -> Iterator[Fault]:
    """Shorter faults for a lasting one: by increasing number of publications, then fractions of its duration."""
    if not fault.lasting:
        return
    if fault.change is not None:
        yield from fewer_changes(fault, fault.change)
        return
    once = replace(fault, lasts_s=0.0, share=1.0, times=1)
    for times in FEWER:
        if fault.lasts_s > 0 or times < fault.times:
            yield replace(once, times=times)
    if 0 < fault.lasts_s < float("inf"):
        for part in _SHORTER_PARTS:
            yield replace(fault, lasts_s=round(fault.lasts_s * part, 3))


def single_bit_faults(fault: StateFault, _: Injection | None) -> Iterator[Fault]:
    """Single-bit faults for a multi-bit one."""
    if fault.bit is not None and fault.width > 1:
        for offset in range(fault.width):
            yield replace(fault, bit=fault.bit + offset, width=1)
