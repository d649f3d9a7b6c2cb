"""Golden flights in which the kernels' functions are counted, and the arguments of some of their calls kept."""

from collections.abc import Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from mavfi.extras.hardening.plan import signature_text
from mavfi.extras.hardening.recorded import Recording
from mavfi.faults.levels.instruction.variant import Variant, signature_of, variant_for
from mavfi.flight.fly import fly
from mavfi.ir.sources import cached_source
from mavfi.mission import Scenario
from mavfi.pipeline.functions import PLAIN
from mavfi.states import INJECTABLE

_CALLS = 12
"""Recorded calls per signature, about."""


@dataclass(slots=True)
class Seen:
    """What golden flights showed of a function compiled for one signature.

    Attributes:
        function: The compiled function.
        entry: Its name, a field of `KernelFunctions`.
        signature: Numba types of the arguments.
        variant: Its instrumented variant.
        executions: Executions of each block with sites. Shape (blocks,).
        calls: Arguments of some calls, in order.
        total: Number of calls.
    """

    function: Any
    entry: str
    signature: tuple[Any, ...]
    variant: Variant
    executions: np.ndarray
    total: int = 0
    calls: list[tuple[Any, ...]] = field(default_factory=list)

    @property
    def instructions(self) -> int:
        """Dynamic instructions of all calls."""
        return self.variant.written(self.executions)

    @property
    def signature_text(self) -> str:
        """The signature as in a plan."""
        return signature_text(self.signature)


class Observing:
    """Replaces a function in a flight: counts its blocks and records arguments, by signature.

    Args:
        entry: Name of the function.
        function: Compiled by `kernel_jit`.
        ahead: Fetches the IR, which takes seconds for the first time, during the flight.
    """

    def __init__(self, entry: str, function: Any, ahead: Executor) -> None:
        self._entry, self._function, self._ahead = entry, function, ahead
        self._seen: dict[tuple[Any, ...], tuple[Seen, Recording]] = {}

    def __call__(self, *args: Any) -> Any:
        """Call the function; bit-identical result."""
        signature = signature_of(args)
        if signature not in self._seen:
            variant = variant_for(self._function, args)
            blocks = np.zeros(len(variant.table.blocks), np.int64)
            seen = Seen(self._function, self._entry, signature, variant, blocks)
            self._seen[signature] = seen, Recording(_CALLS)
            self._ahead.submit(cached_source, self._function, signature)
        seen, recording = self._seen[signature]
        recording.note(args)
        result, times = seen.variant.tally(*args)
        seen.executions += times
        return result

    def seen(self) -> list[Seen]:
        """By signature, in order of the first call."""
        for seen, recording in self._seen.values():
            seen.total = recording.total
            seen.calls = [recording.kept[call] for call in sorted(recording.kept)]
        return [seen for seen, _ in self._seen.values()]


def entries_of(kernels: Sequence[str]) -> tuple[str, ...]:
    """Functions of some kernels, fields of `KernelFunctions`."""
    return tuple(dict.fromkeys(name for kernel in kernels for name in INJECTABLE[kernel]))


def observe(scenario: Scenario, kernels: Sequence[str]) -> dict[str, list[Seen]]:
    """Fly a golden mission; returns the executed functions by kernel.

    Raises:
        BadInputError: The mission cannot be flown.
        RefusedError: A kernel cannot be instrumented exactly.
    """
    names = entries_of(kernels)
    with ThreadPoolExecutor(1) as ahead, np.errstate(all="ignore"):
        made = {name: Observing(name, getattr(PLAIN, name), ahead) for name in names}
        fly(scenario, functions=PLAIN.instrumented(names, lambda name, _: made[name]))
    return {kernel: [seen for name in INJECTABLE[kernel] for seen in made[name].seen()] for kernel in kernels}
