"""LLVM IR module as represented in the injector: functions, blocks, instructions, and the types of their values."""

import hashlib
import re
from dataclasses import dataclass, field

from mavfi.errors import MavfiError

_SCALARS = {"half": 16, "bfloat": 16, "float": 32, "double": 64, "ptr": 64}
"""Bits of LLVM's types but integers."""
_FLOATS = ("half", "bfloat", "float", "double")
"""Floating-point types."""
_VECTOR = re.compile(r"<(\d+) x (.+)>")
"""Type of a vector: number and type of its elements."""
_ARRAY = re.compile(r"\[(\d+) x (.+)\]")
"""Type of an array: number and type of its elements."""


def width(kind: str) -> int:
    """Bits of a value of a type, aggregate fields packed; 0 for `void`."""
    if kind == "void":
        return 0
    if kind in _SCALARS:
        return _SCALARS[kind]
    if kind[0] == "i":
        return int(kind[1:])
    vector = _VECTOR.fullmatch(kind)
    if vector is not None:
        return int(vector[1]) * width(vector[2])
    return sum(width(part) for part in parts(kind))


def parts(kind: str) -> list[str]:
    """Field types of a struct or array; empty for any other type."""
    array = _ARRAY.fullmatch(kind)
    if array is not None:
        return [array[2]] * int(array[1])
    if kind[0] == "{":
        return split(kind[1:-1])
    return []


def split(text: str) -> list[str]:
    """Split a text at commas outside brackets."""
    pieces = []
    depth = 0
    start = 0
    for i, character in enumerate(text):
        if character in "{[<(":
            depth += 1
        elif character in "}]>)":
            depth -= 1
        elif character == "," and depth == 0:
            pieces.append(text[start:i].strip())
            start = i + 1
    return [*pieces, text[start:].strip()]


def is_floating(kind: str) -> bool:
    """Whether values of the type, or all elements of a vector, are floating-point numbers."""
    vector = _VECTOR.fullmatch(kind)
    if vector is not None:
        return vector[2] in _FLOATS
    return kind in _FLOATS


def holds_pointer(kind: str) -> bool:
    """Whether values of the type contain a pointer."""
    return "ptr" in re.findall(r"\w+", kind)


@dataclass(slots=True)
class Instruction:
    """One instruction, without flags that would make a corrupted value undefined behaviour.

    Attributes:
        opcode: As in the language reference.
        tokens: Its text without the result; local names begin with `%`.
        result: Local name, or None.
        kind: Type of the result, "void" if there is none.
        incoming: For a phi: value and label, in order.
        addresses: Local names used as addresses.
        conditions: Local names on which a branch, switch or select depends.
        callee: Called function, or None.
        arguments: For a call: type and value of each argument.
        location: Number of its debug location, or None.
        variable: Source variable whose value the result is, or None.
        role: What it is in rewritten code, e.g. protected; "" = as compiled.
    """

    opcode: str
    tokens: list[str]
    result: str | None = None
    kind: str = "void"
    incoming: list[tuple[str, str]] = field(default_factory=list)
    addresses: list[str] = field(default_factory=list)
    conditions: list[str] = field(default_factory=list)
    callee: str | None = None
    arguments: list[tuple[str, str]] = field(default_factory=list)
    location: int | None = None
    variable: str | None = None
    role: str = ""

    def uses(self) -> list[str]:
        """Local names in its text, including labels."""
        names = [token for token in self.tokens if token[0] == "%"]
        for value, label in self.incoming:
            names += [*re.findall(r"%\w+", value), label]
        return names

    def text(self, names: dict[str, str] | None = None, labels: dict[str, str] | None = None) -> str:
        """The instruction without its result; local values and the blocks named in a phi can be renamed."""
        values = names or {}
        blocks = labels or {}
        text = " ".join(values.get(token, token) for token in self.tokens)
        if self.opcode != "phi":
            return text
        pairs = (f"[ {values.get(value, value)}, {blocks.get(label, label)} ]" for value, label in self.incoming)
        return f"{text} {', '.join(pairs)}"

    def line(self, names: dict[str, str] | None = None, labels: dict[str, str] | None = None, suffix: str = "") -> str:
        """The instruction with its result, whose name is extended by a suffix."""
        text = self.text(names, labels)
        if self.result is None:
            return f"  {text}"
        return f"  {self.result}{suffix} = {text}"


@dataclass(slots=True)
class BasicBlock:
    """A basic block: phis, allocations on the stack, the body, and the terminator.

    Attributes:
        runs_as: Labels of blocks. This block is executed as often as the first one minus all others; () = it is
            counted itself.
        unreached: Whether only a fault leads to it.
    """

    label: str
    phis: list[Instruction] = field(default_factory=list)
    allocations: list[Instruction] = field(default_factory=list)
    body: list[Instruction] = field(default_factory=list)
    terminator: Instruction | None = None
    runs_as: tuple[str, ...] = ()
    unreached: bool = False

    @property
    def sites(self) -> list[Instruction]:
        """The instructions that write a value, in the order of dynamic indices."""
        return [instruction for instruction in self.phis + self.body if instruction.result is not None]

    def all(self) -> list[Instruction]:
        """Every instruction."""
        instructions = self.phis + self.allocations + self.body
        if self.terminator is not None:
            instructions.append(self.terminator)
        return instructions


@dataclass(slots=True)
class Function:
    """A function in the fault space: global name, result type, and blocks, entry first.

    The linkage precedes the result type. Parameters are types, with calling-convention attributes, and local names. The
    location is the number of the debug subprogram, or None.
    """

    name: str
    linkage: str
    kind: str
    parameters: list[tuple[str, str]]
    blocks: list[BasicBlock] = field(default_factory=list)
    location: int | None = None

    def head(self) -> str:
        """The first line of the definition, up to the opening brace."""
        parameters = ", ".join(f"{kind} {name}" for kind, name in self.parameters)
        return f"define {self.linkage}{self.kind} {self.name}({parameters}) {{"

    def text(self) -> str:
        """Definition of the function as LLVM IR: head, blocks, closing brace."""
        lines = [self.head()]
        for block in self.blocks:
            lines += [f"{block.label[1:]}:", *(instruction.line() for instruction in block.all())]
        return "\n".join([*lines, "}"])


@dataclass(slots=True)
class Module:
    """A module: preamble (target, globals, declarations), fault space, and other definitions and metadata as text."""

    preamble: list[str] = field(default_factory=list)
    functions: list[Function] = field(default_factory=list)
    others: list[str] = field(default_factory=list)
    metadata: dict[int, str] = field(default_factory=dict)


# ---- refusals: always an error, never a silent omission -------------------------------------------------------------


class NotInstrumentableError(MavfiError):
    """The kernel has a construct that cannot be instrumented exactly."""

    def __init__(self, kernel: str, construct: str) -> None:
        super().__init__(f"{kernel}: cannot be instrumented: {construct}")
        self.kernel = kernel
        self.construct = construct


class BuildError(MavfiError):
    """The compiler crashed on the rewritten module."""


# ---- digest of a module's fault space -------------------------------------------------------------------------------
# The digest is the same in every process and folder, wherever the source is.  The parser has removed line tables and
# debug metadata, and renamed local values.  Names of compiled functions contain their module, a number by process and
# the types of their arguments; here they are numbers in the order of their use, for the functions themselves are in
# the digest.
DIGEST_VERSION = "2"
"""Version of the digest; a campaign that was begun with another one cannot be resumed."""
_GLOBAL = re.compile(r'@(?:"[^"]*"|[-\w$.]+)')
"""Name of a global."""
_NAMED_BY_SOURCE = re.compile(r'@"?(_ZN|\.const\.|\.bytes\.)')
"""Beginnings of the names of compiled functions, and of constants that are named by hashes of texts or of exceptions
with the path and line of their source."""
_PICKLED_SIZE = re.compile(r"(store ptr @\.const\.pickledata\.\S+ ,?[^\n]*\n[^\n]*\n\s*store i32 )\d+")
"""Stored length of a pickled exception: it grows with the path."""


def bodies_of(module: Module) -> str:
    """Text of the functions in the fault space."""
    return "\n".join(function.text() for function in module.functions)


def digest_of(module: Module) -> str:
    """SHA-256 of the functions in the fault space."""
    return digest_of_text(bodies_of(module))


def digest_of_text(bodies: str) -> str:
    """SHA-256 of IR, without what differs between processes and what names the source."""
    numbers: dict[str, int] = {}

    def neutral(match: re.Match[str]) -> str:
        name = match[0]
        if not _NAMED_BY_SOURCE.match(name):
            return name
        return f"@global.{numbers.setdefault(name, len(numbers))}"

    text = _GLOBAL.sub(neutral, _PICKLED_SIZE.sub(r"\1*", bodies))
    return hashlib.sha256(text.encode()).hexdigest()
