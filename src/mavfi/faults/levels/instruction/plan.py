"""Instruction faults: choice of instruction and bits, match of fault and function, and record of the injection."""

import re
import struct
from collections.abc import Sequence
from typing import Any

import numpy as np

from mavfi.errors import BadInputError, not_known
from mavfi.faults.fault import MODELS, InstructionFault, Model
from mavfi.faults.levels.instruction.table import FLOATING, INTEGER, InjectionSite
from mavfi.faults.levels.instruction.variant import InjectionReport, MismatchError, Variant
from mavfi.ir.build import name_of
from mavfi.record import Injection

DATA = (FLOATING, INTEGER)
"""Value classes that feed neither addresses nor branches."""
_FORMATS = {"double": "<d", "float": "<f", "half": "<e"}
"""Codes of `struct` for the floating-point types of LLVM."""
_LAYOUTS = {"double": (63, 52), "float": (31, 23), "half": (15, 10)}
"""Sign bit and lowest exponent bit of these types (IEEE 754)."""


def choose(random: np.random.Generator, counts: Sequence[int], n: int) -> list[tuple[int, int]]:
    """Draw dynamic instructions of a whole flight, uniformly; returns call and index in the call, in draw order.

    `counts` has the number of instructions of each call; those of several functions may be concatenated.
    """
    ends = np.cumsum(counts)
    positions = random.integers(int(ends[-1]), size=n)
    calls = np.searchsorted(ends, positions, side="right")
    starts = ends - np.asarray(counts)
    return [(int(call), int(position - starts[call])) for call, position in zip(calls, positions, strict=True)]


def plan(
    random: np.random.Generator,
    function: str,
    ir_sha256: str,
    site: InjectionSite,
    index: int,
    model: Model = "one_bit",
    count: int = 2,
    **fields: Any,
) -> InstructionFault:
    """Choose how the result of a dynamic instruction is changed.

    Args:
        random: Random stream of the fault.
        function: Module and name of a custom function; "" for one of a kernel, which `fields` name.
        ir_sha256: Digest of the IR.
        site: The static instruction.
        index: Dynamic index.
        model: "one_bit", uniform; "bits": `count` distinct bits, or all if fewer; "random": any value; "zero";
            "low_byte" and "high_bits": one bit, uniform in a part of the value, see `_bit_range`.
        count: Number of bits for "bits".
        **fields: Further fields of the fault.

    Raises:
        BadInputError: Unknown model.
    """
    if model not in MODELS:
        raise BadInputError(f"fault model {not_known(model, MODELS)}")
    if model == "one_bit":
        count = 1
    bits: tuple[int, ...] = ()
    value = 0  # of the model "zero"
    if model in ("low_byte", "high_bits"):
        bit_range = _bit_range(model, site.width)
        bits = (int(random.integers(bit_range.start, bit_range.stop)),)
    elif model in ("one_bit", "bits"):
        drawn = random.choice(site.width, size=min(count, site.width), replace=False)
        bits = tuple(sorted(int(bit) for bit in drawn))
    elif model == "random":
        value = int.from_bytes(random.bytes(-(-site.width // 8)), "little") & ((1 << site.width) - 1)
    single_bit = None
    if len(bits) == 1:
        single_bit = bits[0]
    return InstructionFault(
        function,
        ir_sha256,
        index,
        bits=bits,
        value=value,
        model=model,
        value_class=site.value_class,
        stratum=stratum_of(site.kind, single_bit),
        **fields,
    )


def _bit_range(model: Model, width: int) -> range:
    """Bits of a value from which models of the authors' injector of registers draw (MAVBench/MAV_apps, branch mavfi).

    "high_bits": the range that it draws from by default, bits 52 to 62 of 64; in other widths all bits.  "low_byte":
    what it changes, since its write reaches byte 0 of the register only; in a narrower value all bits.
    """
    if model == "low_byte":
        return range(min(8, width))
    if width == 64:
        return range(52, 63)
    return range(width)


def stratum_of(kind: str, bit: int | None) -> str:
    """Class of a value's bit: "sign", "exponent" or "mantissa"; "other" for integers, pointers, or without a bit.

    `kind` is an LLVM type; in a vector the bit index runs over its elements.
    """
    element = re.sub(r"<\d+ x (\w+)>", r"\1", kind)
    if bit is None or element not in _LAYOUTS:
        return "other"
    sign, exponent = _LAYOUTS[element]
    bit_in_element = bit % (sign + 1)
    if bit_in_element == sign:
        return "sign"
    if bit_in_element >= exponent:
        return "exponent"
    return "mantissa"


_HANG_FACTOR = 3
"""Budget of an injected call / number of values that it writes without a fault: a slower one is a hang."""
_HANG_MARGIN = 10_000
"""Further values in the budget, for short calls."""


def budget_for(total: int) -> int:
    """Number of values after which a call counts as a hang, if it writes `total` without a fault."""
    return _HANG_FACTOR * total + _HANG_MARGIN


def check_fault(fault: InstructionFault, variant: Variant, function: Any) -> None:
    """Raise a MismatchError if a fault was drawn for another function or other machine code."""
    if fault.function and fault.function != name_of(function):
        raise MismatchError(f"fault in {fault.function}: given to {name_of(function)}")
    if fault.ir_sha256 != variant.ir_sha256:
        raise MismatchError(
            f"fault in {fault.site}: drawn for IR {fault.ir_sha256[:12]}, this is {variant.ir_sha256[:12]}: "
            "source, numba or llvmlite differ"
        )


def injection_of(
    fault: InstructionFault, report: InjectionReport | None, time_s: float = 0.0, call: int | None = None
) -> Injection:
    """The record of an injection at an instant (s), from the report of the machine code (None = not reached).

    Its values are numbers of the instruction's type (signed integers); the details contain their bits as hexadecimal
    text. `call` is the injected call, if not the planned one.
    """
    # Without a report the instruction was not reached: there are no values.
    function = fault.entry or fault.function
    if call is None:
        call = fault.call
    if report is None:
        details: dict[str, Any] = {"function": function, "replayable": True}
        return Injection(fault.level, fault.site, time_s, fault.bit, None, None, activated=False, details=details)
    # What was planned, to compare it with what the machine code reports.
    site = report.site
    before = report.before
    after = report.after
    keep, flip = fault.masks
    planned = (before & keep) ^ flip
    # Only a call in planned memory has the same effect everywhere if its addresses or branches are changed.
    replayable = report.planned or site.value_class in DATA
    # Where the instruction is, what it computes, and the bits as they were.
    details = {
        "function": function,
        "replayable": replayable,
        "call": call,
        "index": fault.index,
        "block": site.block,
        "offset": site.offset,
        "opcode": site.opcode,
        "type": site.kind,
        "width": site.width,
        "value_class": site.value_class,
        "line_is_near": site.near,
        "inlined": [f"{file}:{line}" for file, line in site.frames[1:]],
        "variable": site.variable or "",
        "ir_sha256": fault.ir_sha256,
        "bits": list(fault.bits),
        "model": fault.model,
        "before_bits": hex(before),
        "after_bits": hex(after),
    }
    if site.role:
        details["role"] = site.role
    # Activated: the value became what was planned, and the flipped bits belong to it.
    return Injection(
        fault.level,
        fault.site,
        time_s,
        fault.bit,
        _number(site, before),
        _number(site, after),
        activated=planned == after and not after >> site.width,
        file=site.file,
        line=site.line,
        details=details,
    )


def changed_nothing(report: InjectionReport | None) -> bool:
    """Whether nothing changed: the index was not reached, or its value has no such bit."""
    return report is None or not (report.before ^ report.after) & ((1 << report.site.width) - 1)


def _number(site: InjectionSite, bits: int) -> float | int:
    """Bits as a number of the instruction's type: floating point, or signed integer."""
    if site.kind in _FORMATS:
        layout = _FORMATS[site.kind]
        return float(struct.unpack(layout, bits.to_bytes(struct.calcsize(layout), "little"))[0])
    sign = 1 << (site.width - 1)
    if site.kind == "ptr" or site.width == 1:
        return bits
    return (bits ^ sign) - sign
