"""Faults in instructions as data: which dynamic instruction, what becomes of its result, and what then happened."""

import struct
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np

from mavfi.errors import BadInputError
from mavfi.faults.instruction.table import Site
from mavfi.faults.instruction.variant import Report

Model = Literal["one_bit", "bits", "random", "zero"]
MODELS = ("one_bit", "bits", "random", "zero")
_ALL = -1
_FORMATS = {"double": "<d", "float": "<f", "half": "<e"}


@dataclass(frozen=True, slots=True)
class InstructionFault:
    """A planned fault in one dynamic instruction of one call of one kernel.

    Attributes:
        kernel: Module and name of the function.
        ir_sha256: Digest of the IR in which the index counts; other machine code is refused.
        index: Which of the values that the call writes, from 0.
        call: Which call of the flight, from 0.
        bits: Bits that are flipped; empty: the whole value is replaced.
        value: What replaces it, as an integer.
        budget: Values that the call may write before it counts as hanging; 0 = three times as many as without a fault
            and 10,000 more.
        which: The class of instructions from which it was drawn.
        model: The kind of fault.
    """

    kernel: str
    ir_sha256: str
    index: int
    call: int = 0
    bits: tuple[int, ...] = ()
    value: int = 0
    budget: int = 0
    which: str = "all"
    model: Model = "one_bit"

    @property
    def masks(self) -> tuple[int, int]:
        """Keep and flip: the value becomes (value & keep) ^ flip."""
        if self.bits:
            return _ALL, sum(1 << bit for bit in self.bits)
        return 0, self.value

    def to_json(self) -> dict[str, Any]:
        """Plain data; the value as hexadecimal text, since it may have more bits than numbers in JSON."""
        return asdict(self) | {"bits": list(self.bits), "value": hex(self.value)}

    @staticmethod
    def from_json(data: dict[str, Any]) -> "InstructionFault":
        """Inverse of `to_json`."""
        return InstructionFault(**{**data, "bits": tuple(data["bits"]), "value": int(data["value"], 16)})


@dataclass(frozen=True, slots=True)
class Strike:
    """What a fault did to the value that it struck.

    Attributes:
        fault: What was planned.
        hit: Whether the instruction was executed, and its result became what was planned.
        site: The static instruction; None if the index was not reached.
        before: Bits of its result, as an integer; None if the index was not reached.
        after: The same after the strike.
    """

    fault: InstructionFault
    hit: bool
    site: Site | None = None
    before: int | None = None
    after: int | None = None

    def number(self, bits: int | None) -> float | int | None:
        """`before` or `after` as the number that its type holds: floating point, or signed integer."""
        if bits is None or self.site is None:
            return None
        if self.site.kind in _FORMATS:
            layout = _FORMATS[self.site.kind]
            return float(struct.unpack(layout, bits.to_bytes(struct.calcsize(layout), "little"))[0])
        sign = 1 << (self.site.width - 1)
        return bits if self.site.kind == "ptr" or self.site.width == 1 else (bits ^ sign) - sign

    def to_json(self) -> dict[str, Any]:
        """Plain data: the fault, what was struck where in the source, and the bits before and after."""
        data: dict[str, Any] = self.fault.to_json() | {"hit": self.hit}
        if self.site is None:
            return data
        site = self.site
        return data | {
            "file": site.file, "line": site.line, "line_is_near": site.near,
            "chain": [f"{frame.function}:{frame.line}" for frame in site.chain], "opcode": site.opcode,
            "type": site.kind, "width": site.width, "value_class": site.value_class, "variable": site.variable,
            "before": hex(self.before or 0), "after": hex(self.after or 0),
        }  # fmt: skip


def strike_of(fault: InstructionFault, report: Report | None) -> Strike:
    """What became of a fault, from what the machine code reported."""
    if report is None:
        return Strike(fault, hit=False)
    keep, flip = fault.masks
    whole = (1 << report.site.width) - 1
    planned = (report.before & keep) ^ flip
    hit = planned == report.after and not report.after & ~whole
    return Strike(fault, hit, report.site, report.before, report.after)


def plan(
    random: np.random.Generator, kernel: str, ir_sha256: str, site: Site, index: int, model: Model = "one_bit",
    count: int = 2,
) -> InstructionFault:  # fmt: skip
    """Choose what happens to the result of an instruction.

    Args:
        random: Stream of the fault.
        kernel: Module and name.
        ir_sha256: Digest of the IR.
        site: The static instruction that has the index.
        index: Which dynamic instruction.
        model: "one_bit", uniform; "bits": `count` distinct ones; "random": any value; "zero".
        count: For "bits"; no more than the value has.

    Raises:
        BadInputError: There is no such model.
    """
    if model not in MODELS:
        raise BadInputError(f"fault model {model!r}: not known; allowed: {', '.join(MODELS)}")
    bits: tuple[int, ...] = ()
    value = 0
    if model in ("one_bit", "bits"):
        drawn = random.choice(site.width, size=min(1 if model == "one_bit" else count, site.width), replace=False)
        bits = tuple(sorted(int(bit) for bit in drawn))
    elif model == "random":
        value = int.from_bytes(random.bytes(-(-site.width // 8)), "little") & ((1 << site.width) - 1)
    return InstructionFault(kernel, ir_sha256, index, bits=bits, value=value, model=model)
