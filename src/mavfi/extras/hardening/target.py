"""A compiled function as target of the choice: its IR, its golden executions, and the injections in its calls."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from mavfi.extras.hardening.choose import Choice, Chooser
from mavfi.extras.hardening.flow import Value, values_of
from mavfi.extras.hardening.learned import Injected, groups_of, rates_of
from mavfi.extras.hardening.observed import Seen
from mavfi.extras.hardening.plan import Site
from mavfi.faults.levels.instruction.table import Site as TableSite
from mavfi.ir.build import Source, name_of
from mavfi.ir.module import Module
from mavfi.ir.parser import parse_module
from mavfi.ir.sources import cached_source

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

    @cached_property
    def name(self) -> str:
        """Module and name, as in a plan."""
        return name_of(self.seen.function)

    @property
    def key(self) -> tuple[str, str]:
        """Name and signature, as in a plan."""
        return self.name, self.seen.signature_text

    @cached_property
    def source(self) -> Source:
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
    def rows(self) -> list[TableSite]:
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
    def masses(self) -> list[tuple[Site, TableSite, int, float]]:
        """All executed sites: as in a plan, row of the table, executions, and expected silent corruptions."""
        rates = rates_of(self.injections, self.seen.variant.table)
        rows = self.seen.variant.table.executions(self.seen.executions)
        return [
            (Site(*self.places[row.block], row.offset), row, times, times * rates.of(groups_of(row)))
            for row, times in rows
            if times
        ]

    def judged(self, choose: Callable[[Chooser], Choice]) -> list[tuple[Injected, bool]]:
        """Silent corruptions, and whether a choice made without them removes them."""
        found = []
        for part, chooser in self._folds:
            chosen = self.sites(choose(chooser))
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
