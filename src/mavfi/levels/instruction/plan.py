"""Instruction faults: choice of the instruction, and of its bits."""

import re
from collections.abc import Sequence
from typing import Any

import numpy as np

from mavfi.errors import BadInputError, not_known
from mavfi.ir.injection.table import InjectionSite
from mavfi.levels.instruction.fault import MODELS, InstructionFault, Model

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
