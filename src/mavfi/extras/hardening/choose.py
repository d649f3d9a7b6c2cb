"""Which values to duplicate within a number of added instructions: by minimum cuts.

The cost of a set of values is the number of simple dynamic instructions that it adds: shadows, opaque copies of
operands, and comparisons where a value leaves the set (see `mavfi.extras.hardening.duplicate`).  A single instruction
costs three to five others, one inside a duplicated slice little more than itself.  Slow instructions count several
times.

So whole slices must be chosen at once: the set that maximises benefit - price x cost is the source side of a minimum
cut (project selection, Picard 1976), in which a comparison is one hyperedge: it is paid once if any use lies outside.
`Chooser.within` takes the best minimum cut that the budget allows, and fills the rest greedily: a minimum cut exists
only at the corners of the convex hull of cost and benefit.
"""

import heapq
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import breadth_first_order, maximum_flow

from mavfi.extras.hardening.duplicate import candidates, is_fork, reads_memory
from mavfi.extras.hardening.plan import ModuleSite
from mavfi.ir.flow import back_edges
from mavfi.ir.module import Function, Instruction, Module, is_floating

_DIVISION_COSTS = {"fdiv": 4.0, "frem": 8.0, "sdiv": 8.0, "udiv": 8.0, "srem": 8.0, "urem": 8.0}
_ROUNDING = re.compile(r"@(?:llvm\.)?(?:sqrt|floor|ceil|trunc|rint|nearbyint|round|roundeven)f?(?:\.|$)")
_ROUNDING_COST = 6.0
"""Costs of slow instructions, in simple ones.  Divisions occupy their unit for several cycles (A. Fog, Instruction
tables); rounding is a call of libm in code for every x86-64 processor.  Rough: times are measured afterwards."""
OUTSIDE = -1
"""Index of a value that cannot be duplicated: a parameter, a constant, the result of most calls."""


class Use(NamedTuple):
    """A use of a value.

    Attributes:
        user: Index of the using value, or `OUTSIDE` (store, call, return, another function).
        block: Label of the block in which it is needed; for a phi, the block before.
        executions: Executions of this block; None = not counted.
        compared: Whether the value is compared there although the user is duplicated (the address of a load).
    """

    user: int
    block: str
    executions: float | None
    compared: bool = False


class PhiInput(NamedTuple):
    """An incoming value of a phi.

    Attributes:
        value: Its index, or `OUTSIDE`.
        executions: Executions of the block from which it comes.
        closes_loop: Whether it comes from the end of a loop.
    """

    value: int
    executions: float
    closes_loop: bool


@dataclass(slots=True)
class Value:
    """A value that can be duplicated.

    Attributes:
        site: Where it is computed.
        opcode: Opcode of its instruction.
        kind: LLVM type.
        executions: Number of executions.
        operands: Indices of its operands that can be duplicated, without repetition.
        uses: Its uses, except as condition of a branch with two targets, of which both edges check the shadow.
        entries: Incoming values of a phi.
        weight: Cost of its instruction, in simple ones.
    """

    site: ModuleSite
    opcode: str
    kind: str
    executions: float
    operands: tuple[int, ...] = ()
    uses: list[Use] = field(default_factory=list)
    entries: tuple[PhiInput, ...] = ()
    weight: float = 1.0

    @property
    def reloads(self) -> bool:
        """Whether its shadow needs no copy of an operand (a volatile load)."""
        return self.opcode == "load"

    @property
    def comparison(self) -> int:
        """Instructions of one comparison: with two casts, except for integers and pointers."""
        if is_floating(self.kind) or self.kind.startswith("<"):
            return 3
        return 1

    @property
    def in_loop_header(self) -> bool:
        """Whether it is a phi at the start of a loop."""
        return any(entry.closes_loop for entry in self.entries)


def values_of(module: Module, executions: Mapping[tuple[int, int], float], *, addresses: bool = False) -> list[Value]:
    """Values that can be duplicated, in text order.

    Args:
        module: The kernel.
        executions: Executions by function and block; blocks that are absent were not counted.
        addresses: Whether addresses are compared before loads, too.
    """
    values: list[Value] = []
    allowed = set(candidates(module))
    for number, function in enumerate(module.functions):
        counts = {block.label: executions.get((number, n)) for n, block in enumerate(function.blocks)}

        # 1. Number all values first: an operand of a phi may be computed later.
        index: dict[str, int] = {}
        new: list[tuple[Value, Instruction, str]] = []
        for block_number, block in enumerate(function.blocks):
            for offset, instruction in enumerate(block.sites):
                site = ModuleSite(number, block_number, offset)
                if site in allowed:
                    index[str(instruction.result)] = len(values) + len(new)
                    value = Value(site, instruction.opcode, instruction.kind, counts[block.label] or 0.0)
                    new.append((value, instruction, block.label))
        values += [value for value, _, _ in new]

        # 2. Their operands and incoming values.
        back = back_edges(function)
        for value, instruction, header in new:
            value.weight = weight_of(instruction)
            operands = [name for name, _ in instruction.incoming] or instruction.uses()
            value.operands = tuple(dict.fromkeys(index[name] for name in operands if name in index))
            value.entries = tuple(
                PhiInput(index.get(name, OUTSIDE), counts.get(label) or 0.0, (label, header) in back)
                for name, label in instruction.incoming
            )

        # 3. Their uses.
        for name, use in _uses_of(function, index, counts, addresses=addresses):
            values[index[name]].uses.append(use)
    return values


def _uses_of(
    function: Function, index: Mapping[str, int], counts: Mapping[str, float | None], *, addresses: bool
) -> Iterator[tuple[str, Use]]:
    """Uses of the values with an index, by name."""
    for block in function.blocks:
        for instruction in block.all():
            if is_fork(instruction):
                continue
            user = index.get(str(instruction.result), OUTSIDE)
            operands = instruction.incoming or [(name, block.label) for name in dict.fromkeys(instruction.uses())]
            for name, label in operands:
                if name in index:
                    compared = addresses and reads_memory(instruction) and name in instruction.addresses
                    yield name, Use(user, label, counts.get(label), compared)


def weight_of(instruction: Instruction) -> float:
    """Cost of an instruction, in simple ones."""
    if instruction.callee is not None:
        if _ROUNDING.match(instruction.callee):
            return _ROUNDING_COST
        return 1.0
    return _DIVISION_COSTS.get(instruction.opcode, 1.0)


def cost(values: Sequence[Value], index: int, chosen: Set[int]) -> float:
    """Dynamic instructions added by one value of a chosen set, by weight."""
    value = values[index]
    return value.weight * value.executions + _copies(value, chosen) + _comparisons(value, chosen)


def total_cost(values: Sequence[Value], chosen: Set[int]) -> float:
    """Dynamic instructions added by a chosen set, by weight."""
    return sum(cost(values, index, chosen) for index in chosen)


def added(values: Sequence[Value], chosen: Set[int]) -> float:
    """Number of dynamic instructions added by a chosen set."""
    heavier = sum((values[index].weight - 1.0) * values[index].executions for index in chosen)
    return total_cost(values, chosen) - heavier


def _copies(value: Value, chosen: Set[int]) -> float:
    """A shadow needs an operand that differs from the original's, or code generation would merge the two."""
    if value.in_loop_header:
        initial = (entry for entry in value.entries if not entry.closes_loop)
        return sum(entry.executions for entry in initial if entry.value not in chosen)
    if value.reloads or any(operand in chosen for operand in value.operands):
        return 0.0
    return min((entry.executions for entry in value.entries), default=value.executions)


def _comparisons(value: Value, chosen: Set[int]) -> float:
    """A value is compared where it is made, or where it leaves the set, whichever is executed less often."""
    exits = {use.block: use.executions for use in value.uses if use.compared or use.user not in chosen}
    if exits:
        return value.comparison * least_executed(value, exits.values())
    return 0.0


def least_executed(value: Value, exits: Iterable[float | None]) -> float:
    """Executions of a value's comparisons, from those of the blocks in which it leaves the chosen set."""
    at_exits = 0.0
    for executions in exits:
        if executions is None:  # not counted: compared where it is made
            return value.executions
        at_exits += executions
    return min(value.executions, at_exits)


# ---- minimum cuts ---------------------------------------------------------------------------------------------------

_SOURCE = 0
_SINK = 1
_FIRST = 2
"""Nodes: the source, the sink, and that of the first value."""
_SCALE = 2**29
"""SciPy's capacities are 32-bit integers; more than the sum of all finite ones is infinite."""


class Cuts:
    """Minimum cuts of a kernel for a given benefit.

    The copy of an operand, needed if no operand is chosen, is charged in equal parts to the operands that are not: a
    condition on several operands is not representable in a cut.

    Args:
        values: See `values_of`.
        benefit: Of choosing each value, not negative. Shape (values,).
    """

    def __init__(self, values: Sequence[Value], benefit: np.ndarray) -> None:
        self._n = len(values)
        self._nodes = _FIRST + self._n
        self._edges: list[tuple[int, int, float]] = []  # from, to, cost
        self._tied: list[tuple[int, int]] = []  # from, to, without limit
        self._benefit = np.asarray(benefit, np.float64)
        for index, value in enumerate(values):
            self._add(_FIRST + index, value)

    def _add(self, node: int, value: Value) -> None:
        """Add the edges of a value."""
        # Its shadow costs in any case,
        cost_if_chosen = value.weight * value.executions
        # a copy of an operand if that is not chosen,
        if value.in_loop_header:
            for entry in value.entries:
                if not entry.closes_loop:
                    cost_if_chosen += self._charge_unless(entry.value, node, entry.executions)
        elif not value.reloads:
            copy = min((entry.executions for entry in value.entries), default=value.executions)
            for operand in value.operands or (OUTSIDE,):
                cost_if_chosen += self._charge_unless(operand, node, copy / max(len(value.operands), 1))
        # and a comparison if any use is not chosen.
        exits = {use.block: use.executions for use in value.uses}
        if exits:
            comparison = value.comparison * least_executed(value, exits.values())
            cost_if_chosen += self._charge_comparison(node, value, comparison)
        self._edges.append((node, _SINK, cost_if_chosen))

    def _charge_unless(self, other: int, node: int, price: float) -> float:
        """Charge a price if a node is chosen and another value is not; returns what is due in any case."""
        if other == OUTSIDE:
            return price
        self._edges.append((node, _FIRST + other, price))
        return 0.0

    def _charge_comparison(self, node: int, value: Value, price: float) -> float:
        """Charge the comparison of a value once if any of its uses is not chosen; returns what is due in any case."""
        if any(use.compared or use.user == OUTSIDE for use in value.uses):
            return price
        all_uses = self._nodes  # a new node, chosen only together with all uses
        self._nodes += 1
        self._edges.append((node, all_uses, price))
        self._tied += [(all_uses, _FIRST + use.user) for use in value.uses]
        return 0.0

    def at(self, price: float) -> frozenset[int]:
        """The set that maximises benefit - price x cost, by index of value."""
        beneficial = np.flatnonzero(self._benefit > 0)
        if not len(beneficial):
            return frozenset()

        # 1. Edges: from the source with benefits, with costs at this price, and unlimited ones; scaled to integers.
        start, end, costs = (np.array(part) for part in zip(*self._edges, strict=True))
        tied = np.array(self._tied, np.int64).reshape(-1, 2)
        finite = np.concatenate([self._benefit[beneficial], price * costs])
        scaled = np.rint(finite * (_SCALE / max(self._benefit.sum(), 1e-300))).clip(max=_SCALE)
        starts = np.concatenate([np.full(len(beneficial), _SOURCE), start, tied[:, 0]])
        ends = np.concatenate([_FIRST + beneficial, end, tied[:, 1]])
        weights = np.concatenate([scaled, np.full(len(tied), _SCALE)]).astype(np.int32)
        graph = csr_array((weights, (starts, ends)), shape=(self._nodes, self._nodes))
        graph.sum_duplicates()
        graph.data = graph.data.clip(max=_SCALE).astype(np.int32)

        # 2. The source side of a minimum cut is what can be reached in the residual graph of a maximum flow.
        residual = graph - maximum_flow(graph, _SOURCE, _SINK).flow
        residual.data = np.maximum(residual.data, 0)
        residual.eliminate_zeros()
        reached = breadth_first_order(residual, _SOURCE, return_predecessors=False)
        values = reached[(reached >= _FIRST) & (reached < _FIRST + self._n)]
        return frozenset((values - _FIRST).tolist())


# ---- choices --------------------------------------------------------------------------------------------------------

_PRICES = np.geomspace(50.0, 1e-3, 48)
"""Prices of the hull, relative to benefit / cost of duplicating everything."""


class Choice(NamedTuple):
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
        values: See `values_of`.
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
        """The choice of a set of values, with its cost and benefit."""
        indices = frozenset(chosen)
        return Choice(indices, total_cost(self.values, indices), float(self.benefit[list(indices)].sum()))

    @cached_property
    def hull(self) -> list[Choice]:
        """Choices on the upper convex hull of benefit over cost, from nothing to everything."""
        full = self.full
        cuts = Cuts(self.values, self.benefit)
        scale = 0.0
        if full.cost:
            scale = full.benefit / full.cost
        choices = {NOTHING.chosen: NOTHING, full.chosen: full}
        for price in _PRICES:
            chosen = cuts.at(float(price * scale))
            if chosen not in choices:
                choices[chosen] = self.choice(chosen)
        return upper_hull(choices.values())

    def share(self, fraction: float) -> Choice:
        """The choice that adds at most a fraction of the instructions of full duplication."""
        if fraction == 0.0:
            return NOTHING
        if fraction == 1.0:
            return self.full
        return self.within(fraction * self.full.cost)

    def within(self, budget: float) -> Choice:
        """The best known choice that adds at most `budget` dynamic instructions: a larger one never covers less."""
        step = max((step for step in self._steps if step.cost <= budget), key=lambda step: step.benefit)
        return self.choice([*step.corner.chosen, *step.added[: step.taken]])

    @cached_property
    def _steps(self) -> list["_GreedyStep"]:
        """The corners of the hull, and greedy additions from each of them to the cost of the next one."""
        steps = []
        for corner, following in zip(self.hull, [*self.hull[1:], self.full], strict=True):
            added: list[int] = []  # shared by all steps from this corner
            steps.append(_GreedyStep(corner, added, 0, corner.cost, corner.benefit))
            spent = corner.cost
            gained = corner.benefit
            for index, price in self._greedy(corner.chosen):
                spent += price
                gained += float(self.benefit[index])
                if spent >= following.cost:
                    break
                added.append(index)
                steps.append(_GreedyStep(corner, added, len(added), spent, gained))
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


class _GreedyStep(NamedTuple):
    """A corner of the hull with the first `taken` of the values that are added to it greedily, and their total."""

    corner: Choice
    added: list[int]
    taken: int
    cost: float
    benefit: float


def upper_hull(choices: Iterable[Choice]) -> list[Choice]:
    """The choices on the upper convex hull of benefit over cost, by cost."""
    hull: list[Choice] = []
    for choice in sorted(choices, key=lambda choice: (choice.cost, -choice.benefit)):
        if hull and choice.benefit <= hull[-1].benefit:
            continue
        while len(hull) > 1 and _slope(hull[-2], choice) >= _slope(hull[-2], hull[-1]):
            hull.pop()
        hull.append(choice)
    return hull


def _slope(cheaper: Choice, dearer: Choice) -> float:
    return (dearer.benefit - cheaper.benefit) / max(dearer.cost - cheaper.cost, 1e-12)
