"""Values of a kernel that can be duplicated: their operands, uses and executions, and the cost of duplicating some.

The cost of a set of values is the number of simple dynamic instructions that it adds: shadows, opaque copies of
operands, and comparisons where a value leaves the set (see `mavfi.extras.hardening.duplicate`).  A single instruction
costs three to five others, one inside a duplicated slice little more than itself.  Slow instructions count several
times.
"""

import re
from collections.abc import Iterable, Mapping, Sequence, Set
from dataclasses import dataclass, field

from mavfi.extras.hardening.candidates import candidates, reads_memory
from mavfi.extras.hardening.plan import Site
from mavfi.ir.flow import back_edges, successors
from mavfi.ir.module import Block, Function, Instruction, Module, is_floating

_DIVISIONS = {"fdiv": 4.0, "frem": 8.0, "sdiv": 8.0, "udiv": 8.0, "srem": 8.0, "urem": 8.0}
_ROUNDING = re.compile(r"@(?:llvm\.)?(?:sqrt|floor|ceil|trunc|rint|nearbyint|round|roundeven)f?(?:\.|$)")
_CALL = 6.0
"""Costs of slow instructions, in simple ones.  Divisions occupy their unit for several cycles (A. Fog, Instruction
tables); rounding is a call of libm in code for every x86-64 processor.  Rough: times are measured afterwards."""
OUTSIDE = -1
"""Index of a value that cannot be duplicated: a parameter, a constant, the result of most calls."""


@dataclass(frozen=True, slots=True)
class Use:
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


@dataclass(frozen=True, slots=True)
class Entry:
    """An incoming value of a phi: its index or `OUTSIDE`, executions of the edge's block, whether it closes a loop."""

    value: int
    executions: float
    closes_loop: bool


@dataclass(slots=True)
class Value:
    """A value that can be duplicated.

    Attributes:
        site: Where it is computed.
        opcode: Of its instruction.
        kind: LLVM type.
        executions: Number of executions.
        operands: Indices of its operands that can be duplicated, without repetition.
        uses: Its uses, except as condition of a branch with two targets, of which both edges check the shadow.
        entries: Incoming values of a phi.
        own_memory: Whether its shadow needs no copy of an operand (a volatile load).
        weight: Cost of its instruction, in simple ones.
    """

    site: Site
    opcode: str
    kind: str
    executions: float
    operands: tuple[int, ...] = ()
    uses: list[Use] = field(default_factory=list)
    entries: tuple[Entry, ...] = ()
    own_memory: bool = False
    weight: float = 1.0

    @property
    def comparison(self) -> int:
        """Instructions of one comparison: with two casts, except for integers and pointers."""
        return 3 if is_floating(self.kind) or self.kind.startswith("<") else 1

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
        counts = {block.label: executions.get((number, place)) for place, block in enumerate(function.blocks)}
        values += _Reader(number, function, counts, addresses).values(len(values), allowed)
    return values


class _Reader:
    def __init__(
        self, number: int, function: Function, counts: Mapping[str, float | None], addresses: bool
    ) -> None:  # fmt: skip
        self.number, self.function, self.counts, self.addresses = number, function, counts, addresses
        self.index: dict[str, int] = {}
        self.back = back_edges(function)

    def values(self, first: int, allowed: Set[Site]) -> list[Value]:
        """The function's values at the allowed sites, numbered from `first`."""
        made: list[tuple[Value, Instruction, Block]] = []
        for place, block in enumerate(self.function.blocks):
            for offset, instruction in enumerate(block.sites):
                site = Site(self.number, place, offset)
                if site in allowed:
                    self.index[str(instruction.result)] = first + len(made)
                    value = Value(site, instruction.opcode, instruction.kind, self.counts[block.label] or 0.0)
                    made.append((value, instruction, block))
        for value, instruction, block in made:
            self._connect(value, instruction, block)
        values = [value for value, _, _ in made]
        for block in self.function.blocks:
            for instruction in block.all():
                self._note_uses(instruction, block, values, first)
        return values

    def _connect(self, value: Value, instruction: Instruction, block: Block) -> None:
        """Set operands and entries."""
        value.own_memory = instruction.opcode == "load"
        value.weight = weight_of(instruction)
        used = [name for name, _ in instruction.incoming] or instruction.uses()
        value.operands = tuple(dict.fromkeys(self.index[name] for name in used if name in self.index))
        value.entries = tuple(
            Entry(self.index.get(name, OUTSIDE), self.counts.get(label) or 0.0, (label, block.label) in self.back)
            for name, label in instruction.incoming
        )

    def _note_uses(self, instruction: Instruction, block: Block, values: Sequence[Value], first: int) -> None:
        user = self.index.get(str(instruction.result), OUTSIDE)
        if instruction.opcode == "phi":
            for name, label in instruction.incoming:
                if name in self.index:
                    values[self.index[name] - first].uses.append(Use(user, label, self.counts.get(label)))
            return
        if len(set(successors(instruction))) == 2 and instruction.opcode == "br":
            return
        for name in dict.fromkeys(instruction.uses()):
            if name in self.index:
                compared = self.addresses and reads_memory(instruction) and name in instruction.addresses
                use = Use(user, block.label, self.counts[block.label], compared)
                values[self.index[name] - first].uses.append(use)


def weight_of(instruction: Instruction) -> float:
    """Cost of an instruction, in simple ones."""
    if instruction.callee is not None:
        return _CALL if _ROUNDING.match(instruction.callee) else 1.0
    return _DIVISIONS.get(instruction.opcode, 1.0)


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
        plain = (entry for entry in value.entries if entry.value not in chosen and not entry.closes_loop)
        return sum(entry.executions for entry in plain)
    if value.own_memory or any(operand in chosen for operand in value.operands):
        return 0.0
    return min((entry.executions for entry in value.entries), default=value.executions)


def _comparisons(value: Value, chosen: Set[int]) -> float:
    """Compared where it is made, or where it leaves the set, whichever is executed less often."""
    exits = {use.block: use.executions for use in value.uses if use.compared or use.user not in chosen}
    return value.comparison * least_executed(value, exits.values()) if exits else 0.0


def least_executed(value: Value, exits: Iterable[float | None]) -> float:
    """Executions of a value's comparisons, from those of the blocks in which it leaves the chosen set."""
    there = 0.0
    for executions in exits:
        if executions is None:
            return value.executions
        there += executions
    return min(value.executions, there)
