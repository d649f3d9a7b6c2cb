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

from mavfi.analysis.statistics import MIN_WORLDS, Rate, clustered_rate
from mavfi.extras.hardening.battery import NOT_ACTIVATED, SDC, Battery
from mavfi.extras.hardening.choose import Choice, Chooser, Value, values_of
from mavfi.extras.hardening.observed import ObservedFunction
from mavfi.extras.hardening.plan import FunctionKey, ModuleSite
from mavfi.faults.levels.instruction.table import InjectionSite, SiteTable
from mavfi.faults.sampling import stream
from mavfi.ir.build import KernelSource, name_of
from mavfi.ir.module import Module
from mavfi.ir.parser import parse_module
from mavfi.ir.sources import cached_source

MAX_FAULTS = 400
MIN_FAULTS = 150
"""Bounds of the number of faults per function."""
_MAX_INSTRUCTIONS = 4e8
"""Dynamic instructions that the faults of a function may execute together (some seconds)."""
STRENGTH = 4.0
"""Number of imaginary injections with which the rate of a group is shrunk to that of the next larger group."""
Groups = tuple[Hashable, ...]
"""Groups of a site, from the largest (opcode and type) over line and class to the smallest (the site itself)."""


class Injected(NamedTuple):
    """An activated injection.

    Attributes:
        block: Index of the instruction's block, as in `ModuleSite`.
        offset: Its index in the block.
        sdc: Whether an output of the function was silently corrupted.
        world: What it has in common with others: the mission of the call.
    """

    block: int
    offset: int
    sdc: bool
    world: str


def affordable_faults(battery: Battery) -> int:
    """Number of faults in a function that take some seconds."""
    return int(np.clip(_MAX_INSTRUCTIONS / battery.counts.mean(), MIN_FAULTS, MAX_FAULTS))


def injections_in(seen: ObservedFunction, times: int = 1) -> list[Injected]:
    """Inject `times` as many faults in the recorded calls of a function as take some seconds."""
    battery = Battery(seen.entry, seen.function, seen.variant, seen.calls)
    points = battery.draw(stream(0, "harden", name_of(seen.function)), times * affordable_faults(battery))
    missions = seen.missions
    return [
        Injected(point.block, point.offset, effect == SDC, missions[point.call])
        for point, effect in zip(points, battery.run(points), strict=True)
        if effect != NOT_ACTIVATED
    ]


Injector = Callable[[ObservedFunction], list[Injected]]
"""Injects faults in a function, as `injections_in`."""


class SiteRates:
    """Rates of sites from few injections: there is less than one per site.

    The rate of a group with k successes of n injections is (k + 4 p) / (n + 4), where p is the rate of the next larger
    group: four imaginary injections.

    Args:
        injections: Groups of each injected site, and whether the injection succeeded.
    """

    def __init__(self, injections: Iterable[tuple[Groups, bool]]) -> None:
        self._injections: Counter[Hashable] = Counter()
        self._successes: Counter[Hashable] = Counter()
        for groups, success in injections:
            for group in (None, *groups):  # None: the group of all sites
                self._injections[group] += 1
                self._successes[group] += success

    def of(self, groups: Sequence[Hashable]) -> float:
        """Rate of a site, whether injected or not; 0 without any injection."""
        rate = self._successes[None] / max(self._injections[None], 1)
        for group in groups:
            rate = (self._successes[group] + STRENGTH * rate) / (self._injections[group] + STRENGTH)
        return rate


def groups_of(site: InjectionSite) -> Groups:
    """Groups of a site, from opcode and type over line and value class to the site itself."""
    opcode: Hashable = ("opcode", site.opcode, site.kind)
    return opcode, ("line", site.file, site.line, site.value_class), ("site", site.block, site.offset)


def rates_of(injections: Sequence[Injected], table: SiteTable) -> SiteRates:
    """Rates of silent corruption of a function's sites, from the injections in it."""
    return SiteRates((groups_of(table.blocks[fault.block][fault.offset]), fault.sdc) for fault in injections)


JudgedCorruptions = Sequence[tuple[Injected, bool]]
"""Silent corruptions, and whether they are removed."""
FOLDS = 4
"""Parts of the injections, each of which judges a choice made from the others, with too few missions for one each."""


class SiteMass(NamedTuple):
    """An executed site with its weight in the choice.

    Attributes:
        site: As in a plan.
        row: Its row in the table of sites.
        executions: In the golden flights.
        mass: Expected silent corruptions, if each of these executions were injected once.
    """

    site: ModuleSite
    row: InjectionSite
    executions: int
    mass: float


@dataclass
class FunctionTarget:
    """A function compiled for one signature.

    Attributes:
        kernels: Kernels that call it, as in a campaign's sampling.
        seen: What golden flights showed.
        injections: In recorded calls.
        addresses: Whether addresses are compared before loads, too: fewer crashes, more time.
    """

    kernels: tuple[str, ...]
    seen: ObservedFunction
    injections: list[Injected] = field(default_factory=list)
    addresses: bool = False

    @property
    def key(self) -> FunctionKey:
        """Name and signature, as in a plan."""
        return self.seen.key

    @property
    def name(self) -> str:
        """Module and name, as in a plan."""
        return self.key.function

    @cached_property
    def source(self) -> KernelSource:
        """IR as in a fresh process."""
        return cached_source(self.seen.function, self.seen.signature)

    @cached_property
    def module(self) -> Module:
        """The parsed IR."""
        return parse_module(self.source.text, self.name)

    @cached_property
    def blocks(self) -> list[tuple[int, int]]:
        """Function and block, as in a plan, of each block of the table of sites."""
        blocks = []
        for function_index, function in enumerate(self.module.functions):
            for block_index, block in enumerate(function.blocks):
                if block.sites:  # the table has no blocks without sites
                    blocks.append((function_index, block_index))
        return blocks

    @cached_property
    def values(self) -> list[Value]:
        """Values that can be duplicated, with their executions in the golden flights."""
        return self._values(self.seen.executions)

    def _values(self, executions: np.ndarray) -> list[Value]:
        """Values that can be duplicated, with these executions of blocks. Shape (blocks,)."""
        by_block = dict(zip(self.blocks, map(float, executions), strict=True))
        return values_of(self.module, by_block, addresses=self.addresses)

    @cached_property
    def rows(self) -> list[InjectionSite]:
        """Row of the table of sites for each value."""
        table_index = {block: index for index, block in enumerate(self.blocks)}
        table = self.seen.variant.table.blocks
        return [table[table_index[value.site[:2]]][value.site.offset] for value in self.values]

    def site_of(self, injected: Injected) -> ModuleSite:
        """Site of an injection, as in a plan."""
        return ModuleSite(*self.blocks[injected.block], injected.offset)

    def _chooser(self, values: Sequence[Value], injections: Sequence[Injected]) -> Chooser:
        """Choices by expected silent corruptions, if every execution of the values were injected once."""
        rates = rates_of(injections, self.seen.variant.table)
        values_and_rows = zip(values, self.rows, strict=True)
        return Chooser(values, [value.executions * rates.of(groups_of(row)) for value, row in values_and_rows])

    @property
    def sdc_rate(self) -> Rate:
        """Silent corruptions per injection, in these missions."""
        return clustered_rate(
            [injected.sdc for injected in self.injections], [injected.world for injected in self.injections]
        )

    @property
    def sdc_mass(self) -> float:
        """Expected silent corruptions of the whole function: dynamic instructions x rate of silent corruption."""
        return sum(executed.mass for executed in self.masses)

    @cached_property
    def sdc_mass_by_mission(self) -> dict[str, float]:
        """The same for each mission alone."""
        rates = rates_of(self.injections, self.seen.variant.table)
        masses = {}
        for part in self.seen.parts:
            executions = self.seen.variant.table.executions(part.executions)
            masses[part.mission] = sum(times * rates.of(groups_of(row)) for row, times in executions)
        return masses

    @cached_property
    def chooser(self) -> Chooser:
        """Choices from all injections."""
        return self._chooser(self.values, self.injections)

    @cached_property
    def _folds(self) -> list[tuple[list[Injected], Chooser]]:
        """Parts of the injections, each with the choices that are made without them.

        A part is a mission: neither its faults nor its executions are known to the choice that it judges.
        """
        if len(self.seen.parts) < MIN_WORLDS:
            return self._folds_by_number()
        folds = []
        for part in self.seen.parts:
            judging = [injected for injected in self.injections if injected.world == part.mission]
            others = [injected for injected in self.injections if injected.world != part.mission]
            if judging:
                values = self._values(self.seen.executions - part.executions)
                folds.append((judging, self._chooser(values, others)))
        return folds

    def _folds_by_number(self) -> list[tuple[list[Injected], Chooser]]:
        """The same without regard to missions: they rank choices, but predict nothing."""
        folds = []
        for number in range(FOLDS):
            others = [injected for n, injected in enumerate(self.injections) if n % FOLDS != number]
            folds.append((self.injections[number::FOLDS], self._chooser(self.values, others)))
        return folds

    @property
    def unseen_lines(self) -> dict[str, list[int]]:
        """Source lines without an instruction that any mission executed, by file, ascending."""
        seen = set()
        unseen = set()
        for row, executions in self.seen.variant.table.executions(self.seen.executions):
            if executions:
                seen.add((row.file, row.line))
            else:
                unseen.add((row.file, row.line))
        by_file: dict[str, list[int]] = {}
        for file, line in sorted(unseen - seen):
            if line:  # 0: the compiler does not say
                by_file.setdefault(file, []).append(line)
        return by_file

    @cached_property
    def masses(self) -> list[SiteMass]:
        """All executed sites with their expected silent corruptions."""
        table = self.seen.variant.table
        rates = rates_of(self.injections, table)
        masses = []
        for row, executions in table.executions(self.seen.executions):
            if executions:
                site = ModuleSite(*self.blocks[row.block], row.offset)
                masses.append(SiteMass(site, row, executions, executions * rates.of(groups_of(row))))
        return masses

    def judged(self, fraction: float) -> list[tuple[Injected, bool]]:
        """Silent corruptions, and whether a choice made without them removes them; see `Chooser.share`."""
        judged = []
        for part, chooser in self._folds:
            chosen = self.sites(chooser.share(fraction))
            judged += [(injected, self.site_of(injected) in chosen) for injected in part if injected.sdc]
        return judged

    def sites(self, choice: Choice) -> frozenset[ModuleSite]:
        """Sites of a choice, as in a plan."""
        return frozenset(self.values[index].site for index in choice.chosen)

    def lines(self, sites: Collection[ModuleSite]) -> tuple[str, ...]:
        """Source lines of sites, file:line, in order."""
        values_and_rows = zip(self.values, self.rows, strict=True)
        lines = {(row.file, row.line) for value, row in values_and_rows if value.site in sites}
        return tuple(f"{file}:{line}" for file, line in sorted(lines))


def targets_of(seen: Mapping[str, Sequence[ObservedFunction]], *, addresses: bool = False) -> list[FunctionTarget]:
    """Targets by function and signature; `addresses` as in `FunctionTarget`."""
    targets: dict[tuple[str, str], FunctionTarget] = {}
    for kernel, functions in seen.items():
        for function in functions:
            key = function.entry, function.variant.ir_sha256
            if key in targets:  # several kernels call it
                targets[key].kernels = (*targets[key].kernels, kernel)
            else:
                targets[key] = FunctionTarget((kernel,), function, addresses=addresses)
    return list(targets.values())
