"""Twins of kernels: they stand in the place of a compiled function during a flight, and count, resolve or strike.

A flight calls a kernel many times.  Within a kernel faults are uniform over the dynamic instructions of all calls, so a
counting flight comes first: `Counting` gives the counts, `choose` draws call and index with their weights.
"""

from bisect import bisect_right
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from mavfi.errors import BadInputError
from mavfi.faults.instruction.api import budget_for, check_fault
from mavfi.faults.instruction.build import name_of
from mavfi.faults.instruction.fault import InstructionFault, Model, Strike, plan, strike_of
from mavfi.faults.instruction.selection import parse_selection
from mavfi.faults.instruction.table import Site, Table
from mavfi.faults.instruction.variant import Passes, variant_for


class Counting:
    """Counts the instructions of every call.

    Attributes:
        counts: Values that each call wrote.
        digests: Digest of the IR that each call ran.
    """

    def __init__(self, kernel: Any) -> None:
        self._kernel = kernel
        self.counts: list[int] = []
        self.digests: list[str] = []

    def __call__(self, *args: Any) -> Any:
        """As the kernel, bit for bit."""
        variant = variant_for(self._kernel, args)
        result, total = variant.count(*args)
        self.counts.append(total)
        self.digests.append(variant.ir_sha256)
        return result


class Profiling(Counting):
    """Counts the instructions of every call, and how often each static one was executed in all calls."""

    def __init__(self, kernel: Any) -> None:
        super().__init__(kernel)
        self._times: dict[str, tuple[Table, np.ndarray]] = {}

    def __call__(self, *args: Any) -> Any:
        """As the kernel, bit for bit."""
        variant = variant_for(self._kernel, args)
        result, times, _ = variant.profile(*args)
        self.counts.append(int(times @ np.array(variant.table.sizes(), np.int64)))
        self.digests.append(variant.ir_sha256)
        _, total = self._times.setdefault(variant.ir_sha256, (variant.table, np.zeros_like(times)))
        total += times
        return result

    def blocks(self) -> dict[str, tuple[Table, np.ndarray]]:
        """By digest of the IR that was run: its sites, and how often each block was executed in all calls."""
        return dict(self._times)

    def sites(self) -> list[tuple[Site, int]]:
        """All static instructions that were executed, and how often."""
        return [
            (site, int(times))
            for table, total in self._times.values()
            for block, times in zip(table.blocks, total, strict=True)
            if times
            for site in block
        ]


class Locating:
    """Finds out in which call, and at which index in it, the drawn passes through blocks begin."""

    def __init__(self, kernel: Any, wanted: Mapping[str, Sequence[tuple[int, int]]]) -> None:
        """A twin that locates.

        Args:
            kernel: The compiled function.
            wanted: By digest of the IR: block, and which of its executions in all calls, from 0.
        """
        self._kernel = kernel
        self._wanted = wanted
        self._passes: dict[str, Passes] = {}
        self._calls = 0

    def __call__(self, *args: Any) -> Any:
        """As the kernel, bit for bit."""
        call, self._calls = self._calls, self._calls + 1
        variant = variant_for(self._kernel, args)
        digest = variant.ir_sha256
        if digest not in self._wanted:
            return self._kernel(*args)
        if digest not in self._passes:
            self._passes[digest] = Passes(len(variant.table.blocks), self._wanted[digest])
        result = variant.locate(self._passes[digest], *args)
        self._passes[digest].close_call(call)
        return result

    def place(self, digest: str, block: int, number: int) -> tuple[int, int]:
        """Call, and dynamic index in it at which a wanted pass begins."""
        passes = self._passes[digest]
        return passes.call(block, number), passes.start(block, number)


class Resolving:
    """Finds out what the drawn instructions are.

    Attributes:
        sites: Static instruction by call and index.
    """

    def __init__(self, kernel: Any, wanted: Mapping[int, Sequence[int]]) -> None:
        self._kernel = kernel
        self._wanted = wanted
        self._calls = 0
        self.sites: dict[tuple[int, int], Site | None] = {}

    @property
    def done(self) -> bool:
        """Whether the last call of which something is wanted has been made."""
        return self._calls > max(self._wanted, default=-1)

    def __call__(self, *args: Any) -> Any:
        """As the kernel, bit for bit."""
        call, self._calls = self._calls, self._calls + 1
        indices = self._wanted.get(call)
        if not indices:
            return self._kernel(*args)
        result, sites = variant_for(self._kernel, args).resolve(indices, *args)
        self.sites.update({(call, index): site for index, site in zip(indices, sites, strict=True)})
        return result


class Injecting:
    """Runs the kernel as it is, but for the struck call.

    Attributes:
        calls: How many there were.
    """

    def __init__(self, kernel: Any, fault: InstructionFault, before: Callable[[], bool] | None = None) -> None:
        """A twin that strikes.

        Args:
            kernel: The compiled function.
            fault: What to strike; its budget must be set.
            before: Called just before the strike, e.g. to fork; the strike takes place where it answers True, in
                other processes the call is an ordinary one.

        Raises:
            BadInputError: The fault has no budget.
        """
        if fault.budget == 0:
            raise BadInputError(f"fault in {fault.kernel}: budget 0; allowed: what `budget_for` gives for the count")
        self._kernel = kernel
        self._fault = fault
        self._before = before
        self.calls = 0
        self._variant: Any = None

    def __call__(self, *args: Any) -> Any:
        """As the kernel; once with the fault.

        Raises:
            MismatchError: The fault belongs to other machine code.
        """
        call, self.calls = self.calls, self.calls + 1
        if call != self._fault.call:
            return self._kernel(*args)
        self._variant = variant_for(self._kernel, args)
        check_fault(self._fault, self._variant, self._kernel)
        self._variant.own_report()
        if self._before is not None and not self._before():
            return self._kernel(*args)
        fault = self._fault
        return self._variant.inject(fault.index, *fault.masks, fault.budget, *args)

    def strike(self) -> Strike:
        """What the fault did, here or in a forked child."""
        return strike_of(self._fault, None if self._variant is None else self._variant.report())


def plan_flight(
    random: np.random.Generator, kernel: Any, counting: Counting, resolving: Resolving,
    places: Sequence[tuple[int, int]], n: int, which: str = "all", model: Model = "one_bit",
) -> list[InstructionFault]:  # fmt: skip
    """Faults for a flight, from a counting and a resolving one.

    Args:
        random: Stream of the faults.
        kernel: The compiled function.
        counting: Its counts.
        resolving: Its sites at all the places.
        places: Call and index, drawn by `choose`; more than `n` where not all instructions are wanted.
        n: How many faults; fewer come where too few places are of the class.
        which: Class of instructions, see `mavfi.faults.instruction.selection`.
        model: "one_bit", "bits", "random" or "zero".

    Raises:
        BadInputError: There is no such class or model.
    """
    selection = parse_selection(which)
    drawn = [(call, index, resolving.sites[call, index]) for call, index in places]
    wanted = [(call, index, site) for call, index, site in drawn if site is not None and site in selection]
    return [
        replace(
            plan(random, name_of(kernel), counting.digests[call], site, index, model),
            call=call, which=which, budget=budget_for(counting.counts[call]),
        )
        for call, index, site in wanted[:n]
    ]  # fmt: skip


def choose(random: np.random.Generator, counts: Sequence[int], n: int) -> list[tuple[int, int]]:
    """Draw dynamic instructions of a whole flight, uniformly: each call has the weight of its count.

    Args:
        random: Stream.
        counts: Of each call; those of several functions may be joined end to end.
        n: How many.

    Returns:
        Call and index within the call, in the order of drawing.
    """
    ends = np.cumsum(counts).tolist()
    drawn = random.integers(ends[-1], size=n).tolist()
    calls = [bisect_right(ends, position) for position in drawn]
    return [
        (call, position - (ends[call - 1] if call else 0)) for call, position in zip(calls, drawn, strict=True)
    ]  # fmt: skip
