"""The planned change of the result of one dynamic instruction."""

import struct
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, Self, get_args

from mavfi.errors import BadInputError
from mavfi.faults.fault import NO_SITE, RESTART_S, CallFault, is_detector
from mavfi.flight.targets import counter_name
from mavfi.ir.build import name_of
from mavfi.ir.injection.table import DATA, InjectionSite
from mavfi.ir.injection.variant import InjectionReport, MismatchError, Variant
from mavfi.record import Injection

_FORMATS = {"double": "<d", "float": "<f", "half": "<e"}
"""Codes of `struct` for the floating-point types of LLVM."""
Model = Literal["one_bit", "bits", "random", "zero", "low_byte", "high_bits"]
"""How an instruction fault changes a value, see `plan.plan`."""
MODELS: tuple[Model, ...] = get_args(Model)
"""All of these, the default first."""
MOST_CALLS = 100
"""Largest `InstructionFault.times`: each of the calls has a process."""


@dataclass(frozen=True, slots=True)
class InstructionFault(CallFault):
    """The result of one dynamic instruction in one call of a compiled function, once or in several calls.

    Attributes:
        function: Module and name of a custom function; "" = `kernel` and `entry` name it, wherever its source is.
        ir_sha256: Digest of the IR to which the index refers; other machine code is rejected.
        index: Dynamic index among the values that the call writes, from 0.
        call: Index of the call in the flight, from 0; `NO_SITE` = the kernel executes no such instruction.
        bits: Bits to flip; empty: the whole value is replaced.
        value: Replacement value, as an integer.
        budget: Values that the call may write before it counts as a hang; 0 = three times the fault-free number plus
            10,000.
        which: Class of instructions from which it was drawn.
        model: How the value is changed.
        kernel: Kernel for which it was drawn, as in `states.KERNELS`, or name of a plug-in; "" = a custom function.
        entry: Attribute of `pipeline.functions.KernelFunctions`, or function of the plug-in; "" = a custom function.
        value_class: "floating_point", "integer", "address" or "control".
        restart_s: Time after which a crashed node has restarted (s).
        stratum: Meaning of the bit: "sign", "exponent", "mantissa" or "other"; "" if not drawn.
        weight: Probability of its value class and line in a uniform draw / in this draw; 1 = equal.
        seed: Seed of the draw.
        times: Number of calls, from `call` on, in which the value with this index is changed, also after restarts of
            the node.
        role: Kind of the plug-in, as in `states.PLUG_INS`; "" = a kernel or detector of mavfi.
    """

    level: ClassVar[Literal["instruction"]] = "instruction"
    later_fields: ClassVar[tuple[str, ...]] = ("times", "role")
    function: str
    ir_sha256: str
    index: int
    call: int = 0
    bits: tuple[int, ...] = ()
    value: int = 0
    budget: int = 0
    which: str = "all"
    model: Model = "one_bit"
    kernel: str = ""
    entry: str = ""
    value_class: str = ""
    restart_s: float = RESTART_S
    stratum: str = ""
    weight: float = 1.0
    seed: int = 0
    times: int = 1
    role: str = ""

    def __post_init__(self) -> None:
        if not 1 <= self.times <= MOST_CALLS:
            raise BadInputError(f"fault in {self.site}: times: {self.times}: allowed: 1 to {MOST_CALLS}")

    @property
    def site(self) -> str:
        """Kernel and function as text."""
        if self.kernel:
            return f"{self.kernel}.{self.entry}"
        return self.function

    @property
    def bit(self) -> int | None:
        """The flipped bit, if there is exactly one."""
        if len(self.bits) == 1:
            return self.bits[0]
        return None

    @property
    def has_site(self) -> bool:
        """Whether the golden run executed such an instruction."""
        return self.call != NO_SITE

    @property
    def bit_class(self) -> str:
        """Meaning of the bit in the value."""
        return self.stratum

    @property
    def in_detector(self) -> bool:
        """See `Fault.in_detector`."""
        return is_detector(self.kernel, self.role)

    @property
    def counter(self) -> str:
        """Name under which a flight counts the calls of its function."""
        return counter_name(self.kernel, self.role, self.entry)

    @property
    def masks(self) -> tuple[int, int]:
        """Keep and flip masks: the value becomes (value & keep) ^ flip."""
        if self.bits:
            return -1, sum(1 << bit for bit in self.bits)
        return 0, self.value

    def check(self, variant: Variant, function: Any) -> None:
        """See `CallFault.check`."""
        if self.function and self.function != name_of(function):
            raise MismatchError(f"fault in {self.function}: given to {name_of(function)}")
        if self.ir_sha256 != variant.ir_sha256:
            raise MismatchError(
                f"fault in {self.site}: drawn for IR {self.ir_sha256[:12]}, this is {variant.ir_sha256[:12]}: "
                "source, numba or llvmlite differ"
            )

    def injection(self, report: InjectionReport | None, time_s: float = 0.0, call: int | None = None) -> Injection:
        """See `CallFault.injection`.

        Its values are numbers of the instruction's type (signed integers); the details contain their bits as
        hexadecimal text.
        """
        # Without a report the instruction was not reached: there are no values.
        function = self.entry or self.function
        if call is None:
            call = self.call
        if report is None:
            details: dict[str, Any] = {"function": function, "replayable": True}
            return Injection(self.level, self.site, time_s, self.bit, None, None, activated=False, details=details)
        # What was planned, to compare it with what the machine code reports.
        site = report.site
        before = report.before
        after = report.after
        keep, flip = self.masks
        planned = (before & keep) ^ flip
        # Only a call in planned memory has the same effect everywhere if its addresses or branches are changed.
        replayable = report.planned or site.value_class in DATA
        # Where the instruction is, what it computes, and the bits as they were.
        details = {
            "function": function,
            "replayable": replayable,
            "call": call,
            "index": self.index,
            "block": site.block,
            "offset": site.offset,
            "opcode": site.opcode,
            "type": site.kind,
            "width": site.width,
            "value_class": site.value_class,
            "line_is_near": site.near,
            "inlined": [f"{file}:{line}" for file, line in site.frames[1:]],
            "variable": site.variable or "",
            "ir_sha256": self.ir_sha256,
            "bits": list(self.bits),
            "model": self.model,
            "before_bits": hex(before),
            "after_bits": hex(after),
        }
        if site.role:
            details["role"] = site.role
        # Activated: the value became what was planned, and the flipped bits belong to it.
        return Injection(
            self.level,
            self.site,
            time_s,
            self.bit,
            _number(site, before),
            _number(site, after),
            activated=planned == after and not after >> site.width,
            file=site.file,
            line=site.line,
            details=details,
        )

    def to_json(self) -> dict[str, Any]:
        """Plain data; the value as hexadecimal text, since it may exceed the range of JSON numbers."""
        return {**super(InstructionFault, self).to_json(), "bits": list(self.bits), "value": hex(self.value)}

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Self:
        """Inverse of `to_json`, without the level; invalid data is a BadInputError."""
        try:
            value = int(data["value"], 16)
        except (KeyError, TypeError, ValueError):
            raise BadInputError("fault of level instruction: key 'value': allowed: a hexadecimal number") from None
        return super(InstructionFault, cls).from_json({**data, "value": value})


def _number(site: InjectionSite, bits: int) -> float | int:
    """Bits as a number of the instruction's type: floating point, or signed integer."""
    if site.kind in _FORMATS:
        layout = _FORMATS[site.kind]
        return float(struct.unpack(layout, bits.to_bytes(struct.calcsize(layout), "little"))[0])
    sign = 1 << (site.width - 1)
    if site.kind == "ptr" or site.width == 1:
        return bits
    return (bits ^ sign) - sign
