"""Functions as targets of the choice, and the faults from which it is made.

These are injected in recorded calls, and judged by the outputs of the function.
A ledger judges what a kernel publishes and keeps, not the outputs of one function, and its snapshots of a clearance map
omit the counters.  Choice, prediction and certificate must count the same event, so all of them use `Battery`.
"""

from collections import Counter
from collections.abc import Callable, Collection, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np

from mavfi.extras.hardening.battery import NOT_ACTIVATED, SDC, Battery
from mavfi.extras.hardening.choose import Choice, Chooser, Value, values_of
from mavfi.extras.hardening.observed import Seen
from mavfi.extras.hardening.plan import Site
from mavfi.faults.levels.instruction.table import InjectionSite, SiteTable
from mavfi.faults.sampling import stream
from mavfi.ir.build import KernelSource, name_of
from mavfi.ir.module import Module
from mavfi.ir.parser import parse_module
from mavfi.ir.sources import cached_source

MOST = 400
FEWEST = 150
"""Faults per function."""
_WORK = 4e8
"""Dynamic instructions that the faults of a function may execute (some seconds)."""
STRENGTH = 4.0
"""Number of imaginary injections with which the rate of a group is shrunk to that of the next larger group."""
Groups = tuple[Hashable, ...]
"""Groups of a site, from the largest (opcode and type) over line and class to the smallest (the site itself)."""


class Injected(NamedTuple):
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


def injections_in(seen: Seen, times: int = 1) -> list[Injected]:
    """Inject faults in the recorded calls of a function: `times` those that take some seconds."""
    battery = Battery(seen.entry, seen.function, seen.variant, seen.calls)
    places = battery.draw(stream(0, "harden", name_of(seen.function)), times * affordable(battery))
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


def groups_of(site: InjectionSite) -> Groups:
    """Groups of a site, from opcode and type over line and value class to the site itself."""
    opcode: Hashable = ("opcode", site.opcode, site.kind)
    return opcode, ("line", site.file, site.line, site.value_class), ("site", site.block, site.offset)


def rates_of(injections: Sequence[Injected], table: SiteTable) -> Rates:
    """Rates of silent corruption of a function's sites, from the injections in it."""
    return Rates((groups_of(table.blocks[one.block][one.offset]), one.sdc) for one in injections)


Judged = Sequence[tuple[Injected, bool]]
"""Silent corruptions, and whether they are removed."""
FOLDS = 4
"""Parts of the injections, each of which judges a choice made from the others."""


@dataclass
class Target:
    """A function compiled for one signature.

    Attributes:
        kernels: Kernels that call it, as in a campaign's sampling.
        seen: What golden flights showed.
        injections: In recorded calls.
        addresses: Whether addresses are compared before loads, too: fewer crashes, more time.
    """

    kernels: tuple[str, ...]
    seen: Seen
    injections: list[Injected] = field(default_factory=list)
    addresses: bool = False

    @property
    def key(self) -> tuple[str, str]:
        """Name and signature, as in a plan."""
        return self.seen.key

    @property
    def name(self) -> str:
        """Module and name, as in a plan."""
        return self.key[0]

    @cached_property
    def source(self) -> KernelSource:
        """IR as in a fresh process."""
        return cached_source(self.seen.function, self.seen.signature)

    @cached_property
    def module(self) -> Module:
        """The parsed IR."""
        return parse_module(self.source.text, self.name)

    @cached_property
    def places(self) -> list[tuple[int, int]]:
        """Function and block, as in a plan, of each block of the table of sites."""
        return [
            (number, place)
            for number, function in enumerate(self.module.functions)
            for place, block in enumerate(function.blocks)
            if block.sites
        ]

    @cached_property
    def values(self) -> list[Value]:
        """Values that can be duplicated, with their executions in the golden flight."""
        executions = dict(zip(self.places, map(float, self.seen.executions), strict=True))
        return values_of(self.module, executions, addresses=self.addresses)

    @cached_property
    def rows(self) -> list[InjectionSite]:
        """Row of the table of sites for each value."""
        block = {place: number for number, place in enumerate(self.places)}
        table = self.seen.variant.table.blocks
        return [table[block[value.site[:2]]][value.site.offset] for value in self.values]

    def site_of(self, injected: Injected) -> Site:
        """Site of an injection, as in a plan."""
        return Site(*self.places[injected.block], injected.offset)

    def benefit(self, injections: Sequence[Injected]) -> np.ndarray:
        """Expected silent corruptions of each value, if every dynamic instruction of the flight were injected once."""
        rates = rates_of(injections, self.seen.variant.table)
        return np.array([v.executions * rates.of(groups_of(r)) for v, r in zip(self.values, self.rows, strict=True)])

    @property
    def sdc_mass(self) -> float:
        """Expected silent corruptions of the whole function: dynamic instructions x rate of silent corruption."""
        return sum(mass for *_, mass in self.masses)

    @cached_property
    def chooser(self) -> Chooser:
        """Choices from all injections."""
        return Chooser(self.values, self.benefit(self.injections))

    @cached_property
    def _folds(self) -> list[tuple[list[Injected], Chooser]]:
        """Parts of the injections, by call, each with the choices from all others."""
        worlds = sorted({one.world for one in self.injections})
        parts: list[list[Injected]] = [[] for _ in range(FOLDS)]
        for number, one in enumerate(self.injections):
            parts[(worlds.index(one.world) if len(worlds) >= FOLDS else number) % FOLDS].append(one)
        rest = [[one for other in parts if other is not part for one in other] for part in parts]
        return [(part, Chooser(self.values, self.benefit(own))) for part, own in zip(parts, rest, strict=True) if part]

    @cached_property
    def masses(self) -> list[tuple[Site, InjectionSite, int, float]]:
        """All executed sites: as in a plan, row of the table, executions, and expected silent corruptions."""
        rates = rates_of(self.injections, self.seen.variant.table)
        rows = self.seen.variant.table.executions(self.seen.executions)
        return [
            (Site(*self.places[row.block], row.offset), row, times, times * rates.of(groups_of(row)))
            for row, times in rows
            if times
        ]

    def judged(self, fraction: float) -> list[tuple[Injected, bool]]:
        """Silent corruptions, and whether a choice made without them removes them; see `Chooser.share`."""
        found = []
        for part, chooser in self._folds:
            chosen = self.sites(chooser.share(fraction))
            found += [(one, self.site_of(one) in chosen) for one in part if one.sdc]
        return found

    def sites(self, choice: Choice) -> frozenset[Site]:
        """Sites of a choice, as in a plan."""
        return frozenset(self.values[index].site for index in choice.chosen)

    def lines(self, sites: Collection[Site]) -> tuple[str, ...]:
        """Source lines of sites, file:line, in order."""
        own = {(row.file, row.line) for value, row in zip(self.values, self.rows, strict=True) if value.site in sites}
        return tuple(f"{file}:{line}" for file, line in sorted(own))


def targets_of(seen: Mapping[str, Sequence[Seen]], *, addresses: bool = False) -> list[Target]:
    """Targets by function and signature; `addresses` as in `Target`."""
    found: dict[tuple[str, str], Target] = {}
    for kernel, functions in seen.items():
        for one in functions:
            key = one.entry, one.variant.ir_sha256
            if key in found:
                found[key].kernels = (*found[key].kernels, kernel)
            else:
                found[key] = Target((kernel,), one, addresses=addresses)
    return list(found.values())
