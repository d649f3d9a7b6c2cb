"""Faults from which a choice is made: injected in recorded calls, and judged by the outputs of the function.

A ledger judges what a kernel publishes and keeps, not the outputs of one function, and its snapshots of a clearance map
omit the counters.  Choice, prediction and certificate must count the same event, so all of them use `Battery`.
"""

from collections import Counter
from collections.abc import Callable, Hashable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from mavfi.extras.hardening.battery import NOT_ACTIVATED, SDC, Battery
from mavfi.extras.hardening.observed import Seen
from mavfi.faults.levels.instruction.table import Site, Table
from mavfi.faults.sampling import stream
from mavfi.ir.build import name_of

MOST, FEWEST = 400, 150
"""Faults per function."""
_WORK = 4e8
"""Dynamic instructions that the faults of a function may execute (some seconds)."""
STRENGTH = 4.0
"""Number of imaginary injections with which the rate of a group is shrunk to that of the next larger group."""
Groups = tuple[Hashable, ...]
"""Groups of a site, from the largest (opcode and type) over line and class to the smallest (the site itself)."""


@dataclass(frozen=True, slots=True)
class Injected:
    """An activated injection.

    Attributes:
        block: Index of the instruction's block, as in `Site`.
        offset: Its index in the block.
        sdc: Whether an output of the function was silently corrupted.
        world: What it has in common with others: the call.
    """

    block: int
    offset: int
    sdc: bool
    world: str


def affordable(battery: Battery) -> int:
    """Number of faults that take some seconds."""
    return int(np.clip(_WORK / battery.counts.mean(), FEWEST, MOST))


def injections_in(seen: Seen, faults: int | None = None, seed: int = 0, times: int = 1) -> list[Injected]:
    """Inject faults in the recorded calls of a function: by default `times` those that take some seconds."""
    battery = Battery(seen.entry, seen.function, seen.variant, seen.calls)
    places = battery.draw(stream(seed, "harden", name_of(seen.function)), faults or times * affordable(battery))
    return [
        Injected(place.block, place.offset, effect == SDC, str(place.call))
        for place, effect in zip(places, battery.run(places), strict=True)
        if effect != NOT_ACTIVATED
    ]


Learn = Callable[[Seen], list[Injected]]
"""Injects faults in a function, as `injections_in`."""


class Rates:
    """Rates of sites from few injections: there is less than one per site.

    The rate of a group with k successes of n injections is (k + 4 p) / (n + 4), where p is the rate of the next larger
    group: four imaginary injections.

    Args:
        injections: Groups of each injected site, and whether the injection succeeded.
    """

    def __init__(self, injections: Iterable[tuple[Groups, bool]]) -> None:
        self._n: Counter[Hashable] = Counter()
        self._k: Counter[Hashable] = Counter()
        for groups, success in injections:
            for group in (None, *groups):
                self._n[group] += 1
                self._k[group] += success

    def of(self, groups: Sequence[Hashable]) -> float:
        """Rate of a site, whether injected or not; 0 without any injection."""
        rate = self._k[None] / max(self._n[None], 1)
        for group in groups:
            rate = (self._k[group] + STRENGTH * rate) / (self._n[group] + STRENGTH)
        return rate


def groups_of(site: Site) -> Groups:
    """Groups of a site, from opcode and type over line and value class to the site itself."""
    opcode: Hashable = ("opcode", site.opcode, site.kind)
    return opcode, ("line", site.file, site.line, site.value_class), ("site", site.block, site.offset)


def rates_of(injections: Sequence[Injected], table: Table) -> Rates:
    """Rates of silent corruption of a function's sites, from the injections in it."""
    return Rates((groups_of(table.blocks[one.block][one.offset]), one.sdc) for one in injections)
