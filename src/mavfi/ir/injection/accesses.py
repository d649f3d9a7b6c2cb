"""Memory accesses of instructions, and placement of a kernel's memory: stack frames and constants in the arena."""

import re
from dataclasses import dataclass

from mavfi.ir.injection.arena import CONSTANTS, EXCEPTION, LINE, RESULT
from mavfi.ir.injection.runtime import REPLACED
from mavfi.ir.module import Instruction, Module, holds_pointer, parts, width

_LOAD_POINTER = 4
"""Token of a load that is its pointer: opcode, type, comma, "ptr", pointer."""
_STORE_KIND = 1
"""Token of a store that is the type of its value."""
_STORE_POINTER = 5
"""Token of a store that is its pointer: opcode, type, value, comma, "ptr", pointer."""
_LONGEST_ALIGNMENT = 8
"""Largest alignment of a field in a structure (bytes), on the 64-bit machines that are supported."""
_MASKED_CALL = re.compile(r"@llvm\.masked\.(?:load|store|expandload|compressstore|gather|scatter)\.")
"""Intrinsics that access those elements of a vector whose bit is set in a mask."""
_MEMORY_COPY = re.compile(r"@llvm\.mem(?:cpy|move|set)\.")
"""Intrinsics that copy or fill memory; the third argument is the length (bytes)."""
_CONSTANT_ARRAY = re.compile(
    r"^(@\S+) = (?:private |internal )((?:unnamed_addr |local_unnamed_addr )?)constant (\[\d+ x \w+\]) "
)
"""Definition of a constant array: its name and type."""
_VECTOR_TYPE = re.compile(r"<(\d+) x (.+)>")
"""Type of a vector: number and type of its elements."""
_GLOBAL_NAME = re.compile(r'@(?:"[^"]*"|[-\w$.]+)')
"""Name of a global, as LLVM writes it."""


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
    if instruction.opcode == "load":
        accesses = [Access(instruction.tokens[_LOAD_POINTER], str(size_of(instruction.kind)))]
    elif instruction.opcode == "store":
        accesses = [Access(instruction.tokens[_STORE_POINTER], str(size_of(instruction.tokens[_STORE_KIND])))]
    elif instruction.callee is not None and _MEMORY_COPY.match(instruction.callee):
        length = instruction.arguments[2][1]
        accesses = [Access(value, length) for kind, value in instruction.arguments[:2] if kind == "ptr"]
    elif instruction.callee is not None and _MASKED_CALL.match(instruction.callee):
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
    vector = _VECTOR_TYPE.fullmatch(data)
    assert vector is not None  # the elements of a vector of pointers
    return Access(pointer, str(size_of(vector[2])), mask, int(vector[1]))


def _round_up(size: int, multiple: int) -> int:
    """The smallest multiple that is not below a size."""
    return -(-size // multiple) * multiple


def size_of(kind: str) -> int:
    """Bytes that a value of a type occupies in memory, including padding."""
    fields = parts(kind)
    if not fields:
        return _round_up(width(kind), 8) // 8  # bits
    # A structure: each field begins at a multiple of its alignment, and so does the next structure in an array.
    end = 0
    largest_alignment = 1
    for part in fields:
        alignment = _LONGEST_ALIGNMENT
        if not parts(part):
            alignment = min(_LONGEST_ALIGNMENT, size_of(part))
        end = _round_up(end, alignment) + size_of(part)
        largest_alignment = max(largest_alignment, alignment)
    return _round_up(end, largest_alignment)


def is_owned(module: Module) -> bool:
    """Whether a kernel accesses memory in its own code only: no C function that it calls takes or returns pointers."""
    # Every call that leaves the module is looked at: those replaced by our runtime stay in the arena.
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
    # Types of all constant arrays by name; those that a function uses get the next free address.
    arrays = (match for match in map(_CONSTANT_ARRAY.match, module.preamble) if match is not None)
    kinds = {match[1]: match[3] for match in arrays if ".const.pickle" not in match[1]}

    # Place those that are used, each at the start of a cache line.
    constants: dict[str, Constant] = {}
    address = CONSTANTS
    for function in module.functions:
        for name in _GLOBAL_NAME.findall(function.text()):
            if name in kinds and name not in constants:
                constants[name] = Constant(name, address, size_of(kinds[name]))
                address += _round_up(constants[name].size, LINE)
    return constants


def export_constants(line: str, constants: dict[str, Constant]) -> str:
    """The definition of a global; a constant to be copied to the arena becomes visible outside of the module."""
    match = _CONSTANT_ARRAY.match(line)
    if match is None or match[1] not in constants:
        return line
    return line.replace(" = private ", " = ", 1).replace(" = internal ", " = ", 1)


def relocate(token: str, constants: dict[str, Constant]) -> str:
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

    return _GLOBAL_NAME.sub(planned_address, token)


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
