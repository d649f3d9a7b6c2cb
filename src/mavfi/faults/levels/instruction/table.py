"""The sites of an instrumented kernel: its static instructions and their source lines."""

import sys
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from mavfi.faults.levels.instruction.classify import roles
from mavfi.ir.metadata import Frame, Locations
from mavfi.ir.module import Block, Function, Module, is_floating, width


@dataclass(frozen=True, slots=True)
class Site:
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
        all_frames = [(short_path(frame.file), frame.line) for frame in self.chain]
        return [frame for frame in all_frames if not frame[0].startswith("numba/")] or all_frames[:1]

    @property
    def file(self) -> str:
        """Source file, relative to the folder from which it was imported."""
        return self.frames[0][0] if self.chain else ""

    @property
    def line(self) -> int:
        """Source line; 0 = unknown."""
        return self.frames[0][1] if self.chain else 0

    def __str__(self) -> str:
        variable = f" ({self.variable})" if self.variable else ""
        role = f" ({self.role})" if self.role else ""
        return f"{self.file}:{self.line} {self.opcode} {self.kind}{variable}{role}"


def short_path(path: str) -> str:
    """A path relative to its folder on Python's path, so that records do not depend on the machine."""
    return _relative_to_longest(path, tuple(sys.path))


@lru_cache(maxsize=1024)
def _relative_to_longest(path: str, folders: tuple[str, ...]) -> str:
    roots = [entry for entry in folders if entry and path.startswith(f"{entry.rstrip('/')}/")]
    longest = max(roots, key=len, default="")
    return str(Path(path).relative_to(longest)) if longest else path


@dataclass(frozen=True, slots=True)
class Table:
    """All sites of a kernel, by block in the order of dynamic indices."""

    blocks: tuple[tuple[Site, ...], ...]

    def sizes(self) -> list[int]:
        """Number of sites of each block."""
        return [len(block) for block in self.blocks]

    def executions(self, times: np.ndarray) -> list[tuple[Site, int]]:
        """All sites with the execution counts of their blocks. Shape (blocks,)."""
        return [(site, int(number)) for block, number in zip(self.blocks, times, strict=True) for site in block]

    def files(self) -> set[str]:
        """All source files."""
        return {frame.file for block in self.blocks for site in block for frame in site.chain}

    def to_json(self) -> list[list[dict[str, Any]]]:
        """Plain data."""
        return [[asdict(site) for site in block] for block in self.blocks]

    @staticmethod
    def from_json(data: list[list[dict[str, Any]]]) -> "Table":
        """Inverse of `to_json`."""
        frames: dict[str, tuple[Frame, ...]] = {}

        def chain(rows: list[dict[str, Any]]) -> tuple[Frame, ...]:
            key = repr(rows)
            if key not in frames:
                frames[key] = tuple(Frame(**row) for row in rows)
            return frames[key]

        return Table(tuple(tuple(Site(**{**row, "chain": chain(row["chain"])}) for row in block) for block in data))


def make_table(module: Module) -> Table:
    """The sites of all blocks that have any, in text order."""
    used = roles(module)
    locations = Locations(module.metadata)
    blocks: list[tuple[Site, ...]] = []
    for function in module.functions:
        for block in function.blocks:
            if block.sites:
                chains = _chains(block, function, locations)
                blocks.append(
                    tuple(
                        Site(
                            len(blocks), offset, site.opcode, site.kind, width(site.kind), used[function.name].of(site),
                            *chains[id(site)], site.variable, site.role,
                        )
                        for offset, site in enumerate(block.sites)
                    )
                )  # fmt: skip
    return Table(tuple(blocks))


def _chains(block: Block, function: Function, locations: Locations) -> dict[int, tuple[tuple[Frame, ...], bool]]:
    """Source lines of each instruction, and whether they are borrowed from the next instruction that has some."""
    own = []
    for instruction in reversed(block.all()):
        chain = () if instruction.location is None else locations.chain(instruction.location)
        own.append((instruction, chain if chain and chain[0].line else ()))
    fallback = () if function.location is None else locations.function(function.location)
    following = next((chain for _, chain in own if chain), fallback)
    found = {}
    for instruction, chain in own:
        following = chain or following
        found[id(instruction)] = (following, not chain)
    return found
