"""Memory accesses of instructions, and placement of a kernel's memory: stack frames and constants in the arena."""

import re
from dataclasses import dataclass

from mavfi.faults.levels.instruction.arena import CONSTANTS, EXCEPTION, LINE, RESULT
from mavfi.faults.levels.instruction.runtime import REPLACED
from mavfi.ir.module import Instruction, Module, holds_pointer, parts, width

_MASKED = re.compile(r"@llvm\.masked\.(?:load|store|expandload|compressstore|gather|scatter)\.")
_COPIES = re.compile(r"@llvm\.mem(?:cpy|move|set)\.")
_ARRAY = re.compile(
    r"^(@\S+) = (?:private |internal )((?:unnamed_addr |local_unnamed_addr )?)constant (\[\d+ x \w+\]) "
)
"""A constant array of the preamble: name, attribute, type."""
_VECTOR = re.compile(r"<(\d+) x (.+)>")
"""Type of a vector: number and type of its elements."""
_NAME = re.compile(r'@(?:"[^"]*"|[-\w$.]+)')


@dataclass(frozen=True, slots=True)
class Access:
    """A memory access of an instruction: pointer and size (bytes), a number or a value of type i64.

    With a `mask` (a vector of bits) the pointer is a vector, of which the lanes with a set bit are accessed.
    """

    pointer: str
    size: str
    mask: str = ""
    lanes: int = 0


def accesses_of(instruction: Instruction) -> list[Access]:
    """Accesses of an instruction through computed pointers; callees are instrumented separately."""
    accesses: list[Access] = []
    if instruction.opcode == "load":  # load TYPE , ptr POINTER
        accesses = [Access(instruction.tokens[4], str(size_of(instruction.kind)))]
    elif instruction.opcode == "store":  # store TYPE VALUE , ptr POINTER
        accesses = [Access(instruction.tokens[5], str(size_of(instruction.tokens[1])))]
    elif instruction.callee is not None and _COPIES.match(instruction.callee):
        _, length = instruction.arguments[2]  # after the destination, and the source or the value of the bytes
        accesses = [Access(value, length) for kind, value in instruction.arguments[:2] if kind == "ptr"]
    elif instruction.callee is not None and _MASKED.match(instruction.callee):
        accesses = [_masked(instruction)]
    return [access for access in accesses if access.pointer.startswith("%")]


def _masked(call: Instruction) -> Access:
    """A masked access; a plain pointer counts as accessed in full, which is simple and harmless inside the arena."""
    mask = next(value for kind, value in call.arguments[::-1] if " x i1>" in kind)
    data = call.kind
    if data == "void":  # a store: the data are its first argument
        data = call.arguments[0][0]
    kind, pointer = next((kind, value) for kind, value in call.arguments if holds_pointer(kind))
    if kind == "ptr":
        return Access(pointer, str(size_of(data)))
    vector = _VECTOR.fullmatch(data)
    assert vector is not None  # the elements of a vector of pointers
    return Access(pointer, str(size_of(vector[2])), mask, int(vector[1]))


def size_of(kind: str) -> int:
    """Bytes that a value of a type occupies in memory, including padding."""
    fields = parts(kind)
    if not fields:
        return _round_up(width(kind), 8) // 8
    # Each field starts at a multiple of its alignment, and the whole ends at one of the largest.
    end = 0
    largest_alignment = 1
    for part in fields:
        alignment = 8
        if not parts(part):
            alignment = min(8, size_of(part))
        end = _round_up(end, alignment) + size_of(part)
        largest_alignment = max(largest_alignment, alignment)
    return _round_up(end, largest_alignment)


def _round_up(number: int, unit: int) -> int:
    """The next multiple of a unit."""
    return -(-number // unit) * unit


def is_owned(module: Module) -> bool:
    """Whether a kernel accesses memory in its own code only: no C function that it calls takes or returns pointers."""
    functions = {function.name for function in module.functions}
    for function in module.functions:
        for block in function.blocks:
            for instruction in block.all():
                callee = instruction.callee
                if callee is None or callee in functions or callee[1:] in REPLACED:
                    continue
                if callee.startswith("@llvm.") and not callee.startswith("@llvm.x86."):
                    continue  # a portable intrinsic, whose accesses are checked
                kinds = [instruction.kind, *(kind for kind, _ in instruction.arguments)]
                if any(map(holds_pointer, kinds)):
                    return False
    return True


@dataclass(frozen=True, slots=True)
class Constant:
    """A constant array of a module: name, planned address, and size (bytes)."""

    name: str
    address: int
    size: int


def constants_of(module: Module) -> dict[str, Constant]:
    """Arrays used in the fault space, with their addresses in the arena, in order of first use.

    Pickled exceptions are not relocated: only Python reads them, and their length depends on a file path.
    """
    # The arrays of the module: their types by name.
    arrays = (match for match in map(_ARRAY.match, module.preamble) if match is not None)
    kinds = {match[1]: match[3] for match in arrays if ".const.pickle" not in match[1]}

    # Place those that are used, each at the start of a cache line.
    constants: dict[str, Constant] = {}
    address = CONSTANTS
    for function in module.functions:
        for name in _NAME.findall(function.text()):
            if name in kinds and name not in constants:
                size = size_of(kinds[name])
                constants[name] = Constant(name, address, size)
                address += _round_up(size, LINE)
    return constants


def exported(line: str, constants: dict[str, Constant]) -> str:
    """A global of the module; constants to be copied to the arena become externally visible."""
    match = _ARRAY.match(line)
    if match is None or match[1] not in constants:
        return line
    return line.replace(" = private ", " = ", 1).replace(" = internal ", " = ", 1)


def relocated(token: str, constants: dict[str, Constant]) -> str:
    """A token of an instruction, with arrays replaced by planned addresses, and Numba's runtime by ours."""
    if "@" not in token:
        return token
    if token[1:] in REPLACED:
        return f"@mavfi_{token[1:]}"

    def planned_address(match: re.Match[str]) -> str:
        constant = constants.get(match[0])
        if constant is None:
            return match[0]
        return f"inttoptr (i64 {constant.address} to ptr)"

    return _NAME.sub(planned_address, token)


def planned_wrapper(text: str, kernels: list[str]) -> str:
    """Numba's wrapper with planned addresses for the kernel's result and exception, and with our runtime."""
    for name in kernels:
        # the first two arguments of the call point to the result and to the exception
        call = re.search(rf"{re.escape(name)} \( ptr (?:[^,]* )?(\S+) , ptr (?:[^,]* )?(\S+) [,)]", text)
        if call is None:
            continue
        for local, address in ((call[1], RESULT), (call[2], EXCEPTION)):
            text = re.sub(
                rf"^  {re.escape(local)} = alloca .*$",
                f"  {local} = inttoptr i64 {address} to ptr",
                text,
                flags=re.MULTILINE,
            )
    return re.sub(rf"(call [^@\n]*)@({'|'.join(REPLACED)}) \(", r"\1@mavfi_\2 (", text)
