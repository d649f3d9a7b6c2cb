"""Duplication of instructions in the IR of a kernel, after all optimisation.

Each chosen value gets a *shadow*, computed by the same instruction from the shadows of its operands.  A shadow whose
operands are all shared with the original takes one of them through an empty assembly, or loads again by a volatile
load: code generation can merge neither.  Where a value leaves the chosen set (a store, a call, a return, a value that
is not chosen), its bits are compared with those of its shadow; both edges of a branch check the shadow of its
condition.  On a difference the function returns `DETECTED`, which every caller in the module hands on.
"""

import re
from collections.abc import Collection

from mavfi.hardening.plan import Site
from mavfi.ir.module import Instruction, Module, width

DETECTED = -4
"""Status of a protected function whose value and shadow differ.  Numba's wrapper turns it into a SystemError; the
statuses 0 to -3 have a meaning there, positive ones are the kernel's own exceptions."""
_PURE = re.compile(
    r"@llvm\.(?:[us](?:min|max)|abs|floor|ceil|trunc|rint|nearbyint|round|roundeven|fabs|sqrt|copysign|fma|"
    r"min(?:num|imum)|max(?:num|imum)|fshl|fshr|ctpop|ctlz|cttz|bswap|bitreverse|is\.fpclass|masked\.(?:load|gather)|"
    r"[us](?:add|sub)\.sat|vector\.reduce\.\w+)(?:\.|$)"
)
_LIBM = re.compile(
    r"@(?:llvm\.(?:sin|cos|tan|pow|powi|exp|exp2|log|log2|log10)\.|"
    r"(?:sin|cos|tan|asin|acos|atan|atan2|sinh|cosh|tanh|pow|exp|exp2|expm1|log|log2|log10|log1p|hypot|cbrt)f?$)"
)
_MEMORY = re.compile(r"@llvm\.masked\.(?:load|gather)\.")
_WORD = re.compile(r"i(?:8|16|32|64)|ptr")
_VECTOR = re.compile(r"<\d+ x (?:double|float|i64|i32|i16|i8|ptr)>")


def protect(module: Module, sites: Collection[Site], *, addresses: bool, libm: bool = False) -> Module:
    """A module in which the values at the given sites are duplicated and compared.

    Fault-free results are bit-identical.  Results of the original instructions keep their names, so that the sites of
    both modules can be paired.

    Args:
        module: The parsed module; it is not modified.
        sites: What to duplicate; sites that `candidates` does not name are ignored.
        addresses: Whether the addresses of loads are compared before the loads, too.
        libm: Whether calls of mathematical functions can be duplicated.

    Returns:
        The protected module; an equal one for no sites.
    """
    raise NotImplementedError


def candidates(module: Module, *, libm: bool = False) -> list[Site]:
    """All sites that can be duplicated, in text order."""
    return [
        Site(i, j, k)
        for i, function in enumerate(module.functions)
        if function.kind == "i32"  # another type has no status to report by
        for j, block in enumerate(function.blocks)
        for k, instruction in enumerate(block.sites)
        if can_repeat(instruction, libm=libm)
    ]


def can_repeat(instruction: Instruction, *, libm: bool = False) -> bool:
    """Whether an instruction may be executed twice: it has a result, and no effect but that."""
    if instruction.result is None or instruction.kind[0] in "{[" or instruction.opcode == "alloca":
        return False
    if instruction.opcode == "call":
        callee = str(instruction.callee)
        return bool(_PURE.match(callee) or (libm and _LIBM.match(callee)))
    return instruction.opcode not in ("extractvalue", "insertvalue")


def reads_memory(instruction: Instruction) -> bool:
    """Whether an instruction is a load, of one or several elements."""
    return instruction.opcode == "load" or bool(_MEMORY.match(str(instruction.callee)))


def register_of(kind: str) -> str | None:
    """Constraint of the assembly through which a value of a type is copied; None = no register takes it."""
    if _WORD.fullmatch(kind):
        return "=r,0"
    if kind in ("double", "float") or (_VECTOR.fullmatch(kind) and width(kind) == 128):
        return "=x,0"
    return None
