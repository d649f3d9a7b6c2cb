"""A plan within a budget of time: golden flights, times of the functions, a greedy choice, and its time as measured.

The budget is a share of the kernel time of a golden flight.  The choice estimates the time of a set of values by their
number of instructions; the machine executes some of them in free slots.  So what was chosen is built and timed, and
the choice made again with a larger or smaller allowance.
"""

from collections import defaultdict
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from time import monotonic

from mavfi.campaign.fingerprint import processor
from mavfi.extras.hardening.choose import Candidates, Value, choose, total_cost, values_of
from mavfi.extras.hardening.compiled import Clock, Timed, compare
from mavfi.extras.hardening.duplicate import candidates, protect
from mavfi.extras.hardening.ledger import CorruptionRates, HardeningLedger
from mavfi.extras.hardening.observed import ObservedFunction, observe
from mavfi.extras.hardening.plan import FunctionKey, FunctionPlan, Kind, ModuleSite, ProtectionPlan
from mavfi.ir.build import KernelSource, environment_of
from mavfi.ir.injection.table import InjectionSite
from mavfi.ir.module import Module
from mavfi.ir.parser import parse_module
from mavfi.ir.sources import cached_source

TIMED_S = 0.5
"""For how long a function and its variants are timed at most (s)."""
_MAX_ROUNDS_PER_S = 400
"""Rounds per second of that time after which timing ends: short functions would have thousands."""
_MAX_CHOICES = 6
"""How often the choice is made with another allowance, at most: its time comes closer to the budget each time."""
_CLOSE = 0.02
"""Share of the budget that may be left: times are not measured better."""
Tell = Callable[[str], None]
"""Receives a line of text when a piece of work begins."""


@dataclass
class Target:
    """A function that may be protected.

    Attributes:
        observed: What golden flights showed.
        addresses: Whether addresses are compared before loads, too: fewer crashes, more time.
        rates: Rates of silent corruption; None = it belongs to a kernel that is not to be protected.
        ticks: Time of all its calls in the golden flights (ticks of the time stamp counter).
        sites: What is duplicated.
        time: Measured time / that of plain code.
    """

    observed: ObservedFunction
    addresses: bool
    rates: CorruptionRates | None
    ticks: float = 0.0
    sites: frozenset[ModuleSite] = frozenset()
    time: float = 1.0
    _times: dict[frozenset[ModuleSite], float] = field(default_factory=dict)

    @cached_property
    def source(self) -> KernelSource:
        """IR as in a fresh process."""
        return cached_source(self.observed.function, self.observed.signature)

    @cached_property
    def module(self) -> Module:
        """The parsed IR."""
        return parse_module(self.source.text, self.observed.key.function)

    @cached_property
    def all_sites(self) -> frozenset[ModuleSite]:
        """Everything that can be duplicated."""
        if self.rates is None:
            return frozenset()
        return frozenset(candidates(self.module))

    @cached_property
    def _blocks(self) -> list[tuple[int, int]]:
        """Function and block, as in a plan, of each block of the table of sites, which has none without sites."""
        functions = enumerate(self.module.functions)
        return [(i, j) for i, function in functions for j, block in enumerate(function.blocks) if block.sites]

    @cached_property
    def values(self) -> list[Value]:
        """Values that can be duplicated, with their executions in the golden flights."""
        executions = dict(zip(self._blocks, map(float, self.observed.executions), strict=True))
        return values_of(self.module, executions, addresses=self.addresses)

    @cached_property
    def rows(self) -> dict[ModuleSite, InjectionSite]:
        """All instructions with a result, by site as in a plan."""
        table = self.observed.variant.table.blocks
        return {
            ModuleSite(*block, row.offset): row for block, rows in zip(self._blocks, table, strict=True) for row in rows
        }

    @cached_property
    def corruptions(self) -> dict[ModuleSite, float]:
        """Silent corruptions by instruction, if each of its executions in the golden flights were changed once."""
        if self.rates is None:
            return {}
        executions = dict(zip(self._blocks, map(int, self.observed.executions), strict=True))
        return {site: executions[site[:2]] * self.rates.of(row) for site, row in self.rows.items()}

    @property
    def removed(self) -> float:
        """Silent corruptions that are removed."""
        return sum(self.corruptions[site] for site in self.sites)

    @property
    def added(self) -> float:
        """Time that is added to the golden flights (ticks)."""
        return self.ticks * (self.time - 1.0)

    def measure(self, sites: frozenset[ModuleSite]) -> float:
        """Time with these sites duplicated / that of plain code, at least 1; sets `ticks`."""
        if not sites and self.ticks:
            return 1.0
        if sites not in self._times:
            ticks, self._times[sites] = self._timed(sites)
            self.ticks = self.ticks or ticks * self.observed.recording.total
        return self._times[sites]

    @cached_property
    def _plain(self) -> Clock:
        """Clock of the plain function."""
        return self._clock(self.module)

    def _clock(self, module: Module) -> Clock:
        """Clock of a variant of the function."""
        environment = environment_of(self.observed.function, self.observed.signature)
        return Timed(self.source, module, environment).ticks

    def _timed(self, sites: Collection[ModuleSite]) -> tuple[float, float]:
        """Ticks of a plain call, and the time of a protected one as a multiple of it."""
        protected = self._clock(protect(self.module, sites, addresses=self.addresses))
        end = monotonic() + TIMED_S

        def is_enough(rounds: int) -> bool:
            return rounds >= _MAX_ROUNDS_PER_S * TIMED_S or monotonic() > end

        timing = compare(self._plain, {"protected": protected}, self.observed.calls, is_enough)
        return timing.ticks, max(timing.ratios["protected"], 1.0)

    def candidates(self) -> Candidates:
        """Its values for the choice; their time is that of full duplication, by instruction."""
        added = self.ticks * (self.measure(self.all_sites) - 1.0)
        executed = {index for index, value in enumerate(self.values) if value.executions}
        benefit = [self.corruptions.get(value.site, 0.0) for value in self.values]
        return Candidates(self.values, benefit, added / max(total_cost(self.values, executed), 1.0))

    def protect(self, sites: frozenset[ModuleSite]) -> None:
        """Duplicate these sites, and measure their time."""
        self.sites = sites
        self.time = self.measure(sites)

    def lines(self) -> tuple[str, ...]:
        """Source lines of what is duplicated, file:line, in order."""
        lines = {(self.rows[site].file, self.rows[site].line) for site in self.sites}
        return tuple(f"{file}:{line}" for file, line in sorted(lines))


@dataclass(frozen=True, slots=True)
class HardenedFlight:
    """What is protected in the flights of a planner.

    Attributes:
        planner: The planner.
        targets: All functions that they call.
        new: Those that flights of earlier planners do not call.
    """

    planner: str
    targets: Sequence[Target]
    new: Sequence[Target]

    @property
    def ticks(self) -> float:
        """Time of all functions (ticks)."""
        return sum(target.ticks for target in self.targets)

    @property
    def added(self) -> float:
        """Time that is added, as a share of it."""
        return sum(target.added for target in self.targets) / self.ticks


def harden(
    ledger: HardeningLedger, budget: float, tell: Tell = lambda _: None, *, addresses: bool = False
) -> list[HardenedFlight]:
    """Choose what to protect, by planner of the missions, that of the campaign first.

    The budget applies to each flight.  What several planners share is chosen for the first of them.

    Args:
        ledger: The ledger.
        budget: Largest share of a flight's kernel time to add.
        tell: Called with each piece of work.
        addresses: See `Target`.

    Raises:
        BadInputError: A mission cannot be flown, or no fault was.
    """
    flights: list[HardenedFlight] = []
    targets: dict[FunctionKey, Target] = {}
    for planner, kernels in ledger.by_planner().items():
        functions = observe(ledger.observed(planner), kernels, tell)
        new = [_target(ledger, function, addresses=addresses) for function in functions if function.key not in targets]
        shared = [targets[function.key] for function in functions if function.key in targets]
        targets |= {target.observed.key: target for target in new}
        for target in new:
            tell(f"timing {target.observed.key.function}")
            target.measure(target.all_sites)
        flight = HardenedFlight(planner, [*shared, *new], new)
        spend(flight, budget, tell)
        flights.append(flight)
    return flights


def _target(ledger: HardeningLedger, observed: ObservedFunction, *, addresses: bool) -> Target:
    """A function as a target, with the rates of the kernels that call it and are to be protected."""
    kernels = [kernel for kernel in observed.kernels if kernel in ledger.kernels]
    rates = None
    if kernels:
        rates = ledger.rates(kernels)
    return Target(observed, addresses, rates)


def spend(flight: HardenedFlight, budget: float, tell: Tell) -> None:
    """Protect the new functions of a flight so that it takes at most a share of its time more.

    If full duplication fits, everything is duplicated, also what no observed mission executed.
    """
    targets = [target for target in flight.new if target.all_sites]
    limit = budget * flight.ticks - sum(target.added for target in flight.targets)

    # Everything, if it fits.
    for target in targets:
        target.protect(target.all_sites)
    if sum(target.added for target in targets) <= limit:
        return

    # Else the best choice that fits; its allowance, an estimate, is corrected by the time that was measured.
    best = [frozenset[ModuleSite]() for _ in targets]
    most_removed = 0.0
    functions = [target.candidates() for target in targets]
    allowance = limit
    for _ in range(_MAX_CHOICES):
        tell(f"choosing in flights with {flight.planner}")
        for target, chosen in zip(targets, choose(functions, allowance), strict=True):
            target.protect(frozenset(target.values[index].site for index in chosen))
        added = sum(target.added for target in targets)
        removed = sum(target.removed for target in targets)
        if added <= limit and removed > most_removed:
            best = [target.sites for target in targets]
            most_removed = removed
        if limit * (1.0 - _CLOSE) <= added <= limit or added <= 0.0:
            break
        allowance *= limit / added
    for target, sites in zip(targets, best, strict=True):
        target.protect(sites)


def removed_share(targets: Sequence[Target]) -> float | None:
    """Share of the silent corruptions in some functions that is removed; None = there are none."""
    total = sum(sum(target.corruptions.values()) for target in targets)
    if not total:
        return None
    return sum(target.removed for target in targets) / total


# ---- the plan -------------------------------------------------------------------------------------------------------


def plan_of(ledger: HardeningLedger, flights: Sequence[HardenedFlight], budget: float) -> ProtectionPlan:
    """The plan; functions that were considered and are not protected have the kind none."""
    ticks_of_kernel: dict[str, float] = defaultdict(float)
    for flight in flights:
        for target in flight.new:
            ticks_of_kernel[target.observed.kernels[0]] += target.ticks
    functions = [
        _planned(target, round(target.ticks / ticks_of_kernel[target.observed.kernels[0]], 4))
        for flight in flights
        for target in flight.new
        if target.rates is not None
    ]
    return ProtectionPlan(cpu=processor(), ledger=ledger.digest, budget=budget, functions=tuple(functions))


def _planned(target: Target, share: float) -> FunctionPlan:
    """The entry of a function in a plan; `share`: its share of the time of its kernel."""
    kind: Kind = "none"
    predicted = None
    if target.sites:
        kind = "duplicate"
        predicted = removed_share([target])
    return FunctionPlan(
        kernel=target.observed.kernels[0],
        function=target.observed.key.function,
        signature=target.observed.key.signature,
        ir_sha256=target.observed.variant.ir_sha256,
        kind=kind,
        addresses=target.addresses,
        sites=tuple(target.sites),
        lines=target.lines(),
        time=round(target.time, 3),
        share=share,
        predicted=None if predicted is None else round(predicted, 3),
    )
