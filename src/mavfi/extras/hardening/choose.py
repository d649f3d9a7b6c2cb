"""Which values to duplicate within a budget of time: greedily, by silent corruptions removed per added time.

The cost of a set of values is the number of simple dynamic instructions that it adds: shadows, opaque copies of
operands, and comparisons where a value leaves the set (see `mavfi.extras.hardening.duplicate`).  Slow instructions
count several times.  A value alone costs three to five instructions, next to a chosen one little more than itself: so
slices grow around the values that are worth most.
"""

import heapq
import re
from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, field
from typing import NamedTuple

from mavfi.extras.hardening.duplicate import candidates, is_address, is_fork, uses
from mavfi.extras.hardening.plan import ModuleSite
from mavfi.ir.flow import back_edges
from mavfi.ir.module import Instruction, Module, is_floating

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
        for name, user, label in uses(function):
            if name in index and not is_fork(user):
                compared = addresses and is_address(name, user)
                use = Use(index.get(str(user.result), OUTSIDE), label, counts.get(label), compared)
                values[index[name]].uses.append(use)
    return values


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
    if not exits:
        return 0.0
    counted = [executions for executions in exits.values() if executions is not None]
    executions = value.executions
    if len(counted) == len(exits):  # a block that was not counted is no cheaper place
        executions = min(executions, sum(counted))
    return value.comparison * executions


# ---- the choice -----------------------------------------------------------------------------------------------------

_FREE = 1e-9
"""Time of a value that adds none, or saves a comparison: it is chosen before all that cost anything."""


@dataclass(frozen=True, slots=True)
class Candidates:
    """Values of a function among which to choose.

    Attributes:
        values: See `values_of`.
        benefit: Silent corruptions that duplicating each value removes, in the flights in which it was counted.
        time_per_instruction: Time that an added instruction takes.
    """

    values: Sequence[Value]
    benefit: Sequence[float]
    time_per_instruction: float

    def neighbours(self) -> list[set[int]]:
        """Of each value, those whose cost depends on whether it is chosen, or vice versa: operands and users."""
        near = [set(value.operands) for value in self.values]
        for index, value in enumerate(self.values):
            for operand in value.operands:
                near[operand].add(index)
        return near


def choose(functions: Sequence[Candidates], budget: float) -> list[frozenset[int]]:
    """Choose values of functions that share a budget of time; returns their indices, by function.

    Always next is the value that removes most silent corruptions per time that it adds to what is chosen already;
    one that does not fit any more is left out.
    """
    chosen: list[set[int]] = [set() for _ in functions]
    near = [function.neighbours() for function in functions]
    heap: list[tuple[float, int, int, float]] = []  # - benefit per time, function, value, time

    def added_time(number: int, index: int) -> float:
        """Time that a value adds to the chosen set, in which it changes the costs of its neighbours, too."""
        function = functions[number]
        selected = chosen[number]
        affected = near[number][index] & selected
        before = sum(cost(function.values, other, selected) for other in affected)
        selected.add(index)
        after = sum(cost(function.values, other, selected) for other in (*affected, index))
        selected.discard(index)
        return (after - before) * function.time_per_instruction

    def push(number: int, index: int) -> None:
        benefit = functions[number].benefit[index]
        if index not in chosen[number] and benefit > 0:
            time = added_time(number, index)
            heapq.heappush(heap, (-benefit / max(time, _FREE), number, index, time))

    for number, function in enumerate(functions):
        for index in range(len(function.values)):
            push(number, index)

    left = budget
    while heap:
        _, number, index, time = heapq.heappop(heap)
        if index in chosen[number]:
            continue
        if time != added_time(number, index):  # a neighbour, or one of its neighbours, has been chosen meanwhile
            push(number, index)
            continue
        if time <= left:
            left -= time
            chosen[number].add(index)
            for other in near[number][index]:
                push(number, other)
    return [frozenset(indices) for indices in chosen]
