"""Injections into recorded calls of a function, plain or protected: uniform over dynamic instructions, then bits."""

import mmap
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from mavfi.extras.hardening.outputs import outputs_of
from mavfi.extras.hardening.recorded import copied, kept, same_bits
from mavfi.extras.hardening.wrapper import MESSAGE
from mavfi.faults.levels.instruction.plan import budget_for
from mavfi.faults.levels.instruction.table import Site
from mavfi.faults.levels.instruction.variant import Passes, Variant
from mavfi.ir.forked import run_in_child
from mavfi.outcomes import Effect

_SURVIVED = (Effect.MASKED, Effect.SDC, Effect.DETECTED, Effect.EXCEPTION, Effect.NOT_ACTIVATED)
"""Effects that do not end the process."""
MASKED, SDC, DETECTED, EXCEPTION, NOT_ACTIVATED = _KNOWN = tuple(effect.label for effect in _SURVIVED)
_TIMEOUT = 60.0


@dataclass(frozen=True, slots=True)
class Place:
    """A bit of the result of one dynamic instruction.

    Attributes:
        call: Index of the recorded call.
        block: Of the table of sites.
        number: Execution of the block within the call, from 0.
        offset: Of the site in the block.
        bit: 0 = least significant.
    """

    call: int
    block: int
    number: int
    offset: int
    bit: int


class Battery:
    """Recorded calls of a function, with instrumented code of a variant of it.

    Args:
        entry: Name of the function, see `outputs_of`.
        function: The plain compiled function.
        variant: Instrumented code, plain or protected.
        calls: Arguments.
    """

    def __init__(self, entry: str, function: Any, variant: Variant, calls: Sequence[tuple[Any, ...]]) -> None:
        self._entry, self._function, self.variant, self.calls = entry, function, variant, calls

    @cached_property
    def executions(self) -> np.ndarray:
        """Executions of each block in each call. Shape (calls, blocks)."""
        return np.array([self.variant.tally(*copied(args))[1] for args in self.calls])

    @cached_property
    def counts(self) -> np.ndarray:
        """Dynamic instructions of each call. Shape (calls,)."""
        return self.executions @ self.variant.sizes

    @cached_property
    def _golden(self) -> list[tuple[Any, ...]]:
        """Outputs of each call of plain code."""
        return [kept(self._outputs(self._function(*own), own)) for own in map(copied, self.calls)]

    def _outputs(self, result: Any, args: tuple[Any, ...]) -> tuple[Any, ...]:
        return outputs_of(self._entry, self._function, result, args)

    def draw(self, random: np.random.Generator, n: int) -> list[Place]:
        """Draw places, uniformly over the dynamic instructions of all calls, then over the bits of the result."""
        sizes = self.variant.sizes
        weights = (self.executions * sizes).astype(np.float64).ravel()
        found = []
        for flat in random.choice(weights.size, size=n, p=weights / weights.sum()):
            call, block = divmod(int(flat), len(sizes))
            offset = int(random.integers(sizes[block]))
            number = int(random.integers(self.executions[call, block]))
            bit = int(random.integers(self.site(block, offset).width))
            found.append(Place(call, block, number, offset, bit))
        return found

    def site(self, block: int, offset: int) -> Site:
        """A static instruction."""
        return self.variant.table.blocks[block][offset]

    def run(self, places: Sequence[Place]) -> list[str]:
        """Effect of each injection, as if in a child process of its own: they share one as long as it lives."""
        indices = self._indices(places)
        self.variant.own_report()
        found = [""] * len(places)
        for call in {place.call for place in places}:
            left = [number for number, place in enumerate(places) if place.call == call]
            while left:
                effects = self._effects(call, [(indices[n], places[n].bit) for n in left])
                for n, effect in zip(left, effects, strict=False):
                    found[n] = effect
                left = left[len(effects) :]
        return found

    def _indices(self, places: Sequence[Place]) -> list[int]:
        """Dynamic index of each place in its call."""
        starts: dict[tuple[int, int, int], int] = {}
        for call in {place.call for place in places}:
            wanted = {(place.block, place.number) for place in places if place.call == call}
            passes = Passes(len(self.variant.table.blocks), wanted)
            self.variant.locate(passes, *copied(self.calls[call]))
            starts.update({(call, *one): passes.start(*one) for one in wanted})
        return [starts[place.call, place.block, place.number] + place.offset for place in places]

    def _effects(self, call: int, faults: Sequence[tuple[int, int]]) -> list[str]:
        """Effects of faults (dynamic index and bit) in one child, up to the first that ends it.

        A call outside planned memory ends it, too: it may have written anywhere.
        """
        golden, budget = self._golden[call], budget_for(int(self.counts[call]))
        done = mmap.mmap(-1, len(faults))

        def injected() -> bytes:
            for number, (index, bit) in enumerate(faults):
                done[number] = 1 + _KNOWN.index(self._injected(copied(self.calls[call]), index, bit, budget, golden))
                report = self.variant.report()
                if report is not None and not report.planned:
                    break
            return b""

        ended = run_in_child(injected, _TIMEOUT + len(faults))
        effects = [_KNOWN[code - 1] for code in done[:] if code]
        if ended.how != "done" and len(effects) < len(faults):
            effects.append(NOT_ACTIVATED if self.variant.report() is None else ended.how)
        return effects

    def _injected(self, args: tuple[Any, ...], index: int, bit: int, budget: int, golden: tuple[Any, ...]) -> str:
        """Effect of a fault that does not end the process."""
        try:
            result = self.variant.inject(index, -1, 1 << bit, budget, *args)
        except Exception as error:  # noqa: BLE001 - raised by the kernel, or by its wrapper after a detection
            return DETECTED if isinstance(error, SystemError) and MESSAGE in str(error) else EXCEPTION
        if self.variant.report() is None:
            return NOT_ACTIVATED
        return MASKED if same_bits(self._outputs(result, args), golden) else SDC


def counts_of(effects: Sequence[str]) -> dict[str, int]:
    """Number of injections by effect, in a fixed order."""
    counted = Counter(effects)
    return {effect.label: counted[effect.label] for effect in Effect if counted[effect.label]}
