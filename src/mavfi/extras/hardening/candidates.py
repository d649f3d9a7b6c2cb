"""Which instructions can be duplicated, and how a value is copied so that code generation cannot merge it."""

import re

from mavfi.extras.hardening.plan import Site
from mavfi.ir.module import Function, Instruction, Module, width

_PURE = re.compile(
    r"@llvm\.(?:[us](?:min|max)|abs|floor|ceil|trunc|rint|nearbyint|round|roundeven|fabs|sqrt|copysign|fma|"
    r"min(?:num|imum)|max(?:num|imum)|fshl|fshr|ctpop|ctlz|cttz|bswap|bitreverse|is\.fpclass|masked\.(?:load|gather)|"
    r"[us](?:add|sub)\.sat|vector\.reduce\.\w+)(?:\.|$)|@(?:sqrt|fabs|floor|ceil|trunc|rint)f?$"
)
_MEMORY = re.compile(r"@llvm\.masked\.(?:load|gather)\.")
_WORD = re.compile(r"i(?:8|16|32|64)|ptr")
_SMALL = re.compile(r"i[1-7]")
_VECTOR = re.compile(r"<\d+ x (?:double|float|i64|i32|i16|i8|ptr)>")


def candidates(module: Module) -> list[Site]:
    """All sites that can be duplicated, in text order."""
    able = reporting(module)
    return [
        Site(i, j, k)
        for i, function in enumerate(module.functions)
        if function.name in able
        for kinds in [kinds_of(function)]
        for j, block in enumerate(function.blocks)
        for k, instruction in enumerate(block.sites)
        if can_repeat(instruction) and _can_differ(instruction, kinds)
    ]


def reporting(module: Module) -> set[str]:
    """Functions that can return a status, and are called only by such functions and by Numba's wrapper."""
    able = {function.name for function in module.functions if function.kind == "i32"}
    calls = [(function.name, called) for function in module.functions for called in callees(function)]
    while True:
        lost = {called for caller, called in calls if caller not in able} & able
        if not lost:
            return able
        able -= lost


def callees(function: Function) -> set[str]:
    """Names of the functions that a function calls."""
    return {
        instruction.callee for block in function.blocks for instruction in block.body if instruction.callee is not None
    }


def can_repeat(instruction: Instruction) -> bool:
    """Whether an instruction may be executed twice: it has a result, and no effect but that."""
    if instruction.result is None or instruction.kind[0] in "{[" or instruction.opcode == "alloca":
        return False
    if instruction.opcode == "call":
        return bool(_PURE.match(str(instruction.callee)))
    return instruction.opcode not in ("extractvalue", "insertvalue")


def _can_differ(instruction: Instruction, kinds: dict[str, str]) -> bool:
    """Whether its shadow can be kept apart from it, if all its operands are duplicated or copied."""
    if instruction.opcode == "phi":
        return can_copy(instruction.kind)
    return instruction.opcode == "load" or any(name in kinds for name in instruction.uses())


def reads_memory(instruction: Instruction) -> bool:
    """Whether an instruction is a load, of one or several elements."""
    return instruction.opcode == "load" or bool(_MEMORY.match(str(instruction.callee)))


def can_copy(kind: str) -> bool:
    """Whether a value of a type can be copied through a register."""
    return constraint_of(kind) is not None or bool(_SMALL.fullmatch(kind))


def constraint_of(kind: str) -> str | None:
    """Constraint of the assembly through which a value of a type is copied; None = no register takes it."""
    if _WORD.fullmatch(kind):
        return '"=r,0"'
    if kind in ("double", "float") or (_VECTOR.fullmatch(kind) and width(kind) == 128):
        return '"=x,0"'
    return None


def kinds_of(function: Function) -> dict[str, str]:
    """Types of a function's values, by name."""
    parameters = {name: kind.removesuffix(" signext").removesuffix(" zeroext") for kind, name in function.parameters}
    made = {
        str(one.result): one.kind for block in function.blocks for one in block.all() if one.result is not None
    }  # fmt: skip
    return parameters | made
