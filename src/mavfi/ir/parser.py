"""Strict parser of LLVM IR modules: unknown constructs are rejected, never skipped.

Everything that would make a corrupted value undefined behaviour is removed: poison-generating flags, attributes that
promise something about a value or memory, and all metadata except source locations.
"""

import re
from itertools import takewhile

from mavfi.ir.metadata import variable_of
from mavfi.ir.module import BasicBlock, Function, Instruction, Module, NotInstrumentableError, holds_pointer, parts

_OUTSIDE = re.compile(r'@"?(?:_ZN7cpython|cfunc\.|NRT_|nrt_|numba_|\.dtor|__excinfo)')
"""Numba's wrappers and runtime: linked into every module, but not part of a kernel."""
_LINKAGE = ("internal", "private", "linkonce_odr", "linkonce", "weak_odr", "weak", "external", "hidden", "dso_local")
"""Words in front of a function's type that are kept."""
_HARMLESS = {
    "alwaysinline", "cold", "inlinehint", "minsize", "mustprogress", "nocallback", "nocreateundeforpoison", "nofree",
    "noinline", "norecurse", "nosync", "nounwind", "optsize", "speculatable", "ssp", "uwtable", "willreturn",
}  # fmt: skip
"""Attributes of functions that stay true if a value is corrupted; all others are refused."""
_METADATA = re.compile(r"^!(\d+) = (?:distinct )?(.*)", re.MULTILINE)
"""A line that defines a metadata node: number and content."""
_ATTACHED = re.compile(r"(, ![\w.]+ !\d+)+$")
"""Metadata at the end of a line."""
_DEBUG = re.compile(r" !dbg !(\d+)")
"""The source location of a line, as number of a metadata node."""


def parse_module(text: str, kernel: str) -> Module:
    """Parse a module from `Dispatcher.inspect_llvm`; `kernel` is the name for error messages.

    Raises:
        NotInstrumentableError: Unknown construct.
    """
    # Metadata and attribute groups follow the functions that refer to them: read them first.
    metadata = {int(number): rest for number, rest in _METADATA.findall(text)}
    module = Module(metadata=metadata)
    groups = {match[1]: match[2] for match in re.finditer(r"^attributes (#\d+) = \{(.*)\}", text, re.MULTILINE)}
    # Then the functions, of which only those of the kernel are parsed instruction by instruction, and the globals.
    lines = iter(text.split("\n"))
    for line in lines:
        if line.startswith("define "):
            body = list(takewhile(lambda text: text != "}", lines))
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
    raise NotInstrumentableError(kernel, f"line {line[:80]!r}")


def _bare(head: str, body: list[str], kernel: str) -> str:
    """A function outside the fault space, token by token, without attribute groups and metadata."""
    lines = [" ".join(token for token in tokens_of(_DEBUG.sub("", head), kernel) if token[0] != "#")]
    for line in body:
        if line.strip().startswith("#dbg_") or "@llvm.experimental.noalias.scope.decl" in line:
            continue
        label = LABEL.match(line)
        if label is not None:
            lines.append(label[0])
        else:
            lines.append(_without_metadata(line, kernel))
    return "\n".join([*lines, "}"])


def _without_metadata(line: str, kernel: str) -> str:
    """An instruction without attribute groups and attached metadata; other metadata are refused."""
    tokens = [token for token in tokens_of(_ATTACHED.sub("", line), kernel) if token[0] != "#"]
    if any(token[0] == "!" for token in tokens):
        raise NotInstrumentableError(kernel, f"metadata in {line.strip()[:80]!r}")
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
        """The function with this head and body."""
        function = self._head(head)
        lines = _joined([line for line in body if line.strip() and not line.lstrip().startswith(";")])
        # An entry block without a label has the number after those of the unnamed parameters.
        if lines and LABEL.match(lines[0]) is None:
            unnamed = sum(name[1:].isdigit() for name in self.names)
            function.blocks.append(self._block(f"%{unnamed}", 0))
        for line in lines:
            label = LABEL.match(line)
            if label is None:
                self._line(line.strip(), function.blocks[-1])
            else:
                function.blocks.append(self._block(f"%{label[1]}", len(function.blocks)))
        self._rename(function)
        return function

    def _block(self, label: str, number: int) -> BasicBlock:
        """A block, with a short name for its label."""
        return BasicBlock(self.names.setdefault(label, f"%b{number}"))

    def _head(self, head: str) -> Function:
        """The function without blocks, from the first line of its definition."""
        debug = _DEBUG.search(head)
        cursor = Cursor(tokens_of(_DEBUG.sub("", head), self.kernel), self.kernel)
        cursor.expect("define")
        # linkage, result type and name
        linkage = ""
        while cursor.next in _LINKAGE:
            linkage += f"{cursor.take()} "
        skip_promises(cursor)
        kind = cursor.kind()
        function = Function(cursor.take(), linkage, kind, [])
        if debug is not None:
            function.location = int(debug[1])
        # parameters, each with those attributes that the calling convention needs
        cursor.expect("(")
        while not cursor.accept(")"):
            kind = cursor.kind()
            kind += "".join(f" {word}" for word in skip_promises(cursor))
            name = cursor.local()
            self.names[name] = f"%a{len(function.parameters)}"
            function.parameters.append((kind, self.names[name]))
            cursor.accept(",")
        # attributes of the function
        while not cursor.accept("{"):
            if cursor.next.startswith("#"):
                self._check_group(cursor.take())
            else:
                cursor.expect("local_unnamed_addr", "unnamed_addr")
        cursor.finish()
        return function

    def _check_group(self, group: str) -> None:
        """Refuse an attribute group with unknown attributes."""
        words = re.sub(r"memory\([^)]*\)", "", self.groups.get(group, "")).split()
        unknown = [word for word in words if word not in _HARMLESS]
        if unknown:
            raise NotInstrumentableError(self.kernel, f"function attribute {unknown[0]!r}")

    def _line(self, line: str, block: BasicBlock) -> None:
        """Read an instruction or a debug record, and add it to its block."""
        if line.startswith("#dbg_"):
            self.variables.update(variable_of(line, self.metadata))
            return
        if block.terminator is not None:
            raise NotInstrumentableError(self.kernel, f"{line[:80]!r} after the end of a block")
        debug = re.search(r", !dbg !(\d+)", line)
        cursor = Cursor(tokens_of(_ATTACHED.sub("", line), self.kernel), self.kernel)
        instruction = parse_instruction(cursor)
        if instruction is None:
            return
        if debug is not None:
            instruction.location = int(debug[1])
        if instruction.opcode == "phi":
            block.phis.append(instruction)
        elif instruction.opcode == "alloca":
            if block.label != "%b0":
                raise NotInstrumentableError(self.kernel, "memory taken from the stack within a loop or branch")
            block.allocations.append(instruction)
        elif instruction.opcode in ("br", "switch", "ret", "unreachable"):
            block.terminator = instruction
        else:
            block.body.append(instruction)

    def _rename(self, function: Function) -> None:
        """Give short names to all values, independent of the names and numbers that the compiler has chosen."""
        for block in function.blocks:
            for instruction in block.all():
                if instruction.result is not None:
                    self.names[instruction.result] = f"%v{len(self.names)}"
        for block in function.blocks:
            if block.terminator is None:
                raise NotInstrumentableError(self.kernel, f"a block without an end in {function.name}")
            for instruction in block.all():
                self._rename_in(instruction)

    def _rename_in(self, instruction: Instruction) -> None:
        """Replace the names in an instruction; one that is not defined is refused."""
        names = self.names
        if instruction.result is not None:
            instruction.variable = self.variables.get(instruction.result)
            instruction.result = names[instruction.result]
        try:
            for index, token in enumerate(instruction.tokens):
                if token[0] == "%":
                    instruction.tokens[index] = names[token]
            instruction.incoming = [(names.get(value, value), names[label]) for value, label in instruction.incoming]
            instruction.addresses = [names[name] for name in instruction.addresses]
            instruction.conditions = [names[name] for name in instruction.conditions]
            instruction.arguments = [(kind, names.get(value, value)) for kind, value in instruction.arguments]
        except KeyError as error:
            raise NotInstrumentableError(self.kernel, f"{error} is used but not defined") from None


def _joined(lines: list[str]) -> list[str]:
    """Join the cases of each switch into one line."""
    joined: list[str] = []
    for line in lines:
        if joined and joined[-1].lstrip().startswith("switch ") and "]" not in joined[-1]:
            joined[-1] += f" {line.strip()}"
        else:
            joined.append(line)
    return joined


# ---- tokens of a line -----------------------------------------------------------------------------------------------
_TOKEN = re.compile(
    r"""\s*(?:
      (?P<local>%(?:"[^"]*"|[-\w$.]+)) | (?P<global>@(?:"[^"]*"|[-\w$.]+)) | (?P<group>\#\d+) | (?P<metadata>![\w.]*)
    | (?P<text>c?"[^"]*") | (?P<number>-?(?:0x[HKLMR]?[0-9A-Fa-f]+|\d+\.\d*(?:e[-+]?\d+)?|\d+)(?![\w.]))
    | (?P<word>[A-Za-z_][\w.]*) | (?P<dots>\.\.\.) | (?P<mark>[=,(){}<>\[\]*|]) | (?P<comment>;.*)
    )""",
    re.VERBOSE,
)
_NAME = re.compile(r'[%@](?:"[^"]*"|[-\w$.]+)')
"""A local or global name."""
LABEL = re.compile(r'("[^"]*"|[-\w$.]+):')
"""A label at the start of a block."""
OPEN = {"(": ")", "{": "}", "[": "]", "<": ">"}
"""Brackets, each with the one that closes it."""
PLAIN_VALUES = ("true", "false", "null", "undef", "poison", "zeroinitializer", "none")
"""Constants of one word."""
CONSTANT_EXPRESSIONS = ("getelementptr", "inttoptr", "ptrtoint", "bitcast", "add", "sub")
"""Beginnings of constants that are computed from others."""
_SCALAR = re.compile(r"i\d+|half|bfloat|float|double|ptr|void")
"""Types of one word."""


def tokens_of(line: str, kernel: str) -> list[str]:
    """Tokens of a line without its comment; an unknown token is a NotInstrumentableError."""
    tokens = []
    at = 0
    end = len(line.rstrip())
    while at < end:
        match = _TOKEN.match(line, at)
        if match is None:
            raise NotInstrumentableError(kernel, f"text {line[at : at + 40].strip()!r} in {line.strip()[:80]!r}")
        if match.lastgroup != "comment":
            tokens.append(match[0].strip())
        at = match.end()
    return tokens


class Cursor:
    """Reads the tokens of one line from left to right; an unexpected token is a NotInstrumentableError."""

    def __init__(self, tokens: list[str], kernel: str) -> None:
        self.tokens = tokens
        self.kernel = kernel
        self.at = 0

    @property
    def next(self) -> str:
        """The next token; "" at the end."""
        if self.at < len(self.tokens):
            return self.tokens[self.at]
        return ""

    def take(self) -> str:
        """Consume and return the next token."""
        token = self.next
        if not token:
            raise self.refused()
        self.at += 1
        return token

    def expect(self, *allowed: str) -> str:
        """Consume a token that must be one of these."""
        if self.next not in allowed:
            raise self.refused()
        return self.take()

    def accept(self, *allowed: str) -> bool:
        """Consume a token if it is one of these."""
        if not self.next or self.next not in allowed:
            return False
        self.at += 1
        return True

    def refused(self, why: str = "") -> NotInstrumentableError:
        """The error that names the unknown construct."""
        line = " ".join(self.tokens)
        return NotInstrumentableError(self.kernel, why or f"{self.next or 'end of line'!r} in {line[:120]!r}")

    def finish(self) -> None:
        """Check that no token is left."""
        if self.next:
            raise self.refused()

    def balanced(self) -> list[str]:
        """Consume an opening bracket up to the matching closing one."""
        tokens = []
        depth = 0
        while True:
            token = self.take()
            tokens.append(token)
            if token in OPEN:
                depth += 1
            elif token in OPEN.values():
                depth -= 1
            if depth == 0:
                return tokens

    def number(self) -> str:
        """Consume an unsigned number."""
        if not self.next.isdigit():
            raise self.refused()
        return self.take()

    def local(self) -> str:
        """Consume a local name."""
        if not self.next.startswith("%"):
            raise self.refused()
        return self.take()

    def kind(self) -> str:
        """Consume a type; returns its normalized spelling."""
        token = self.take()
        if token == "{":
            fields = [self.kind()]
            while self.accept(","):
                fields.append(self.kind())
            self.expect("}")
            return f"{{ {', '.join(fields)} }}"
        if token in ("<", "["):
            count = self.number()
            self.expect("x")
            element = self.kind()
            self.expect(OPEN[token])
            return f"{token}{count} x {element}{OPEN[token]}"
        if not _SCALAR.fullmatch(token):
            self.at -= 1
            raise self.refused()
        return token

    def value(self) -> str:
        """Consume a value: a local or global name, or a constant."""
        token = self.next
        if _NAME.fullmatch(token) or token in PLAIN_VALUES or token[:1].isdigit() or token[:1] == "-":
            return self.take()
        if token == "splat":
            return self._constant([self.take(), *self.balanced()])
        if token in OPEN and token != "(":
            return self._constant(self.balanced())
        if token in CONSTANT_EXPRESSIONS:
            words = [self.take()]
            while self.next in ("inbounds", "nuw", "nsw", "nusw"):
                self.take()
            return self._constant([*words, *self.balanced()])
        raise self.refused()

    def _constant(self, tokens: list[str]) -> str:
        """Text of a constant, which names no local value."""
        if any(token[0] == "%" for token in tokens):
            raise self.refused()
        return " ".join(tokens)


# ---- instructions, each with its complete syntax --------------------------------------------------------------------
VOLATILE_LOAD = "load volatile"
"""The first token of such a load."""
ABI_ATTRIBUTES = ("signext", "zeroext")
"""Attributes that the calling convention needs, and that are kept."""
PROMISES = {
    "captures", "dead_on_return", "dead_on_unwind", "dereferenceable", "dereferenceable_or_null", "immarg",
    "initializes", "noalias", "nocapture", "nofpclass", "nofree", "nonnull", "noundef", "range", "readnone", "readonly",
    "returned", "writable", "writeonly",
}  # fmt: skip
"""Attributes that do not change the machine code, but make a corrupted value undefined behaviour."""
POISON_FLAGS = ("nuw", "nsw", "exact", "inbounds", "nusw", "disjoint", "nneg", "samesign")
"""Flags that make some results undefined behaviour; removed."""
FAST_MATH = ("fast", "reassoc", "nnan", "ninf", "nsz", "arcp", "contract", "afn")
"""Flags that allow other results than IEEE 754; refused."""
_BINARY = {
    "add", "sub", "mul", "udiv", "sdiv", "urem", "srem", "shl", "lshr", "ashr", "and", "or", "xor",
    "fadd", "fsub", "fmul", "fdiv", "frem",
}  # fmt: skip
"""Operations on two values of one type."""
_CASTS = {
    "trunc", "zext", "sext", "fptrunc", "fpext", "fptoui", "fptosi", "uitofp", "sitofp", "ptrtoint", "inttoptr",
    "bitcast",
}  # fmt: skip
"""Conversions from one type to another."""
_PREDICATES = {
    "icmp": ("eq", "ne", "ugt", "uge", "ult", "ule", "sgt", "sge", "slt", "sle"),
    "fcmp": ("false", "oeq", "ogt", "oge", "olt", "ole", "one", "ord", "ueq", "ugt", "uge", "ult", "ule", "une", "uno",
             "true"),
}  # fmt: skip
"""Predicates of comparisons."""
_INTRINSICS = re.compile(
    r"@llvm\.(?:mem(?:set|cpy|move)(?:\.inline)?|[us](?:min|max)|[us](?:add|sub|mul)\.(?:with\.overflow|sat)|abs|floor|"
    r"ceil|trunc|rint|nearbyint|round|roundeven|fabs|sqrt|pow|powi|exp|exp2|log|log2|log10|sin|cos|tan|copysign|fma|"
    r"min(?:num|imum)|max(?:num|imum)|fshl|fshr|ctpop|ctlz|cttz|bswap|bitreverse|[us]shl\.sat|is\.fpclass|"
    r"masked\.(?:load|store|gather|scatter|compressstore|expandload)|vector\.reduce\.\w+|x86\.[\w.]+|"
    r"lro?und|llro?und|ldexp)(?:\.|$)"
)
"""Intrinsics that compute a result from their arguments, or access memory through them."""
COPIES = ('"=r,0"', '"=x,0"')
"""Constraints of an empty assembly: its result is its operand, in a general or a vector register."""
_DROPPED = re.compile(
    r"@llvm\.(?:lifetime\.(?:start|end)|assume|experimental\.noalias\.scope\.decl|donothing|invariant\.)"
)
"""Promises in the form of calls; they compute nothing."""
_POISON_ARGUMENT = re.compile(r"@llvm\.(?:abs|ctlz|cttz)\.")
"""Their last argument declares some inputs undefined behaviour."""
_PARALLEL = re.compile(r"@\"?(?:numba_parallel_for|do_scheduling|set_num_threads|get_num_threads|launch_threads)")
"""Functions of Numba that start threads, which are not deterministic."""
_PYTHON = re.compile(r"@\"?numba_gil_ensure")
"""Function that Numba calls in object mode."""


def parse_instruction(cursor: Cursor) -> Instruction | None:
    """Read one instruction; None for a call that is only a promise; an unknown one is a NotInstrumentableError."""
    result = None
    if cursor.next.startswith("%"):
        result = cursor.local()
        cursor.expect("=")
    cursor.accept("tail")
    opcode = cursor.expect(*_READERS)
    instruction = Instruction(opcode, [opcode], result)
    if opcode == "load" and cursor.accept("volatile"):
        instruction.tokens = [VOLATILE_LOAD]
    while cursor.accept(*POISON_FLAGS):
        pass  # removed: with them, a corrupted value would be undefined behaviour
    if cursor.next in FAST_MATH:
        raise cursor.refused(f"fast math ({cursor.next!r} in {' '.join(cursor.tokens)[:80]!r})")
    _READERS[opcode](cursor, instruction)
    cursor.finish()
    if instruction.callee is not None and _DROPPED.match(instruction.callee):
        return None
    return instruction


def skip_promises(cursor: Cursor) -> list[str]:
    """Skip promise attributes; returns those required by the calling convention."""
    required = []
    while True:
        if cursor.next in ABI_ATTRIBUTES:
            required.append(cursor.take())
        elif cursor.next == "align":
            cursor.take()
            cursor.number()
        elif cursor.next in PROMISES:
            cursor.take()
            if cursor.next == "(":
                cursor.balanced()
        else:
            return required


def _like(kind: str, other: str) -> str:
    """`kind`, or a vector of it if `other` is a vector."""
    if other.startswith("<"):
        return f"{other.split(' x ')[0]} x {kind}>"
    return kind


def _locals(*values: str) -> list[str]:
    """Those values that are local names."""
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


def _operands(cursor: Cursor, instruction: Instruction) -> None:
    """Read an instruction with a fixed operand form."""
    kinds = []
    for part in _FORMS[instruction.opcode].split():
        if part == "kind":
            kinds.append(cursor.kind())
            instruction.tokens.append(kinds[-1])
        elif part == "value":
            instruction.tokens.append(cursor.value())
        elif part == "align" and cursor.accept(","):
            cursor.expect("align")
            instruction.tokens += [",", "align", cursor.number()]
        elif part == "indices":
            while cursor.accept(","):
                instruction.tokens += [",", cursor.number()]
        elif part != "align":
            instruction.tokens.append(cursor.expect(part))
    instruction.kind = _result(instruction, kinds)
    if instruction.opcode == "select":
        instruction.conditions = _locals(instruction.tokens[2])
    elif instruction.opcode == "load":
        instruction.addresses = _locals(instruction.tokens[4])
    elif instruction.opcode == "store":
        instruction.addresses = _locals(instruction.tokens[5])


def _result(instruction: Instruction, kinds: list[str]) -> str:
    """Type of the result, from those of the operands."""
    if instruction.opcode in ("store", "unreachable"):
        return "void"
    if instruction.opcode == "alloca":
        return "ptr"
    if instruction.opcode == "extractvalue":
        kind = kinds[0]
        for index in instruction.tokens[4::2]:
            kind = parts(kind)[int(index)]
        return kind
    if instruction.opcode == "extractelement":
        return kinds[0].split(" x ", 1)[1][:-1]
    if instruction.opcode == "shufflevector":
        return f"{kinds[2].split(' x ')[0]} x {kinds[0].split(' x ', 1)[1]}"
    if instruction.opcode in _CASTS or instruction.opcode == "select":
        return kinds[1]
    return kinds[0]


def _compare(cursor: Cursor, instruction: Instruction) -> None:
    """Read a comparison."""
    predicate = cursor.expect(*_PREDICATES[instruction.opcode])
    kind = cursor.kind()
    instruction.tokens += [predicate, kind, cursor.value(), cursor.expect(","), cursor.value()]
    instruction.kind = _like("i1", kind)


def _phi(cursor: Cursor, instruction: Instruction) -> None:
    """Read a phi: its type, and pairs of value and label."""
    instruction.kind = cursor.kind()
    instruction.tokens.append(instruction.kind)
    while True:
        cursor.expect("[")
        value = cursor.value()
        cursor.expect(",")
        instruction.incoming.append((value, cursor.local()))
        cursor.expect("]")
        if not cursor.accept(","):
            return


def _element_address(cursor: Cursor, instruction: Instruction) -> None:
    """Read a getelementptr; with a vector of pointers or indices, the result is a vector."""
    instruction.tokens += [cursor.kind(), cursor.expect(",")]
    kinds = [cursor.kind()]
    instruction.tokens += [kinds[0], cursor.value()]
    while cursor.accept(","):
        kinds.append(cursor.kind())
        instruction.tokens += [",", kinds[-1], cursor.value()]
    instruction.kind = _like("ptr", next((kind for kind in kinds if kind.startswith("<")), ""))
    instruction.addresses = _locals(*instruction.tokens)


def _call(cursor: Cursor, instruction: Instruction) -> None:
    """Read a call of a named function, or an empty assembly."""
    abi = skip_promises(cursor)
    instruction.kind = cursor.kind()
    instruction.tokens += [*abi, instruction.kind]
    if cursor.next == "(":
        instruction.tokens += cursor.balanced()
    if cursor.next == "asm":
        _copy(cursor, instruction)
        return
    if not cursor.next.startswith("@"):
        raise cursor.refused(f"indirect call or assembly in {' '.join(cursor.tokens)[:120]!r}")
    instruction.callee = cursor.take()
    _check_callee(cursor, instruction.callee)
    instruction.tokens += [instruction.callee, cursor.expect("(")]
    _arguments(cursor, instruction)
    if cursor.next.startswith("#"):
        cursor.take()


def _copy(cursor: Cursor, instruction: Instruction) -> None:
    """An empty assembly: it copies a register, and hides from the compiler that it does."""
    instruction.tokens.append(cursor.take())
    if cursor.next != '""':
        raise cursor.refused(f"assembly {cursor.next}")
    instruction.tokens += [cursor.take(), cursor.expect(","), cursor.expect(*COPIES), cursor.expect("(")]
    _arguments(cursor, instruction)
    if [kind for kind, _ in instruction.arguments] != [instruction.kind]:
        raise cursor.refused(f"assembly of {instruction.kind}")


def _check_callee(cursor: Cursor, callee: str) -> None:
    """Refuse parallel execution, object mode and unknown intrinsics."""
    if _PARALLEL.match(callee):
        raise cursor.refused(f"parallel execution ({callee})")
    if _PYTHON.match(callee):
        raise cursor.refused(f"object mode ({callee})")
    if callee.startswith("@llvm.") and not (_INTRINSICS.match(callee) or _DROPPED.match(callee)):
        raise cursor.refused(f"intrinsic {callee}")


def _arguments(cursor: Cursor, instruction: Instruction) -> None:
    """Read the arguments of a call, up to the closing bracket."""
    callee = str(instruction.callee)
    if _DROPPED.match(callee):  # skip them, from the opening bracket on
        cursor.at -= 1
        cursor.balanced()
        return
    while not cursor.accept(")"):
        kind = cursor.kind()
        abi = skip_promises(cursor)
        value = cursor.value()
        if _POISON_ARGUMENT.match(callee) and cursor.next == ")":
            value = "false"
        instruction.arguments.append((kind, value))
        instruction.tokens += [kind, *abi, value]
        is_length = callee.startswith("@llvm.mem") and kind == "i64"
        if holds_pointer(kind) or is_length:
            instruction.addresses += _locals(value)
        if cursor.accept(","):
            instruction.tokens.append(",")
    instruction.tokens.append(")")


def _branch(cursor: Cursor, instruction: Instruction) -> None:
    """Read a branch, with or without condition."""
    if cursor.next != "label":
        instruction.tokens += [cursor.expect("i1"), cursor.value(), cursor.expect(",")]
        instruction.conditions = _locals(instruction.tokens[2])
        instruction.tokens += [cursor.expect("label"), cursor.local(), cursor.expect(",")]
    instruction.tokens += [cursor.expect("label"), cursor.local()]


def _switch(cursor: Cursor, instruction: Instruction) -> None:
    """Read a switch."""
    instruction.tokens += [cursor.kind(), cursor.value(), cursor.expect(","), cursor.expect("label"), cursor.local()]
    instruction.conditions = _locals(instruction.tokens[2])
    instruction.tokens.append(cursor.expect("["))
    while not cursor.accept("]"):
        instruction.tokens += [
            cursor.kind(),
            cursor.value(),
            cursor.expect(","),
            cursor.expect("label"),
            cursor.local(),
        ]
    instruction.tokens.append("]")


def _return(cursor: Cursor, instruction: Instruction) -> None:
    """Read a return."""
    kind = cursor.kind()
    instruction.tokens.append(kind)
    if kind != "void":
        instruction.tokens.append(cursor.value())


_READERS = {
    **dict.fromkeys(_FORMS, _operands), "icmp": _compare, "fcmp": _compare, "phi": _phi,
    "getelementptr": _element_address, "call": _call, "br": _branch, "switch": _switch, "ret": _return,
}  # fmt: skip
