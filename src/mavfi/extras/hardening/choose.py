"""Which values to duplicate within a number of added instructions: by minimum cuts.

`Chooser.within` takes the best minimum cut that the budget allows, and fills the rest greedily: a minimum cut exists
only at the corners of the convex hull of cost and benefit.
"""

import heapq
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mavfi.extras.hardening.cut import Cuts
from mavfi.extras.hardening.flow import Value, cost, total_cost

_PRICES = np.geomspace(50.0, 1e-3, 48)
"""Prices of the hull, relative to benefit / cost of duplicating everything."""


@dataclass(frozen=True, slots=True)
class Choice:
    """A set of values to duplicate.

    Attributes:
        chosen: Indices of the values.
        cost: Dynamic instructions that it adds, by weight.
        benefit: Sum over the values.
    """

    chosen: frozenset[int]
    cost: float
    benefit: float


NOTHING = Choice(frozenset(), 0.0, 0.0)


class Chooser:
    """Choices for a kernel.

    Args:
        values: See `flow.values_of`.
        benefit: Expected failures that duplicating each value removes, e.g. executions x SDC rate. Shape (values,).
    """

    def __init__(self, values: Sequence[Value], benefit: Sequence[float] | np.ndarray) -> None:
        self.values = values
        self.benefit = np.asarray(benefit, np.float64)
        self._users: list[set[int]] = [set() for _ in values]
        for index, value in enumerate(values):
            for operand in value.operands:
                self._users[operand].add(index)

    @cached_property
    def full(self) -> Choice:
        """Everything that is executed."""
        return self.choice(index for index, value in enumerate(self.values) if value.executions)

    def choice(self, chosen: Iterable[int]) -> Choice:
        """Cost and benefit of a set of values."""
        own = frozenset(chosen)
        return Choice(own, total_cost(self.values, own), float(self.benefit[list(own)].sum()))

    @cached_property
    def hull(self) -> list[Choice]:
        """Choices on the upper convex hull of benefit over cost, from nothing to everything."""
        whole = self.full
        cuts = Cuts(self.values, self.benefit)
        scale = whole.benefit / whole.cost if whole.cost else 0.0
        found = {NOTHING.chosen: NOTHING, whole.chosen: whole}
        for price in _PRICES:
            chosen = cuts.at(float(price * scale))
            if chosen not in found:
                found[chosen] = self.choice(chosen)
        return upper_hull(found.values())

    def within(self, budget: float) -> Choice:
        """The best known choice that adds at most `budget` dynamic instructions: a larger one never covers less."""
        return max((step for step in self._steps if step.cost <= budget), key=lambda step: step.benefit).choice(self)

    @cached_property
    def _steps(self) -> list["_Step"]:
        """The corners of the hull, and greedy additions from each of them to the cost of the next one."""
        steps = []
        for corner, following in zip(self.hull, [*self.hull[1:], self.full], strict=True):
            added: list[int] = []
            steps.append(_Step(corner, added, 0, corner.cost, corner.benefit))
            spent, gained = corner.cost, corner.benefit
            for index, price in self._greedy(corner.chosen):
                spent, gained = spent + price, gained + float(self.benefit[index])
                if spent >= following.cost:
                    break
                added.append(index)
                steps.append(_Step(corner, added, len(added), spent, gained))
        return steps

    def _greedy(self, start: frozenset[int]) -> Iterator[tuple[int, float]]:
        """Values in order of benefit per added cost, with this cost, given those before."""
        chosen = set(start)
        heap: list[tuple[float, int, float]] = []

        def push(index: int) -> None:
            if index not in chosen and self.benefit[index] > 0 and self.values[index].executions:
                price = self._added(index, chosen)
                heapq.heappush(heap, (-self.benefit[index] / max(price, 1e-9), index, price))

        for index in range(len(self.values)):
            push(index)
        while heap:
            _, index, price = heapq.heappop(heap)
            if index in chosen:
                continue
            if price != self._added(index, chosen):  # a relative has been chosen meanwhile
                push(index)
                continue
            chosen.add(index)
            yield index, price
            for other in self._near(index):
                push(other)

    def _near(self, index: int) -> set[int]:
        """Values whose cost depends on whether this one is chosen, or vice versa."""
        return self._users[index].union(self.values[index].operands)

    def _added(self, index: int, chosen: set[int]) -> float:
        """Instructions that a value adds to a chosen set without it; those of its neighbours change, too."""
        near = self._near(index) & chosen
        before = sum(cost(self.values, other, chosen) for other in near)
        chosen.add(index)
        after = sum(cost(self.values, other, chosen) for other in (*near, index))
        chosen.discard(index)
        return after - before


@dataclass(frozen=True, slots=True)
class _Step:
    """A corner of the hull with the first `count` of some additions."""

    corner: Choice
    added: list[int]
    count: int
    cost: float
    benefit: float

    def choice(self, chooser: Chooser) -> Choice:
        return chooser.choice([*self.corner.chosen, *self.added[: self.count]])


def upper_hull(choices: Iterable[Choice]) -> list[Choice]:
    """The choices on the upper convex hull of benefit over cost, by cost."""
    hull: list[Choice] = []
    for choice in sorted(choices, key=lambda one: (one.cost, -one.benefit)):
        if hull and choice.benefit <= hull[-1].benefit:
            continue
        while len(hull) > 1 and _slope(hull[-2], choice) >= _slope(hull[-2], hull[-1]):
            hull.pop()
        hull.append(choice)
    return hull


def _slope(one: Choice, other: Choice) -> float:
    return (other.benefit - one.benefit) / max(other.cost - one.cost, 1e-12)
