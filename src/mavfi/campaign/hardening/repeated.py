"""Whole calls executed two or three times (kinds `rerun` and `vote`): faults in them, false alarms, and their time."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from mavfi.campaign.hardening.advise import TIMED_S, enough_for
from mavfi.campaign.hardening.battery import DETECTED, EXCEPTION, MASKED, NOT_ACTIVATED, SDC, Battery
from mavfi.campaign.hardening.observed import Seen
from mavfi.faults.instruction.api import digest
from mavfi.faults.instruction.variant import Variant, signature_of
from mavfi.hardening.measure import Timed, compare
from mavfi.hardening.recorded import copied, same_bits, size_of
from mavfi.hardening.wrapper import MESSAGE
from mavfi.ir.build import environment_of
from mavfi.ir.parser import parse_module
from mavfi.ir.sources import cached_source
from mavfi.numerics.jit import kernel_jit

_WORD = 8


class Repeated(Battery):
    """Recorded calls of a function that is executed as a whole `times` times, with the fault in the first execution.

    All executions start from copies of the arguments; results and all arguments are compared, as by hosts.
    """

    def __init__(
        self, entry: str, function: Any, variant: Variant, calls: Sequence[tuple[Any, ...]], times: int
    ) -> None:  # fmt: skip
        super().__init__(entry, function, variant, calls)
        self.times = times

    def _injected(self, args: tuple[Any, ...], index: int, bit: int, budget: int, golden: tuple[Any, ...]) -> str:
        """Effect of a fault that does not end the process; the majority of three is published."""
        copies = [copied(args) for _ in range(self.times - 1)]
        try:
            result = self.variant.inject(index, -1, 1 << bit, budget, *args)
        except Exception:  # noqa: BLE001 - raised by the kernel: that of the node
            return EXCEPTION
        if self.variant.report() is None:
            return NOT_ACTIVATED
        runs = [(result, args), *((self._function(*own), own) for own in copies)]
        seen = [digest(run) for run in runs]
        if len(set(seen)) > 1 and max(map(seen.count, seen)) < 2:
            return DETECTED  # no majority
        published = runs[max(range(len(runs)), key=lambda place: seen.count(seen[place]))]
        same = same_bits(self._outputs(*published), golden)
        return (MASKED if len(set(seen)) == 1 else DETECTED) if same else SDC


def repeating(function: Any, times: int) -> Callable[..., Any]:
    """A function whose calls are executed `times` times; a difference is a SystemError, as in protected code."""

    def call(*args: Any) -> Any:
        copies = [copied(args) for _ in range(times - 1)]
        result = function(*args)
        first = digest((result, args))
        if any(digest((function(*own), own)) != first for own in copies):
            raise SystemError(MESSAGE)
        return result

    return call


@kernel_jit
def keep_and_compare(values: np.ndarray, kept: np.ndarray, other: np.ndarray) -> bool:
    """What an execution more costs beside itself: arguments are kept, and compared with those of another execution."""
    different = values[0] ^ values[0]
    for place in range(len(values)):
        kept[place] = values[place]
        different |= values[place] ^ other[place]
    return bool(different == 0)


def repeated_time(seen: Seen, times: int, seconds: float = TIMED_S) -> float:
    """Time of a call that is executed `times` times / that of a plain call, with copies and comparison.

    Measured by the time stamp counter on recorded calls; arguments are kept and compared that any of these changes.
    """
    one = _timed(seen.function, seen.signature)

    def repeatedly(args: tuple[Any, ...], repetitions: int) -> float:
        copies = [copied(args) for _ in range(times - 1)]
        return one.ticks(args, repetitions) + sum(one.ticks(own, repetitions) for own in copies)

    timing = compare(one.ticks, {"repeated": repeatedly}, seen.calls, enough_for(seconds))
    words = -(-_changed_bytes(seen) // _WORD)
    if not words:
        return timing.ratios["repeated"]
    memory = tuple(np.zeros(words, np.int64) for _ in range(3))
    extra = _timed(keep_and_compare, signature_of(memory))
    ticks = float(np.median([extra.ticks(memory, 20) for _ in range(9)]))
    return timing.ratios["repeated"] + (times - 1) * ticks / timing.ticks


def _timed(function: Any, signature: tuple[Any, ...]) -> Timed:
    source = cached_source(function, signature)
    code = Timed.code_of(source, parse_module(source.text, source.kernel))
    return Timed(source, code, environment_of(function, signature))


def _changed_bytes(seen: Seen) -> int:
    """Bytes of the arguments that recorded calls change."""
    changed: dict[int, int] = {}
    for args in seen.calls:
        own = copied(args)
        seen.function(*own)
        for place, (before, after) in enumerate(zip(args, own, strict=True)):
            if digest(before) != digest(after):
                changed[place] = max(changed.get(place, 0), size_of(after))
    return sum(changed.values())
