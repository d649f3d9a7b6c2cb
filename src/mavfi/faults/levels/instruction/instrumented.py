"""Instrumented functions: each replaces a compiled function in a flight, and counts or resolves.

With `rewriting`, their instructions are those of the rewritten function, e.g. of the protected one.

`plan.choose` draws call and index from the counts of a first flight; a second flight resolves the instructions.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from mavfi.faults.levels.instruction.table import Site, Table
from mavfi.faults.levels.instruction.variant import variant_for
from mavfi.ir.build import Rewriting


class Profiling:
    """Counts the values that each call of a compiled function writes, and the executions of each static instruction.

    Attributes:
        counts: Number of values, by call.
        digests: Digest of the executed IR, by call.
    """

    def __init__(self, function: Any, rewriting: Rewriting | None = None) -> None:
        self.function, self.rewriting = function, rewriting
        self.counts: list[int] = []
        self.digests: list[str] = []
        self._times: dict[str, tuple[Table, np.ndarray]] = {}

    def __call__(self, *args: Any) -> Any:
        """Call the function; bit-identical result."""
        variant = variant_for(self.function, args, self.rewriting)
        result, times = variant.tally(*args)
        _, total = self._times.setdefault(variant.ir_sha256, (variant.table, np.zeros_like(times)))
        total += times
        self.counts.append(variant.written(times))
        self.digests.append(variant.ir_sha256)
        return result

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
