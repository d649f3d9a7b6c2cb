"""Duplicated execution of kernel steps against computation faults: compare two executions, decide by a third.

All executions start from the same memory and inputs, see `pipeline.kernel.repeat`.  Each costs the kernel's latency;
the results are published after the last one.  Only published values are compared; memory is that of the last execution.
"""

from collections.abc import Collection
from typing import TYPE_CHECKING
from weakref import proxy

from mavfi.pipeline.kernel import Kernel, repeat
from mavfi.record import AlarmRecord
from mavfi.states import State

if TYPE_CHECKING:
    from mavfi.flight.loop import Loop

SOURCE = "duplicate"
_SCORE = 2.0


class Duplicates:
    """Duplicates the steps of selected kernels of a loop.

    Args:
        loop: The flight.
        kernels: Names of the kernels.
    """

    def __init__(self, loop: "Loop", kernels: Collection[str]) -> None:
        self._loop = proxy(loop)  # the loop owns this object
        self._kernels = frozenset(kernels)

    def __call__(self, kernel: Kernel, first: list[State], now: int) -> tuple[list[State], int]:
        """Return the results to publish, given the first execution's, and the time of the further executions (us)."""
        if kernel.name not in self._kernels:
            return first, 0
        second, runs = self._again(kernel, now), 1
        published = second
        differs = _difference(first, second)
        if differs is not None:
            published, runs = self._again(kernel, now), 2
            outcomes = {_same(published, first): "accepted", _same(published, second): "repaired"}
            self._loop.record.alarms.append(
                AlarmRecord(
                    1e-6 * now,
                    SOURCE,
                    differs,
                    kernel.stage.value,
                    _SCORE,
                    (differs,),
                    "recompute",
                    outcomes.get(True, "rejected"),
                )  # fmt: skip
            )
        cost = runs * self._loop.latency[kernel.name]
        record = self._loop.record
        record.recompute_us[kernel.stage.value] += cost
        record.compute_us[kernel.name] += cost
        return published, cost

    def _again(self, kernel: Kernel, now: int) -> list[State]:
        self._loop.repeating = True
        try:
            repeat(kernel)
            return kernel.step(now)
        finally:
            self._loop.repeating = False


def _same(one: list[State], other: list[State]) -> bool:
    return _difference(one, other) is None


def _difference(one: list[State], other: list[State]) -> str | None:
    """Name of the first state that differs; None = all are bit-identical."""
    for mine, its in zip(one, other, strict=False):
        if mine.spec is not its.spec or not mine.same_bits(its):
            return mine.spec.name
    rest = (one if len(one) > len(other) else other)[min(len(one), len(other)) :]
    return rest[0].spec.name if rest else None
