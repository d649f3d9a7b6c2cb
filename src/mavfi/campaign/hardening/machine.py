"""A protected function at machine level: bits of destination registers flipped in one single-stepped call.

The call is executed in plain and in protected machine code, both for any x86-64 processor, and in each of them faults
are drawn over its own instructions.  Outcomes are those of the certificate: only outputs of the function count.
"""

from collections import Counter
from collections.abc import Callable, Collection, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from mavfi.campaign.analysis.statistics import Rate, wilson
from mavfi.campaign.hardening.battery import DETECTED, SDC, Battery, counts_of
from mavfi.campaign.hardening.certify import FunctionResult, Pair
from mavfi.campaign.hardening.observed import Seen
from mavfi.campaign.hardening.outputs import outputs_of
from mavfi.campaign.hardening.ratio import coverage
from mavfi.errors import BadInputError
from mavfi.faults.instruction.api import digest
from mavfi.faults.register.single_step import SteppedCall
from mavfi.faults.register.target import check_machine
from mavfi.faults.sampling import stream
from mavfi.hardening.compiled import Compiled, compiled
from mavfi.hardening.plan import Plan
from mavfi.hardening.protection import Protection
from mavfi.hardening.recorded import copied
from mavfi.hardening.wrapper import MESSAGE

RAYS, POINTS = 24, 3
"""Rays of a point cloud and way-points of a collision check to which long calls are reduced."""
LONGEST = 5_000
"""Dynamic instructions, at IR level, of a call that is single-stepped: about a minute for 400 faults."""


@dataclass(frozen=True, slots=True)
class MachineLevel(FunctionResult):
    """What register faults show of the protection of one function.

    Attributes:
        before: Outcomes in plain code, by number.
        after: The same in protected code.
        sites: Executed instructions with an injectable destination in plain code.
        protected_sites: The same in protected code.
    """

    before: dict[str, int]
    after: dict[str, int]
    sites: int
    protected_sites: int

    def rates(self, *outcomes: str) -> tuple[Rate, Rate]:
        """Share of faults with one of some outcomes, in plain and in protected code, with Wilson's intervals."""
        plain, protected = (
            wilson(sum(counts.get(one, 0) for one in outcomes), sum(counts.values()))
            for counts in (self.before, self.after)
        )
        return plain, protected

    @property
    def coverage(self) -> Rate:
        """Share of the silent corruptions per call that is removed, if each instruction is equally likely to be hit."""
        return coverage(*self.rates(SDC), self.protected_sites / self.sites)

    def to_json(self) -> dict[str, Any]:
        """Plain data."""
        named = {name: self.rates(name) for name in (SDC, "crash", DETECTED)}
        return asdict(self) | {"coverage": asdict(self.coverage)} | {
            f"{name}_{when}": asdict(rate)
            for name, rates in named.items()
            for when, rate in zip(("before", "after"), rates, strict=True)
        }  # fmt: skip


def check_kernel(plan: Plan, kernel: str, studied: Collection[str]) -> None:
    """Raise a BadInputError if a plan duplicates nothing in a studied kernel, or this is not x86-64 Linux."""
    check_machine()
    own = {one.kernel for one in plan.functions if one.sites}.intersection(studied)
    if kernel not in own:
        raise BadInputError(f"--machine: {kernel!r}: allowed: {', '.join(sorted(own)) or 'none'}")


def machine_levels(
    pairs: Sequence[Pair], kernel: str, faults: int, tell: Callable[[str], None], *address: Any
) -> list[MachineLevel]:  # fmt: skip
    """Inject register faults in the functions of a kernel that have a call which is short enough.

    Raises:
        BadInputError: None has.
    """
    found = []
    for pair in pairs:
        args = call_of(pair) if pair.planned.kernel == kernel and pair.planned.sites else None
        if args is not None:
            found.append(_machine_level(pair, args, faults, tell, *address))
    if not found:
        raise BadInputError(f"--machine: {kernel!r}: its calls are too long for single steps; allowed: another kernel")
    return found


def call_of(pair: Pair) -> tuple[Any, ...] | None:
    """Arguments of the longest recorded call that can be single-stepped, reduced where this is known; None = none."""
    seen = pair.seen
    calls = [reduced(seen.entry, args) for args in seen.calls]
    counts = instructions_of(seen, calls)
    able = [place for place, count in enumerate(counts) if count <= LONGEST]
    return calls[max(able, key=lambda place: counts[place])] if able else None


def instructions_of(seen: Seen, calls: Sequence[tuple[Any, ...]]) -> list[int]:
    """Dynamic instructions of calls, at IR level."""
    return [int(count) for count in Battery(seen.entry, seen.function, seen.variant, calls).counts]


def reduced(entry: str, args: tuple[Any, ...]) -> tuple[Any, ...]:
    """A copy of a call's arguments with fewer rays of the point cloud, or fewer points of the path."""
    fewer = args
    if entry == "back_project":
        ranges, directions, rotation, origin, max_range, points = args
        fewer = (ranges[:RAYS], directions[:RAYS], rotation, origin, max_range, points[:RAYS])
    elif entry == "time_to_collision":
        counter, grid, position, points, first, *rest = args
        fewer = (counter, grid, position, points[first : first + POINTS], 0, *rest)
    same: tuple[Any, ...] = copied(fewer)
    return same


def inject_all(call: SteppedCall, random: np.random.Generator, n: int, tell: Callable[[str], None]) -> Counter[str]:
    """Outcomes of n faults at machine level."""
    found: Counter[str] = Counter()
    for fault in call.draw(random, n):
        outcome = call.inject(fault)
        assert outcome.activated  # a missed injection must not count as masked
        found[DETECTED if MESSAGE in outcome.detail else outcome.how] += 1
        tell(f"{found.total()} of {n}")
    return found


def _machine_level(
    pair: Pair, args: tuple[Any, ...], faults: int, tell: Callable[[str], None], *address: Any
) -> MachineLevel:  # fmt: skip
    """Step and inject one call of a function in plain and in protected code."""
    seen, planned = pair.seen, pair.planned
    found = []
    for name, rewrite in (("plain", None), ("protected", Protection(planned))):
        tell(f"flipping {faults} bits of registers in {name} code of {planned.function}")
        code, entry = compiled(seen.function, seen.signature, rewrite)
        call = _stepped(seen.entry, seen.function, code, entry, args)
        random = stream(0, "machine", planned.function, planned.signature, name, *map(str, address))
        outcomes = inject_all(call, random, faults, lambda _: None)
        found.append((counts_of(list(outcomes.elements())), len(call.sites)))
    (before, sites), (after, protected_sites) = found
    return MachineLevel(
        planned.kernel, planned.function, planned.signature, before, after, sites, protected_sites
    )  # fmt: skip


def _stepped(name: str, function: Any, code: Compiled, entry: int, args: tuple[Any, ...]) -> SteppedCall:
    """A call that reports the outputs of a function; `entry` is the address of its code."""
    return SteppedCall(lambda: digest(outputs_of(name, function, code(*args), args)), entry)
