"""Uses of values: as an address, to decide a branch, or as data.

A value feeds an address if a pointer operand is computed from it without an intervening call or comparison; also
through a parameter of a function that was not inlined, and through memory: a value stored to memory from which an
address is loaded later (an index in an array, a result returned through a pointer).  Memory is distinguished by the
origin of its pointers: a parameter, the stack, or a call.

A value decides control if a branch, switch or select depends on it without an intervening load, call or floating-point
comparison: loop counters and bounds do.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

from mavfi.ir.module import Function, Instruction, Module, holds_pointer, is_floating

ADDRESS, CONTROL, FLOATING, INTEGER = "address", "control", "floating_point", "integer"
_ADDRESS_STOPS = ("load", "call", "icmp", "fcmp")
_CONTROL_STOPS = ("load", "call", "fcmp")


@dataclass(slots=True)
class Roles:
    """Names of a function's values that are used in addresses and in conditions."""

    addresses: set[str]
    conditions: set[str]

    def of(self, instruction: Instruction) -> str:
        """Class of the result: the first match of address, control, floating point, integer."""
        if holds_pointer(instruction.kind) or instruction.result in self.addresses:
            return ADDRESS
        if is_floating(instruction.kind):
            return FLOATING
        return CONTROL if instruction.result in self.conditions else INTEGER


def roles(module: Module) -> dict[str, Roles]:
    """Roles of the values of each function in the fault space, by function name."""
    flows = {function.name: _Flow(function) for function in module.functions}
    while any([flow.grow(flows) for flow in flows.values()]):  # all of them, in each round
        pass
    return {name: flow.roles() for name, flow in flows.items()}


@dataclass(slots=True)
class _Flow:
    """Flow of a function's values into addresses; `indices` are memory origins from which such values are loaded."""

    function: Function
    addresses: set[str] = field(default_factory=set)
    indices: set[str] = field(default_factory=set)
    made_by: dict[str, Instruction] = field(default_factory=dict)
    instructions: list[Instruction] = field(default_factory=list)
    known_origins: dict[str, frozenset[str]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.instructions = [instruction for block in self.function.blocks for instruction in block.all()]
        self.made_by = {str(made.result): made for made in self.instructions if made.result is not None}

    def grow(self, flows: "dict[str, _Flow]") -> bool:
        """One step towards the fixed point; returns whether anything was added."""
        before = len(self.addresses) + len(self.indices)
        seeds = set(self.addresses)
        for instruction in self.instructions:
            seeds.update(instruction.addresses)
            if instruction.opcode == "store" and self.origins(instruction.tokens[5]) & self.indices:
                seeds.add(instruction.tokens[2])
            callee = flows.get(str(instruction.callee))
            if callee is not None:
                seeds.update(self._exchange(instruction, callee))
        self.addresses |= _sources(seeds, self.made_by, _ADDRESS_STOPS)
        for instruction in self.instructions:
            if instruction.opcode == "load" and instruction.result in self.addresses:
                self.indices |= self.origins(instruction.tokens[4])
        return len(self.addresses) + len(self.indices) > before

    def _exchange(self, call: Instruction, callee: "_Flow") -> set[str]:
        """Exchange the memory that holds indices with a callee; returns the arguments that it uses in addresses."""
        found = set()
        for (_, name), (_, argument) in zip(callee.function.parameters, call.arguments, strict=True):
            if name in callee.addresses:
                found.add(argument)
            origins = self.origins(argument)
            if name in callee.indices:
                self.indices |= origins
            elif origins & self.indices:
                callee.indices.add(name)
        return found

    def origins(self, pointer: str) -> frozenset[str]:
        """Origins of a pointer: parameters, allocations, calls, loads."""
        if pointer not in self.known_origins:
            chain = _closure([pointer], lambda name: _pointers(self.made_by.get(name)))
            origins = (name for name in chain if name[0] == "%" and not _pointers(self.made_by.get(name)))
            self.known_origins[pointer] = frozenset(origins)
        return self.known_origins[pointer]

    def roles(self) -> Roles:
        conditions: list[str] = []
        for instruction in self.instructions:
            conditions += instruction.conditions
            if instruction.opcode == "ret":
                conditions += instruction.uses()  # Numba's functions return a status
        return Roles(self.addresses, _sources(conditions, self.made_by, _CONTROL_STOPS))


def _pointers(maker: Instruction | None) -> list[str]:
    """Pointers from which a pointer is computed; empty at its origin."""
    if maker is None or maker.opcode in ("alloca", "call", "load"):
        return []
    if maker.opcode == "getelementptr":
        return [maker.tokens[4]]
    values = [value for value, _ in maker.incoming] or maker.uses()
    return [value for value in values if value[0] == "%" and value not in maker.conditions]


def _sources(names: Iterable[str], made_by: dict[str, Instruction], stops: tuple[str, ...]) -> set[str]:
    """The local names, and all names from which they are computed."""

    def uses(name: str) -> list[str]:
        maker = made_by.get(name)
        return [] if maker is None or maker.opcode in stops else maker.uses()

    return {name for name in _closure(names, uses) if name[0] == "%"}


def _closure(names: Iterable[str], following: Callable[[str], list[str]]) -> set[str]:
    """Transitive closure of names under `following`."""
    found: set[str] = set()
    waiting = list(names)
    while waiting:
        name = waiting.pop()
        if name not in found:
            found.add(name)
            waiting += following(name)
    return found
