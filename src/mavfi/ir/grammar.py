"""The LLVM IR instructions supported by the injector, each with its complete syntax."""

import re

from mavfi.ir.lexer import Cursor
from mavfi.ir.module import Instruction, holds_pointer, parts

VOLATILE_LOAD = "load volatile"
"""The first token of such a load."""
ABI_ATTRIBUTES = ("signext", "zeroext")
PROMISES = {
    "captures", "dead_on_return", "dead_on_unwind", "dereferenceable", "dereferenceable_or_null", "immarg",
    "initializes", "noalias", "nocapture", "nofpclass", "nofree", "nonnull", "noundef", "range", "readnone", "readonly",
    "returned", "writable", "writeonly",
}  # fmt: skip
"""Attributes that do not change the machine code, but make a corrupted value undefined behaviour."""
POISON_FLAGS = ("nuw", "nsw", "exact", "inbounds", "nusw", "disjoint", "nneg", "samesign")
FAST_MATH = ("fast", "reassoc", "nnan", "ninf", "nsz", "arcp", "contract", "afn")
_BINARY = {
    "add", "sub", "mul", "udiv", "sdiv", "urem", "srem", "shl", "lshr", "ashr", "and", "or", "xor",
    "fadd", "fsub", "fmul", "fdiv", "frem",
}  # fmt: skip
_CASTS = {
    "trunc", "zext", "sext", "fptrunc", "fpext", "fptoui", "fptosi", "uitofp", "sitofp", "ptrtoint", "inttoptr",
    "bitcast",
}  # fmt: skip
_PREDICATES = {
    "icmp": ("eq", "ne", "ugt", "uge", "ult", "ule", "sgt", "sge", "slt", "sle"),
    "fcmp": ("false", "oeq", "ogt", "oge", "olt", "ole", "one", "ord", "ueq", "ugt", "uge", "ult", "ule", "une", "uno",
             "true"),
}  # fmt: skip
_INTRINSICS = re.compile(
    r"@llvm\.(?:mem(?:set|cpy|move)(?:\.inline)?|[us](?:min|max)|[us](?:add|sub|mul)\.(?:with\.overflow|sat)|abs|floor|"
    r"ceil|trunc|rint|nearbyint|round|roundeven|fabs|sqrt|pow|powi|exp|exp2|log|log2|log10|sin|cos|tan|copysign|fma|"
    r"min(?:num|imum)|max(?:num|imum)|fshl|fshr|ctpop|ctlz|cttz|bswap|bitreverse|[us]shl\.sat|is\.fpclass|"
    r"masked\.(?:load|store|gather|scatter|compressstore|expandload)|vector\.reduce\.\w+|x86\.[\w.]+|"
    r"lro?und|llro?und|ldexp)(?:\.|$)"
)
COPIES = ('"=r,0"', '"=x,0"')
"""Constraints of an empty assembly: its result is its operand, in a general or a vector register."""
_DROPPED = re.compile(
    r"@llvm\.(?:lifetime\.(?:start|end)|assume|experimental\.noalias\.scope\.decl|donothing|invariant\.)"
)
"""Promises in the form of calls; they compute nothing."""
_POISON_ARGUMENT = re.compile(r"@llvm\.(?:abs|ctlz|cttz)\.")
"""Their last argument declares some inputs undefined behaviour."""
_PARALLEL = re.compile(r"@\"?(?:numba_parallel_for|do_scheduling|set_num_threads|get_num_threads|launch_threads)")
_PYTHON = re.compile(r"@\"?numba_gil_ensure")


def parse_instruction(cursor: Cursor) -> Instruction | None:
    """Read one instruction; None for a call that is only a promise; an unknown one is a RefusedError."""
    result = None
    if cursor.next.startswith("%"):
        result = cursor.local()
        cursor.expect("=")
    cursor.accept("tail")
    opcode = cursor.expect(*_READERS)
    volatile = opcode == "load" and cursor.accept("volatile")
    instruction = Instruction(opcode, [VOLATILE_LOAD if volatile else opcode], result)
    while cursor.accept(*POISON_FLAGS):
        pass
    if cursor.next in FAST_MATH:
        raise cursor.refused(f"fast math ({cursor.next!r} in {' '.join(cursor.tokens)[:80]!r})")
    _READERS[opcode](cursor, instruction)
    cursor.finish()
    return None if instruction.callee is not None and _DROPPED.match(instruction.callee) else instruction


def skip_promises(cursor: Cursor) -> list[str]:
    """Skip promise attributes; returns those required by the calling convention."""
    kept = []
    while True:
        if cursor.next in ABI_ATTRIBUTES:
            kept.append(cursor.take())
        elif cursor.next == "align":
            cursor.take()
            cursor.number()
        elif cursor.next in PROMISES:
            cursor.take()
            if cursor.next == "(":
                cursor.balanced()
        else:
            return kept


def _like(kind: str, other: str) -> str:
    """`kind`, or a vector of it if `other` is a vector."""
    return f"{other.split(' x ')[0]} x {kind}>" if other.startswith("<") else kind


def _locals(*values: str) -> list[str]:
    return [value for value in values if value.startswith("%")]


_FORMS = {
    **dict.fromkeys(_BINARY, "kind value , value"), **dict.fromkeys(_CASTS, "kind value to kind"),
    "fneg": "kind value", "freeze": "kind value", "select": "kind value , kind value , kind value",
    "load": "kind , ptr value align", "store": "kind value , ptr value align", "alloca": "kind align",
    "extractvalue": "kind value indices", "insertvalue": "kind value , kind value indices",
    "extractelement": "kind value , kind value", "insertelement": "kind value , kind value , kind value",
    "shufflevector": "kind value , kind value , kind value", "unreachable": "",
}  # fmt: skip
"""Operands of instructions: types, values, an optional alignment, indices, and keywords."""


def _operands(cursor: Cursor, new: Instruction) -> None:
    """Read an instruction with a fixed operand form."""
    kinds = []
    for part in _FORMS[new.opcode].split():
        if part == "kind":
            kinds.append(cursor.kind())
            new.tokens.append(kinds[-1])
        elif part == "value":
            new.tokens.append(cursor.value())
        elif part == "align" and cursor.accept(","):
            cursor.expect("align")
            new.tokens += [",", "align", cursor.number()]
        elif part == "indices":
            while cursor.accept(","):
                new.tokens += [",", cursor.number()]
        elif part != "align":
            new.tokens.append(cursor.expect(part))
    new.kind = _result(new, kinds)
    if new.opcode == "select":
        new.conditions = _locals(new.tokens[2])
    if new.opcode in ("load", "store"):
        new.addresses = _locals(new.tokens[4 if new.opcode == "load" else 5])


def _result(new: Instruction, kinds: list[str]) -> str:
    """Type of the result, from those of the operands."""
    if new.opcode in ("store", "unreachable"):
        return "void"
    if new.opcode == "alloca":
        return "ptr"
    if new.opcode == "extractvalue":
        kind = kinds[0]
        for index in new.tokens[4::2]:
            kind = parts(kind)[int(index)]
        return kind
    if new.opcode == "extractelement":
        return kinds[0].split(" x ", 1)[1][:-1]
    if new.opcode == "shufflevector":
        return f"{kinds[2].split(' x ')[0]} x {kinds[0].split(' x ', 1)[1]}"
    return kinds[1] if new.opcode in _CASTS or new.opcode == "select" else kinds[0]


def _compare(cursor: Cursor, new: Instruction) -> None:
    predicate, kind = cursor.expect(*_PREDICATES[new.opcode]), cursor.kind()
    new.tokens += [predicate, kind, cursor.value(), cursor.expect(","), cursor.value()]
    new.kind = _like("i1", kind)


def _phi(cursor: Cursor, new: Instruction) -> None:
    new.kind = cursor.kind()
    new.tokens.append(new.kind)
    while True:
        cursor.expect("[")
        value = cursor.value()
        cursor.expect(",")
        new.incoming.append((value, cursor.local()))
        cursor.expect("]")
        if not cursor.accept(","):
            return


def _element_address(cursor: Cursor, new: Instruction) -> None:
    new.tokens += [cursor.kind(), cursor.expect(",")]
    kinds = [cursor.kind()]
    new.tokens += [kinds[0], cursor.value()]
    while cursor.accept(","):
        kinds.append(cursor.kind())
        new.tokens += [",", kinds[-1], cursor.value()]
    new.kind = _like("ptr", next((kind for kind in kinds if kind.startswith("<")), ""))
    new.addresses = _locals(*new.tokens)


def _call(cursor: Cursor, new: Instruction) -> None:
    abi = skip_promises(cursor)
    new.kind = cursor.kind()
    new.tokens += [*abi, new.kind]
    if cursor.next == "(":
        new.tokens += cursor.balanced()
    if cursor.next == "asm":
        _copy(cursor, new)
        return
    if not cursor.next.startswith("@"):
        raise cursor.refused(f"indirect call or assembly in {' '.join(cursor.tokens)[:120]!r}")
    new.callee = cursor.take()
    _check_callee(cursor, new.callee)
    new.tokens += [new.callee, cursor.expect("(")]
    _arguments(cursor, new)
    if cursor.next.startswith("#"):
        cursor.take()


def _copy(cursor: Cursor, new: Instruction) -> None:
    """An empty assembly: it copies a register, and hides from the compiler that it does."""
    new.tokens.append(cursor.take())
    if cursor.next != '""':
        raise cursor.refused(f"assembly {cursor.next}")
    new.tokens += [cursor.take(), cursor.expect(","), cursor.expect(*COPIES), cursor.expect("(")]
    _arguments(cursor, new)
    if [kind for kind, _ in new.arguments] != [new.kind]:
        raise cursor.refused(f"assembly of {new.kind}")


def _check_callee(cursor: Cursor, callee: str) -> None:
    if _PARALLEL.match(callee):
        raise cursor.refused(f"parallel execution ({callee})")
    if _PYTHON.match(callee):
        raise cursor.refused(f"object mode ({callee})")
    if callee.startswith("@llvm.") and not (_INTRINSICS.match(callee) or _DROPPED.match(callee)):
        raise cursor.refused(f"intrinsic {callee}")


def _arguments(cursor: Cursor, new: Instruction) -> None:
    callee = str(new.callee)
    if _DROPPED.match(callee):
        cursor.at -= 1
        cursor.balanced()
        return
    while not cursor.accept(")"):
        kind = cursor.kind()
        abi = skip_promises(cursor)
        value = cursor.value()
        if _POISON_ARGUMENT.match(callee) and cursor.next == ")":
            value = "false"
        new.arguments.append((kind, value))
        new.tokens += [kind, *abi, value]
        is_length = callee.startswith("@llvm.mem") and kind == "i64"
        if holds_pointer(kind) or is_length:
            new.addresses += _locals(value)
        if cursor.accept(","):
            new.tokens.append(",")
    new.tokens.append(")")


def _branch(cursor: Cursor, new: Instruction) -> None:
    if cursor.next != "label":
        new.tokens += [cursor.expect("i1"), cursor.value(), cursor.expect(",")]
        new.conditions = _locals(new.tokens[2])
        new.tokens += [cursor.expect("label"), cursor.local(), cursor.expect(",")]
    new.tokens += [cursor.expect("label"), cursor.local()]


def _switch(cursor: Cursor, new: Instruction) -> None:
    new.tokens += [cursor.kind(), cursor.value(), cursor.expect(","), cursor.expect("label"), cursor.local()]
    new.conditions = _locals(new.tokens[2])
    new.tokens.append(cursor.expect("["))
    while not cursor.accept("]"):
        new.tokens += [cursor.kind(), cursor.value(), cursor.expect(","), cursor.expect("label"), cursor.local()]
    new.tokens.append("]")


def _return(cursor: Cursor, new: Instruction) -> None:
    kind = cursor.kind()
    new.tokens.append(kind)
    if kind != "void":
        new.tokens.append(cursor.value())


_READERS = {
    **dict.fromkeys(_FORMS, _operands), "icmp": _compare, "fcmp": _compare, "phi": _phi,
    "getelementptr": _element_address, "call": _call, "br": _branch, "switch": _switch, "ret": _return,
}  # fmt: skip
