"""Strict parser of LLVM IR modules: unknown constructs are rejected, never skipped.

Everything that would make a corrupted value undefined behaviour is removed: poison-generating flags, attributes that
promise something about a value or memory, and all metadata except source locations.
"""

import re
from itertools import takewhile

from mavfi.ir.grammar import parse_instruction, skip_promises
from mavfi.ir.lexer import LABEL, Cursor, tokens_of
from mavfi.ir.metadata import variable_of
from mavfi.ir.module import Block, Function, Instruction, Module
from mavfi.ir.refusal import RefusedError

_OUTSIDE = re.compile(r'@"?(?:_ZN7cpython|cfunc\.|NRT_|nrt_|numba_|\.dtor|__excinfo)')
"""Numba's wrappers and runtime: linked into every module, but not part of a kernel."""
_LINKAGE = ("internal", "private", "linkonce_odr", "linkonce", "weak_odr", "weak", "external", "hidden", "dso_local")
_HARMLESS = {
    "alwaysinline", "cold", "inlinehint", "minsize", "mustprogress", "nocallback", "nocreateundeforpoison", "nofree",
    "noinline", "norecurse", "nosync", "nounwind", "optsize", "speculatable", "ssp", "uwtable", "willreturn",
}  # fmt: skip
_METADATA = re.compile(r"^!(\d+) = (?:distinct )?(.*)", re.MULTILINE)
_ATTACHED = re.compile(r"(, ![\w.]+ !\d+)+$")
_DEBUG = re.compile(r" !dbg !(\d+)")


def parse_module(text: str, kernel: str) -> Module:
    """Parse a module from `Dispatcher.inspect_llvm`; `kernel` is the name for error messages.

    Raises:
        RefusedError: Unknown construct.
    """
    metadata = {int(number): rest for number, rest in _METADATA.findall(text)}
    module = Module(metadata=metadata)
    groups = {match[1]: match[2] for match in re.finditer(r"^attributes (#\d+) = \{(.*)\}", text, re.MULTILINE)}
    lines = iter(text.split("\n"))
    for line in lines:
        if line.startswith("define "):
            body = list(takewhile(lambda line: line != "}", lines))
            name = re.search(r'@(?:"[^"]*"|[-\w$.]+)(?=\()', line)
            if name is not None and _OUTSIDE.match(name[0]):
                module.others.append(_bare(line, body, kernel))
            else:
                module.functions.append(_Reader(kernel, groups, metadata).function(line, body))
        elif not line.startswith(("attributes ", "!", "source_filename", ";")) and line.strip():
            module.preamble.append(_top_level(line, kernel))
    return module


def _top_level(line: str, kernel: str) -> str:
    """A global, a declaration or the target, without attribute groups and metadata."""
    if line.startswith(("@", "target ")):
        return _ATTACHED.sub("", line)
    if line.startswith(("declare ", "$")):
        return " ".join(token for token in tokens_of(line, kernel) if token[0] not in "#!")
    raise RefusedError(kernel, f"line {line[:80]!r}")


def _bare(head: str, body: list[str], kernel: str) -> str:
    """A function outside the fault space, token by token, without attribute groups and metadata."""
    lines = [" ".join(token for token in tokens_of(_DEBUG.sub("", head), kernel) if token[0] != "#")]
    for line in body:
        if not line.strip().startswith("#dbg_") and "@llvm.experimental.noalias.scope.decl" not in line:
            label = LABEL.match(line)
            lines.append(label[0] if label else _without_metadata(line, kernel))
    return "\n".join([*lines, "}"])


def _without_metadata(line: str, kernel: str) -> str:
    tokens = [token for token in tokens_of(_ATTACHED.sub("", line), kernel) if token[0] != "#"]
    if any(token[0] == "!" for token in tokens):
        raise RefusedError(kernel, f"metadata in {line.strip()[:80]!r}")
    return "  " + " ".join(tokens)


class _Reader:
    """Reads one function and assigns short names to its values and blocks."""

    def __init__(self, kernel: str, groups: dict[str, str], metadata: dict[int, str]) -> None:
        self.kernel = kernel
        self.groups = groups
        self.metadata = metadata
        self.names: dict[str, str] = {}
        self.variables: dict[str, str] = {}

    def function(self, head: str, body: list[str]) -> Function:
        function = self._head(head)
        lines = _joined([line for line in body if line.strip() and not line.lstrip().startswith(";")])
        unnamed = sum(name[1:].isdigit() for name in self.names)
        for number, line in enumerate(lines):
            label = LABEL.match(line)
            if label is not None or number == 0:
                old = f"%{label[1]}" if label is not None else f"%{unnamed}"
                function.blocks.append(Block(self.names.setdefault(old, f"%b{len(function.blocks)}")))
            if label is None:
                self._line(line.strip(), function.blocks[-1])
        self._rename(function)
        return function

    def _head(self, head: str) -> Function:
        debug = _DEBUG.search(head)
        cursor = Cursor(tokens_of(_DEBUG.sub("", head), self.kernel), self.kernel)
        cursor.expect("define")
        linkage = ""
        while cursor.next in _LINKAGE:
            linkage += f"{cursor.take()} "
        skip_promises(cursor)
        function = Function("", linkage, cursor.kind(), [], location=int(debug[1]) if debug else None)
        function.name = cursor.take()
        cursor.expect("(")
        while not cursor.accept(")"):
            kind = cursor.kind()
            kind += "".join(f" {word}" for word in skip_promises(cursor))
            name = cursor.local()
            self.names[name] = f"%a{len(function.parameters)}"
            function.parameters.append((kind, self.names[name]))
            cursor.accept(",")
        while not cursor.accept("{"):
            if cursor.next.startswith("#"):
                self._check_group(cursor.take())
            else:
                cursor.expect("local_unnamed_addr", "unnamed_addr")
        cursor.finish()
        return function

    def _check_group(self, group: str) -> None:
        words = re.sub(r"memory\([^)]*\)", "", self.groups.get(group, "")).split()
        unknown = [word for word in words if word not in _HARMLESS]
        if unknown:
            raise RefusedError(self.kernel, f"function attribute {unknown[0]!r}")

    def _line(self, line: str, block: Block) -> None:
        if line.startswith("#dbg_"):
            self.variables.update(variable_of(line, self.metadata))
            return
        if block.terminator is not None:
            raise RefusedError(self.kernel, f"{line[:80]!r} after the end of a block")
        debug = re.search(r", !dbg !(\d+)", line)
        cursor = Cursor(tokens_of(_ATTACHED.sub("", line), self.kernel), self.kernel)
        instruction = parse_instruction(cursor)
        if instruction is None:
            return
        instruction.location = int(debug[1]) if debug else None
        if instruction.opcode == "phi":
            block.phis.append(instruction)
        elif instruction.opcode == "alloca":
            if block.label != "%b0":
                raise RefusedError(self.kernel, "memory taken from the stack within a loop or branch")
            block.allocations.append(instruction)
        elif instruction.opcode in ("br", "switch", "ret", "unreachable"):
            block.terminator = instruction
        else:
            block.body.append(instruction)

    def _rename(self, function: Function) -> None:
        for block in function.blocks:
            for instruction in block.all():
                if instruction.result is not None:
                    self.names[instruction.result] = f"%v{len(self.names)}"
        for block in function.blocks:
            if block.terminator is None:
                raise RefusedError(self.kernel, f"a block without an end in {function.name}")
            for instruction in block.all():
                self._rename_in(instruction)

    def _rename_in(self, instruction: Instruction) -> None:
        names = self.names
        if instruction.result is not None:
            instruction.variable = self.variables.get(instruction.result)
            instruction.result = names[instruction.result]
        try:
            instruction.tokens = [names[token] if token[0] == "%" else token for token in instruction.tokens]
            instruction.incoming = [(names.get(value, value), names[label]) for value, label in instruction.incoming]
            instruction.addresses = [names[name] for name in instruction.addresses]
            instruction.conditions = [names[name] for name in instruction.conditions]
            instruction.arguments = [(kind, names.get(value, value)) for kind, value in instruction.arguments]
        except KeyError as error:
            raise RefusedError(self.kernel, f"{error} is used but not defined") from None


def _joined(lines: list[str]) -> list[str]:
    """Join the cases of each switch into one line."""
    joined: list[str] = []
    for line in lines:
        if joined and joined[-1].lstrip().startswith("switch ") and "]" not in joined[-1]:
            joined[-1] += f" {line.strip()}"
        else:
            joined.append(line)
    return joined
