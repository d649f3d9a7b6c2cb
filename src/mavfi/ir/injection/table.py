"""The sites of an instrumented kernel: its static instructions and their source lines."""

import re
import sys
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from mavfi.errors import BadInputError
from mavfi.ir.metadata import Frame, Locations
from mavfi.ir.module import BasicBlock, Function, Instruction, Module, holds_pointer, is_floating, width


@dataclass(frozen=True, slots=True)
class InjectionSite:
    """A static instruction whose result can be injected.

    Attributes:
        block: Index of its block in the kernel.
        offset: Its index among the sites of the block.
        opcode: As in LLVM's language reference.
        kind: Type of the result.
        width: Bits of the result.
        value_class: "address", "control", "floating_point" or "integer": the first that applies.
        chain: Source lines, the innermost inlined call first.
        near: Whether the line is borrowed from a neighbour, since the instruction has none (most phis).
        variable: Source variable whose value it is, if known.
        role: What it is in protected code: "shadow", "copy" or "check"; "" = as compiled.
    """

    block: int
    offset: int
    opcode: str
    kind: str
    width: int
    value_class: str
    chain: tuple[Frame, ...]
    near: bool = False
    variable: str | None = None
    role: str = ""

    @property
    def floating(self) -> bool:
        """Whether the result is a floating-point number or a vector of them, whatever its use."""
        return is_floating(self.kind)

    @property
    def frames(self) -> list[tuple[str, int]]:
        """Source files, relative to the folder of their import, and lines: the innermost inlined call first.

        Numba's own helpers are omitted: whether they have lines depends on earlier compilations of the process.
        """
        frames = [(short_path(frame.file), frame.line) for frame in self.chain]
        outside_numba = [(file, line) for file, line in frames if not file.startswith("numba/")]
        return outside_numba or frames[:1]

    @property
    def file(self) -> str:
        """Source file, relative to the folder from which it was imported."""
        if self.chain:
            return self.frames[0][0]
        return ""

    @property
    def line(self) -> int:
        """Source line; 0 = unknown."""
        if self.chain:
            return self.frames[0][1]
        return 0

    def __str__(self) -> str:
        notes = "".join(f" ({note})" for note in (self.variable, self.role) if note)
        return f"{self.file}:{self.line} {self.opcode} {self.kind}{notes}"


def short_path(path: str) -> str:
    """A path relative to its folder on Python's path, so that records do not depend on the machine."""
    return _relative_to_longest(path, tuple(sys.path))


@lru_cache(maxsize=1024)
def _relative_to_longest(path: str, folders: tuple[str, ...]) -> str:
    roots = [folder for folder in folders if folder and path.startswith(f"{folder.rstrip('/')}/")]
    longest = max(roots, key=len, default="")
    if longest:
        return str(Path(path).relative_to(longest))
    return path


@dataclass(frozen=True, slots=True)
class SiteTable:
    """All sites of a kernel, by block in the order of dynamic indices."""

    blocks: tuple[tuple[InjectionSite, ...], ...]

    def sizes(self) -> list[int]:
        """Number of sites of each block."""
        return [len(block) for block in self.blocks]

    def executions(self, times: np.ndarray) -> list[tuple[InjectionSite, int]]:
        """All sites with the execution counts of their blocks. Shape (blocks,)."""
        return [(site, int(number)) for block, number in zip(self.blocks, times, strict=True) for site in block]

    def files(self) -> set[str]:
        """All source files."""
        return {frame.file for block in self.blocks for site in block for frame in site.chain}

    def to_json(self) -> list[list[dict[str, Any]]]:
        """Plain data."""
        return [[asdict(site) for site in block] for block in self.blocks]

    @staticmethod
    def from_json(data: list[list[dict[str, Any]]]) -> "SiteTable":
        """Inverse of `to_json`."""
        frames: dict[str, tuple[Frame, ...]] = {}  # most sites share their chain with others

        def chain(rows: list[dict[str, Any]]) -> tuple[Frame, ...]:
            key = repr(rows)
            if key not in frames:
                frames[key] = tuple(Frame(**row) for row in rows)
            return frames[key]

        def site(row: dict[str, Any]) -> InjectionSite:
            return InjectionSite(**{**row, "chain": chain(row["chain"])})

        return SiteTable(tuple(tuple(map(site, block)) for block in data))


def make_table(module: Module) -> SiteTable:
    """The sites of all blocks that have any, in text order."""
    # Values of all functions together: roles depend on callers and callees.
    roles_by_function = roles(module)
    locations = Locations(module.metadata)
    # Blocks are numbered in text order; those without sites have no number.
    blocks: list[tuple[InjectionSite, ...]] = []
    for function in module.functions:
        for block in function.blocks:
            if not block.sites:
                continue
            lines = _lines_of(block, function, locations)
            sites = []
            for offset, instruction in enumerate(block.sites):
                chain, near = lines[id(instruction)]
                site = InjectionSite(
                    len(blocks),
                    offset,
                    instruction.opcode,
                    instruction.kind,
                    width(instruction.kind),
                    roles_by_function[function.name].of(instruction),
                    chain,
                    near,
                    instruction.variable,
                    instruction.role,
                )
                sites.append(site)
            blocks.append(tuple(sites))
    return SiteTable(tuple(blocks))


def _lines_of(block: BasicBlock, function: Function, locations: Locations) -> dict[int, tuple[tuple[Frame, ...], bool]]:
    """Source lines of each instruction, and whether they are borrowed from the next instruction that has some."""
    # The lines that instructions have themselves, from the last instruction on; line 0 is none.
    chains: list[tuple[Instruction, tuple[Frame, ...]]] = []
    for instruction in reversed(block.all()):
        chain: tuple[Frame, ...] = ()
        if instruction.location is not None:
            chain = locations.chain(instruction.location)
        if chain and not chain[0].line:
            chain = ()
        chains.append((instruction, chain))
    # The last instructions borrow from the one before them, or from the head of the function.
    fallback: tuple[Frame, ...] = ()
    if function.location is not None:
        fallback = locations.function(function.location)
    following = next((chain for _, chain in chains if chain), fallback)
    lines = {}
    for instruction, chain in chains:
        following = chain or following
        lines[id(instruction)] = (following, not chain)
    return lines


# ---- Uses of values: as an address, to decide a branch, or as data.
# A value feeds an address if a pointer operand is computed from it without an intervening call or comparison; also
# through a parameter of a function that was not inlined, and through memory: a value stored to memory from which an
# address is loaded later (an index in an array, a result returned through a pointer).  Memory is distinguished by the
# origin of its pointers: a parameter, the stack, or a call.
#
# A value decides control if a branch, switch or select depends on it without an intervening load, call or
# floating-point comparison: loop counters and bounds do.

ADDRESS = "address"
"""Value class: an address is computed from the value."""
CONTROL = "control"
"""Value class: a branch, switch or select depends on it."""
FLOATING = "floating_point"
"""Value class: a floating-point number that decides neither."""
INTEGER = "integer"
"""Value class: an integer that decides neither."""
DATA = (FLOATING, INTEGER)
"""Value classes that feed neither addresses nor branches."""
_ADDRESS_STOPS = ("load", "call", "icmp", "fcmp")
"""Operations at which the search for values that feed an address ends."""
_CONTROL_STOPS = ("load", "call", "fcmp")
"""Operations at which the search for values that decide control ends."""


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
        if instruction.result in self.conditions:
            return CONTROL
        return INTEGER


def roles(module: Module) -> dict[str, Roles]:
    """Roles of the values of each function in the fault space, by function name."""
    flows = {function.name: _Flow(function) for function in module.functions}
    growing = True
    while growing:
        growths = [flow.grow(flows) for flow in flows.values()]  # all of them, in each round
        growing = any(growths)
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
        # Values that are used as an address, here, in a callee, or after they were stored and loaded again.
        seeds = set(self.addresses)
        for instruction in self.instructions:
            seeds.update(instruction.addresses)
            if instruction.opcode == "store" and self.origins(instruction.tokens[5]) & self.indices:
                seeds.add(instruction.tokens[2])
            callee = flows.get(str(instruction.callee))
            if callee is not None:
                seeds.update(self._exchange(instruction, callee))
        # They, and what they are computed from, feed addresses; so does the memory from which they were loaded.
        self.addresses |= _sources(seeds, self.made_by, _ADDRESS_STOPS)
        for instruction in self.instructions:
            if instruction.opcode == "load" and instruction.result in self.addresses:
                self.indices |= self.origins(instruction.tokens[4])
        return len(self.addresses) + len(self.indices) > before

    def _exchange(self, call: Instruction, callee: "_Flow") -> set[str]:
        """Exchange the memory that holds indices with a callee; returns the arguments that it uses in addresses."""
        in_addresses = set()
        for (_, name), (_, argument) in zip(callee.function.parameters, call.arguments, strict=True):
            if name in callee.addresses:
                in_addresses.add(argument)
            origins = self.origins(argument)
            if name in callee.indices:
                self.indices |= origins
            elif origins & self.indices:
                callee.indices.add(name)
        return in_addresses

    def origins(self, pointer: str) -> frozenset[str]:
        """Origins of a pointer: parameters, allocations, calls, loads."""
        if pointer not in self.known_origins:
            chain = _closure([pointer], lambda name: _pointers(self.made_by.get(name)))
            origins = (name for name in chain if name[0] == "%" and not _pointers(self.made_by.get(name)))
            self.known_origins[pointer] = frozenset(origins)
        return self.known_origins[pointer]

    def roles(self) -> Roles:
        """The roles of the values, at the fixed point."""
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
        if maker is None or maker.opcode in stops:
            return []
        return maker.uses()

    return {name for name in _closure(names, uses) if name[0] == "%"}


def _closure(names: Iterable[str], successors: Callable[[str], list[str]]) -> set[str]:
    """Transitive closure of names under `successors`."""
    closure: set[str] = set()
    waiting = list(names)
    while waiting:
        name = waiting.pop()
        if name not in closure:
            closure.add(name)
            waiting += successors(name)
    return closure


# ---- Selection of injectable instructions: all, floating point, data, one class or opcode, or some source lines.

FORM = "all, floating_point, data, address, control, integer, opcode:NAME, or line:FILE:FIRST[-LAST]"
"""Forms of a selection, for messages."""
_CLASSES = (ADDRESS, CONTROL, INTEGER)
"""Value classes that a selection names as they are; `floating_point` and `data` are handled apart."""
_LINES = re.compile(r"line:(?P<file>[^:]+):(?P<first>\d+)(-(?P<last>\d+))?")
"""A selection of source lines."""


@dataclass(frozen=True, slots=True)
class Selection:
    """A class of instructions.

    Attributes:
        kind: "all"; "floating_point": by result type, whatever its use; "data": feeds neither an address nor a branch;
            "address", "control", "integer": by value class; "opcode"; "line".
        opcode: As in LLVM's language reference.
        file: End of a source file's path; lines `first` to `last` of it are in the class.
    """

    kind: str = "all"
    opcode: str = ""
    file: str = ""
    first: int = 0
    last: int = 0

    def __contains__(self, site: InjectionSite) -> bool:
        """Whether an instruction is in the class; any line of its chain of inlined calls counts."""
        if self.kind == "floating_point":
            return site.floating
        if self.kind == "data":
            return site.value_class in DATA
        if self.kind == "opcode":
            return site.opcode == self.opcode
        if self.kind == "line":
            return any(self._holds(frame.file, frame.line) for frame in site.chain)
        return self.kind in ("all", site.value_class)

    def _holds(self, file: str, line: int) -> bool:
        return f"/{file}".endswith(f"/{self.file}") and self.first <= line <= self.last


def parse_selection(text: str) -> Selection:
    """Parse a class of instructions; the BadInputError names the allowed ones."""
    if text in ("all", "floating_point", "data", *_CLASSES):
        return Selection(text)
    kind, _, rest = text.partition(":")
    if kind == "opcode" and rest.isalpha():
        return Selection("opcode", opcode=rest)
    lines = _LINES.fullmatch(text)
    if lines is None:
        raise BadInputError(f"instructions {text!r}: not understood; allowed: {FORM}")
    first = int(lines["first"])
    return Selection("line", file=lines["file"], first=first, last=int(lines["last"] or first))
