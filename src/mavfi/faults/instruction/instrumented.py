"""Instrumented functions: each replaces a compiled function in a flight, and counts, resolves or injects.

With `rewriting`, their instructions are those of the rewritten function, e.g. of the protected one.

`plan.choose` draws call and index from the counts of a first flight; a second flight resolves the instructions.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from mavfi.errors import BadInputError
from mavfi.faults.fault import InstructionFault
from mavfi.faults.instruction.plan import check_fault, injection_of
from mavfi.faults.instruction.table import Site, Table
from mavfi.faults.instruction.variant import Variant, variant_for
from mavfi.flight_log import Injection
from mavfi.ir.build import Rewriting


class Counting:
    """Counts the values that each call of a compiled function writes, and stores the digest of the executed IR."""

    def __init__(self, function: Any, rewriting: Rewriting | None = None) -> None:
        self.function, self.rewriting = function, rewriting
        self.counts: list[int] = []
        self.digests: list[str] = []

    def __call__(self, *args: Any) -> Any:
        """Call the function; bit-identical result."""
        variant = variant_for(self.function, args, self.rewriting)
        result, total = self._run(variant, args)
        self.counts.append(total)
        self.digests.append(variant.ir_sha256)
        return result

    def _run(self, variant: Variant, args: tuple[Any, ...]) -> tuple[Any, int]:
        return variant.count(*args)


class Profiling(Counting):
    """Additionally counts the executions of each static instruction over all calls."""

    def __init__(self, function: Any, rewriting: Rewriting | None = None) -> None:
        super().__init__(function, rewriting)
        self._times: dict[str, tuple[Table, np.ndarray]] = {}

    def _run(self, variant: Variant, args: tuple[Any, ...]) -> tuple[Any, int]:
        result, times = variant.tally(*args)
        _, total = self._times.setdefault(variant.ir_sha256, (variant.table, np.zeros_like(times)))
        total += times
        return result, variant.written(times)

    def executed(self) -> list[tuple[str, Site, int]]:
        """All executed static instructions: digest of the IR, instruction, execution count."""
        return [
            (digest, site, times)
            for digest, (table, total) in self._times.items()
            for site, times in table.executions(total)
            if times
        ]


class Resolving:
    """Finds the static instructions (`sites`, by call and index) at the wanted indices, given by call."""

    def __init__(
        self, function: Any, wanted: Mapping[int, Sequence[int]], rewriting: Rewriting | None = None
    ) -> None:  # fmt: skip
        self._function, self._rewriting = function, rewriting
        self._wanted = wanted
        self._calls = 0
        self.sites: dict[tuple[int, int], Site | None] = {}

    @property
    def done(self) -> bool:
        """Whether the last wanted call has been made."""
        return self._calls > max(self._wanted, default=-1)

    def is_wanted(self, calls: range) -> bool:
        """Whether any of some calls is wanted, and has not been made."""
        return any(call in calls and (call, self._wanted[call][0]) not in self.sites for call in self._wanted)

    def continue_at(self, call: int) -> None:
        """The next call has this number."""
        self._calls = call

    def __call__(self, *args: Any) -> Any:
        """Call the function; bit-identical result."""
        call, self._calls = self._calls, self._calls + 1
        indices = self._wanted.get(call)
        if not indices:
            return self._function(*args)
        result, sites = variant_for(self._function, args, self._rewriting).resolve(indices, *args)
        self.sites.update({(call, index): site for index, site in zip(indices, sites, strict=True)})
        return result


class Injecting:
    """Runs the function unchanged, except for the call with the fault.

    `before` is called immediately before the injection, e.g. to fork; the fault is injected where it returns True,
    otherwise the call is an ordinary one.

    Raises:
        BadInputError: The fault has no budget.
    """

    def __init__(self, function: Any, fault: InstructionFault, before: Callable[[], bool] | None = None) -> None:
        if fault.budget == 0:
            raise BadInputError(f"fault in {fault.function}: budget 0; allowed: what `budget_for` gives for the count")
        self._function = function
        self._fault = fault
        self._before = before
        self.calls = 0
        self._variant: Variant | None = None

    def __call__(self, *args: Any) -> Any:
        """Call the function, once with the fault; a fault for other machine code is a MismatchError."""
        call, self.calls = self.calls, self.calls + 1
        if call != self._fault.call:
            return self._function(*args)
        self._variant = variant_for(self._function, args)
        check_fault(self._fault, self._variant, self._function)
        self._variant.own_report()
        if self._before is not None and not self._before():
            return self._function(*args)
        fault = self._fault
        return self._variant.inject(fault.index, *fault.masks, fault.budget, *args)

    def injection(self) -> Injection:
        """The injection, here or in a forked child."""
        return injection_of(self._fault, None if self._variant is None else self._variant.report())
