"""Duplication of instructions in the IR of a kernel, after all optimisation.

Each chosen value gets a *shadow*, computed by the same instruction from the shadows of its operands.  A shadow whose
operands are all shared with the original takes one of them through an empty assembly (a *copy*), or loads again by a
volatile load: code generation can merge neither.  Where a value leaves the chosen set (a store, a call, a return, a
value that is not chosen), its bits are compared with those of its shadow, in the block of the definition or in those
of the uses, whichever are in fewer loops.  Both edges of a branch check the shadow of its condition.

On a difference the function returns `DETECTED`, which every caller in the module propagates.  Numba's wrapper then
raises a SystemError, which no kernel does otherwise.

The first part says which instructions can be duplicated, the last one changes the wrapper.
"""

import re
from collections import defaultdict
from collections.abc import Collection, Iterator
from dataclasses import replace

from mavfi.extras.hardening.plan import ModuleSite
from mavfi.ir.flow import back_edges, loop_depths, successors
from mavfi.ir.module import BasicBlock, Function, Instruction, Module, width
from mavfi.ir.parser import VOLATILE_LOAD

_PURE = re.compile(
    r"@llvm\.(?:[us](?:min|max)|abs|floor|ceil|trunc|rint|nearbyint|round|roundeven|fabs|sqrt|copysign|fma|"
    r"min(?:num|imum)|max(?:num|imum)|fshl|fshr|ctpop|ctlz|cttz|bswap|bitreverse|is\.fpclass|masked\.(?:load|gather)|"
    r"[us](?:add|sub)\.sat|vector\.reduce\.\w+)(?:\.|$)|@(?:sqrt|fabs|floor|ceil|trunc|rint)f?$"
)
_MEMORY = re.compile(r"@llvm\.masked\.(?:load|gather)\.")
_WORD = re.compile(r"i(?:8|16|32|64)|ptr")
_SMALL = re.compile(r"i[1-7]")
_VECTOR = re.compile(r"<\d+ x (?:double|float|i64|i32|i16|i8|ptr)>")


def candidates(module: Module) -> list[ModuleSite]:
    """All sites that can be duplicated, in text order."""
    reporting_functions = reporting(module)
    sites = []
    for i, function in enumerate(module.functions):
        if function.name not in reporting_functions:
            continue
        kinds = kinds_of(function)
        for j, block in enumerate(function.blocks):
            for k, instruction in enumerate(block.sites):
                if can_repeat(instruction) and _can_differ(instruction, kinds):
                    sites.append(ModuleSite(i, j, k))
    return sites


def reporting(module: Module) -> set[str]:
    """Functions that can return a status, and are called only by such functions and by Numba's wrapper."""
    names = {function.name for function in module.functions if function.kind == "i32"}
    calls = [(function.name, called) for function in module.functions for called in callees(function)]
    while True:  # removing a function may leave another one with a caller that cannot return a status
        without_reporting_caller = {called for caller, called in calls if caller not in names} & names
        if not without_reporting_caller:
            return names
        names -= without_reporting_caller


def callees(function: Function) -> set[str]:
    """Names of the functions that a function calls."""
    instructions = (instruction for block in function.blocks for instruction in block.body)
    return {instruction.callee for instruction in instructions if instruction.callee is not None}


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


def is_address(name: str, user: Instruction) -> bool:
    """Whether an instruction loads one or several elements from a value."""
    is_load = user.opcode == "load" or bool(_MEMORY.match(str(user.callee)))
    return is_load and name in user.addresses


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
    kinds = {name: kind.removesuffix(" signext").removesuffix(" zeroext") for kind, name in function.parameters}
    for block in function.blocks:
        for instruction in block.all():
            if instruction.result is not None:
                kinds[str(instruction.result)] = instruction.kind
    return kinds


def uses(function: Function) -> Iterator[tuple[str, Instruction, str]]:
    """Operands of all instructions: name, user, and label of the block in which the operand must be available.

    A phi needs an incoming value at the end of the block before.
    """
    for block in function.blocks:
        for user in block.all():
            operands = user.incoming or [(name, block.label) for name in dict.fromkeys(user.uses())]
            for name, label in operands:
                yield name, user, label


# ---- duplication ----------------------------------------------------------------------------------------------------

DETECTED = -4
"""Status of a protected function in which a value and its shadow differ.

Numba uses 0 to -3 (-1, an exception set by Python, would crash without one); positive ones are the kernel's exceptions.
"""
SHADOW = "shadow"
COPY = "copy"
CHECK = "check"
"""Roles of added instructions."""
_STOP = "%detected"
"""Label of the block that returns the status."""
_UNDEFINED = re.compile(r"\b(?:undef|poison)\b")
_FIRST_IS_RARE = "!1"
"""Weights of a branch that hardly ever goes to its first target."""
_SECOND_IS_RARE = "!2"
"""Weights of a branch that hardly ever goes to its second target."""
_WEIGHTS = ['!1 = !{!"branch_weights", i32 1, i32 100000}', '!2 = !{!"branch_weights", i32 100000, i32 1}']


def protect(module: Module, sites: Collection[ModuleSite], *, addresses: bool) -> Module:
    """A module in which the values at the given sites are duplicated and compared.

    Fault-free results are bit-identical.  Results of the original instructions keep their names, so that the sites of
    both modules can be paired; added instructions have a `role`.

    Args:
        module: The parsed module; it is not modified.
        sites: What to duplicate; sites that `candidates` does not name are ignored.
        addresses: Whether the addresses of loads are compared before the loads, too.

    Returns:
        The protected module; an equal one for no sites.
    """
    duplicable = set(candidates(module)) & set(sites)
    if not duplicable:
        return module

    # 1. Names of the chosen values, by function.
    chosen: dict[int, set[str]] = defaultdict(set)
    for number, block, offset in duplicable:
        chosen[number].add(str(module.functions[number].blocks[block].sites[offset].result))

    # 2. Functions that may return the status: those with chosen values, and all callers of such functions.
    reporting_functions = reporting(module)
    detecting = {module.functions[number].name for number in chosen}
    while True:
        callers = {
            f.name for f in module.functions if f.name in reporting_functions and callees(f) & detecting
        } - detecting
        if not callers:
            break
        detecting |= callers

    # 3. Rewrite these functions; the wrapper raises an error when one detects a difference.
    functions = []
    for number, function in enumerate(module.functions):
        if function.name in detecting:
            plain = _without_undefined(function)
            function = _Duplicator(plain, chosen[number], detecting, addresses=addresses).run()
        functions.append(function)
    declared = {line.split(" ")[0] for line in module.preamble}
    added = [line for line in GLOBALS if line.split(" ")[0] not in declared]
    others = [raising(text, detecting, DETECTED) for text in module.others]
    return replace(module, preamble=[*module.preamble, *added, *_WEIGHTS], functions=functions, others=others)


class _Duplicator:
    """Writer of one function with shadows of its chosen values.

    Args:
        function: The function, without undefined values.
        chosen: Names of the values to duplicate.
        detecting: Names of the functions that may return `DETECTED`.
        addresses: Whether addresses are compared before loads, too.

    Attributes:
        kinds: Types of all values, by name.
        definitions: Block and instruction that compute each value.
        headers: Labels of the latches of each loop header.
        duplicable: Names of the values that get a shadow.
        uses: Users of each of these values, with the label of the block in which it must be available.
        checked_in: See `_places_of_checks`.
        checked_at_end: See `_checks_at_end`.
        numbers: Number of added instructions.
        tails: Copies at the end of a block, by its label.
        starts: Initial value of a phi's shadow, by result, label and value.
        ends: Label of the last part of a block that leads to another one, by both labels.
        blocks: Blocks written so far.
        block: The part of a block that is being written.
        copies: Copies of operands in this block, by operand.
        checked: Values compared in this block.
    """

    def __init__(self, function: Function, chosen: set[str], detecting: set[str], *, addresses: bool) -> None:
        self.function = function
        self.addresses = addresses
        self.detecting = detecting
        self.kinds = kinds_of(function)
        self.definitions = {str(site.result): (block, site) for block in function.blocks for site in block.sites}
        self.headers: dict[str, set[str]] = defaultdict(set)
        for latch, header in back_edges(function):
            self.headers[header].add(latch)
        self.duplicable = self._separable(chosen)
        self.uses: dict[str, list[tuple[Instruction, str]]] = {name: [] for name in self.duplicable}
        for name, user, label in uses(function):
            if name in self.duplicable:
                self.uses[name].append((user, label))
        self.checked_in = self._places_of_checks()
        self.checked_at_end = self._checks_at_end()
        self.numbers = 0
        self.tails: dict[str, list[Instruction]] = defaultdict(list)
        self.starts: dict[tuple[str, str, str], str] = {}
        self.ends: dict[tuple[str, str], str] = {}
        self.blocks: list[BasicBlock] = []

    # ---- what is duplicated and compared ----------------------------------------------------------------------------
    def _separable(self, chosen: set[str]) -> set[str]:
        """The chosen values without those whose shadow code generation could merge with them."""
        while True:  # removing a value may leave a user of it without an operand of its own
            separable = {name for name in chosen if self._can_differ(self.definitions[name][1], chosen)}
            if separable == chosen:
                return separable
            chosen = separable

    def _can_differ(self, instruction: Instruction, chosen: set[str]) -> bool:
        """Whether a shadow of an instruction can have an operand that the original does not have."""
        if instruction.opcode in ("load", "phi"):
            return True
        return any(name in chosen or can_copy(self.kinds.get(name, "")) for name in instruction.uses())

    def _must_be_checked(self, name: str, user: Instruction) -> bool:
        """Whether a value must be compared before this use of it."""
        if user.result in self.duplicable:
            return self.addresses and is_address(name, user)
        return not (is_fork(user) and name == user.tokens[2])

    def _places_of_checks(self) -> dict[str, set[str]]:
        """Labels of the blocks in which each value is compared; the only one may be that in which it is computed."""
        depth = loop_depths(self.function)
        places = {}
        for name, users in self.uses.items():
            exits = {label for user, label in users if self._must_be_checked(name, user)}
            if not exits:
                continue
            # Ten executions per loop are assumed: the cheaper place is taken.
            block_of_definition = self.definitions[name][0].label
            executions_at_exits = sum(10.0 ** depth[label] for label in exits)
            if executions_at_exits < 10.0 ** depth[block_of_definition]:
                places[name] = exits
            else:
                places[name] = {block_of_definition}
        return places

    def _checks_at_end(self) -> dict[str, list[str]]:
        """Values to be compared at the end of each block, since a phi takes them."""
        names: dict[str, list[str]] = defaultdict(list)
        for name, labels in self.checked_in.items():
            for user, label in self.uses[name]:
                if user.opcode == "phi" and label in labels and self._must_be_checked(name, user):
                    names[label].append(name)
        return names

    def _only_decides(self, name: str) -> bool:
        """Whether a value is a comparison for branches only: its shadow is computed on their edges."""
        return self.definitions[name][1].opcode in ("icmp", "fcmp") and all(
            is_fork(user) for user, _ in self.uses[name]
        )

    # ---- writing ----------------------------------------------------------------------------------------------------
    def run(self) -> Function:
        """The protected function."""
        # 1. Copies with which shadows of phis begin: they stand in blocks that may be written earlier.
        for block in self.function.blocks:
            for phi in block.phis:
                if phi.result in self.duplicable:
                    self._start(phi, block.label)

        # 2. The blocks, each in one part or several.
        for block in self.function.blocks:
            self._write(block)

        # 3. Phis must name the parts of blocks that lead to them, and all checks need the block that stops.
        for block in self.blocks:
            for number, phi in enumerate(block.phis):
                incoming = [(value, self.ends.get((before, block.label), before)) for value, before in phi.incoming]
                block.phis[number] = replace(phi, incoming=incoming)
        if any(_STOP in successors(block.terminator) for block in self.blocks):
            end = Instruction("ret", ["ret", "i32", str(DETECTED)])
            self.blocks.append(BasicBlock(_STOP, terminator=end, unreached=True))
        return replace(self.function, blocks=self.blocks)

    def _start(self, phi: Instruction, label: str) -> None:
        """Copy incoming values of a phi that have no shadow, where its own shadow would else equal the original."""
        latches = self.headers[label]
        plain = [(value, before) for value, before in phi.incoming if value not in self.duplicable]
        if latches:
            # Without different initial values, original and shadow would be one recurrence.
            initial = [(value, before) for value, before in plain if before not in latches]
            copied = initial or plain
        elif len(plain) == len(phi.incoming):
            copied = plain[:1]
        else:
            copied = []  # an incoming value has a shadow, which sets the phi's apart
        for value, before in copied:
            self.starts[str(phi.result), before, value] = self._copy(value, phi, self.tails[before])

    def _write(self, block: BasicBlock) -> None:
        """Write a block: originals, each followed by its shadow and checks; a check begins a new part."""
        self.block = BasicBlock(block.label, list(block.phis), block.allocations)
        self.origin_label = block.label  # of the parts into which checks split it
        self.blocks.append(self.block)
        self.copies: dict[str, str] = {}
        self.checked: set[str] = set()
        for phi in block.phis:
            if phi.result in self.duplicable:
                self.block.phis.append(self._shadow_of_phi(phi))
        for phi in block.phis:
            self._check_where_computed(phi, block.label)
        for instruction in block.body:
            self._check_uses(instruction, block.label)
            self.block.body.append(instruction)
            if instruction.result in self.duplicable and not self._only_decides(instruction.result):
                self._shadow(instruction, shadow(instruction.result))
            self._check_where_computed(instruction, block.label)
            if instruction.callee in self.detecting:
                # the called function has detected a difference: its caller need not look at the status
                self._stop_if("eq", "i32", [str(instruction.result), str(DETECTED)], instruction)
        for name in self.checked_at_end[block.label]:
            self._check(name, block.terminator)
        self.block.body += self.tails[block.label]
        self._finish(block)

    def _finish(self, block: BasicBlock) -> None:
        """Write the terminator of a block."""
        end = block.terminator
        assert end is not None  # of parsed blocks
        if is_fork(end) and end.tokens[2] in self.duplicable:
            self._check_edges(block.label, end)
            return
        self._check_uses(end, block.label)
        self.block.terminator = end
        self.ends.update({(block.label, label): self.block.label for label in successors(end)})

    def _shadow_of_phi(self, phi: Instruction) -> Instruction:
        result = str(phi.result)
        incoming = []
        for value, label in phi.incoming:
            if value in self.duplicable:
                shadow_value = shadow(value)
            else:
                shadow_value = self.starts.get((result, label, value), value)
            incoming.append((shadow_value, label))
        return replace(phi, result=shadow(result), incoming=incoming, role=SHADOW)

    def _shadow(self, instruction: Instruction, result: str) -> None:
        """Append the shadow of an instruction, named `result`."""
        operands = {name: shadow(name) for name in instruction.uses() if name in self.duplicable}
        opcode = instruction.tokens[0]
        if not operands and instruction.opcode == "load":
            opcode = VOLATILE_LOAD
        elif not operands:
            # A copy that this block has already is best, then one that needs no detour through a byte.
            copyable = [name for name in instruction.uses() if can_copy(self.kinds.get(name, ""))]
            name = min(copyable, key=lambda name: (name not in self.copies, constraint_of(self.kinds[name]) is None))
            if name not in self.copies:
                self.copies[name] = self._copy(name, instruction, self.block.body)
            operands = {name: self.copies[name]}
        self.block.body.append(
            replace(
                instruction,
                result=result,
                role=SHADOW,
                tokens=[opcode, *(operands.get(token, token) for token in instruction.tokens[1:])],
                addresses=[operands.get(name, name) for name in instruction.addresses],
                conditions=[operands.get(name, name) for name in instruction.conditions],
                arguments=[(kind, operands.get(value, value)) for kind, value in instruction.arguments],
            )
        )

    def _copy(self, value: str, like: Instruction, body: list[Instruction]) -> str:
        """Append a copy of a value that code generation takes for another one; returns its name."""
        if like.opcode == "phi":  # its value may be a constant
            kind = like.kind
        else:
            kind = self.kinds[value]
        constraint = constraint_of(kind)
        if constraint is None:  # a few bits: through a byte
            wide = self._new("zext", [kind, value, "to", "i8"], "i8", like, body, COPY)
            wide = self._assembly(wide, "i8", '"=r,0"', like, body)
            return self._new("trunc", ["i8", wide, "to", kind], kind, like, body, COPY)
        return self._assembly(value, kind, constraint, like, body)

    def _assembly(self, value: str, kind: str, constraint: str, like: Instruction, body: list[Instruction]) -> str:
        name = self._new("call", [kind, "asm", '""', ",", constraint, "(", kind, value, ")"], kind, like, body, COPY)
        body[-1].arguments = [(kind, value)]
        return name

    def _new(
        self, opcode: str, rest: list[str], kind: str, like: Instruction, body: list[Instruction], role: str
    ) -> str:
        """Append an instruction at the source line of another one; returns its new name."""
        self.numbers += 1
        name = f"%x{self.numbers}"
        body.append(Instruction(opcode, [opcode, *rest], name, kind, location=like.location, role=role))
        return name

    # ---- comparisons ------------------------------------------------------------------------------------------------
    def _check_where_computed(self, instruction: Instruction, label: str) -> None:
        """Compare the result of an instruction if that is to happen in its block."""
        name = str(instruction.result)
        if self.checked_in.get(name) == {label} and self.definitions[name][0].label == label:
            self._check(name, instruction)

    def _check_uses(self, user: Instruction, label: str) -> None:
        """Compare the values that leave the set here."""
        for name in dict.fromkeys(user.uses()):
            if label in self.checked_in.get(name, ()) and self._must_be_checked(name, user):
                self._check(name, user)

    def _check(self, name: str, like: Instruction | None) -> None:
        """Compare a value with its shadow, once per block."""
        if name in self.checked or like is None:
            return
        self.checked.add(name)
        kind = self.kinds[name]
        pair = [name, shadow(name)]
        body = self.block.body
        if kind.startswith("<") and "ptr" in kind:
            numbers = kind.replace("ptr", "i64")
            pair = [self._new("ptrtoint", [kind, value, "to", numbers], numbers, like, body, CHECK) for value in pair]
            kind = numbers
        if kind != "ptr" and kind[0] != "i":
            word = f"i{width(kind)}"
            pair = [self._new("bitcast", [kind, value, "to", word], word, like, body, CHECK) for value in pair]
            kind = word
        self._stop_if("ne", kind, pair, like)

    def _stop_if(self, predicate: str, kind: str, pair: list[str], like: Instruction) -> None:
        """End this part of the block: return the status if a comparison is true, else go on in a new part."""
        is_true = self._new("icmp", [predicate, kind, pair[0], ",", pair[1]], "i1", like, self.block.body, CHECK)
        following = f"{self.origin_label}c{self.numbers}"
        self.block.terminator = _branch(is_true, _STOP, following, _FIRST_IS_RARE, like)
        self.block = BasicBlock(following, runs_as=(self.origin_label,))
        self.blocks.append(self.block)

    def _check_edges(self, label: str, end: Instruction) -> None:
        """Branch on the condition, then on its shadow: both must lead to the same block."""
        condition = end.tokens[2]
        if_true, if_false = successors(end)
        true_edge = f"{label}e0"
        false_edge = f"{label}e1"
        self.block.terminator = _branch(condition, true_edge, false_edge, "", end)

        other = self._begin_edge(true_edge, condition, runs_as=())
        self.block.terminator = _branch(other, if_true, _STOP, _SECOND_IS_RARE, end)
        self.ends[label, if_true] = true_edge

        other = self._begin_edge(false_edge, condition, runs_as=(label, true_edge))
        self.block.terminator = _branch(other, _STOP, if_false, _FIRST_IS_RARE, end)
        self.ends[label, if_false] = false_edge

    def _begin_edge(self, edge: str, condition: str, runs_as: tuple[str, ...]) -> str:
        """Begin the block of an edge; returns the shadow of the condition there."""
        self.block = BasicBlock(edge, runs_as=runs_as)
        self.origin_label = edge
        self.blocks.append(self.block)
        if not self._only_decides(condition):
            return shadow(condition)
        copies = self.copies
        self.copies = dict(copies)  # a copy made on one edge is not known on the other one
        self._shadow(self.definitions[condition][1], f"{edge}s")
        self.copies = copies
        return f"{edge}s"


def _without_undefined(function: Function) -> Function:
    """A function with zeros for undefined values, which may differ between a value and its shadow."""
    blocks = []
    for block in function.blocks:
        phis = [_with_zeros(phi) for phi in block.phis]
        body = [_with_zeros(instruction) for instruction in block.body]
        terminator = block.terminator and _with_zeros(block.terminator)
        blocks.append(BasicBlock(block.label, phis, block.allocations, body, terminator))
    return replace(function, blocks=blocks)


def _with_zeros(instruction: Instruction) -> Instruction:
    def defined(text: str) -> str:
        if text[0] in '@%"':  # a name
            return text
        return _UNDEFINED.sub("zeroinitializer", text)

    return replace(
        instruction,
        tokens=[defined(token) for token in instruction.tokens],
        incoming=[(defined(value), label) for value, label in instruction.incoming],
        arguments=[(kind, defined(value)) for kind, value in instruction.arguments],
    )


def is_fork(instruction: Instruction) -> bool:
    """Whether an instruction is a branch to one of two blocks."""
    return instruction.opcode == "br" and len(set(successors(instruction))) == 2


def shadow(name: str) -> str:
    """Name of the shadow of a value."""
    return f"{name}s"


def _branch(condition: str, first: str, second: str, weights: str, like: Instruction) -> Instruction:
    tokens = ["br", "i1", condition, ",", "label", first, ",", "label", second]
    if weights:
        tokens += [",", "!prof", weights]
    return Instruction("br", tokens, conditions=[condition], location=like.location)


# ---- the wrapper ----------------------------------------------------------------------------------------------------

MESSAGE = "a value and its shadow differ"
"""Text of the error."""
GLOBALS = [
    "@PyExc_SystemError = external global ptr",
    f'@mavfi_detected = private constant [{len(MESSAGE) + 1} x i8] c"{MESSAGE}\\00"',
]
_FOLLOWS_CALL = re.compile(r"\s*(?:%\S+ = load |call void @(?:PyEval_RestoreThread|NRT_decref) )")
"""What follows the call: results are read, the interpreter's lock is taken, arguments are released."""


def raising(text: str, kernels: set[str], status: int) -> str:
    """A function outside the fault space; if it is the wrapper that calls one of the kernels, it raises."""
    lines = text.split("\n")
    if "@_ZN7cpython" not in lines[0] and '@"_ZN7cpython' not in lines[0]:
        return text
    calls = [number for number, line in enumerate(lines) if _called(line) in kernels]
    if len(calls) != 1:
        return text

    # The check stands behind the call and what belongs to it, and begins a new block.
    end = calls[0] + 1
    while _FOLLOWS_CALL.match(lines[end]):
        end += 1
    label = next(line[:-1] for line in lines[calls[0] :: -1] if re.fullmatch(r'(?:"[^"]*"|[-\w$.]+):', line))
    result = lines[calls[0]].split()[0]
    check = [
        f"  %mavfi.differs = icmp eq i32 {result}, {status}",
        "  br i1 %mavfi.differs, label %mavfi.raise, label %mavfi.fine",
        "mavfi.raise:",
        "  call void @PyErr_SetString(ptr @PyExc_SystemError, ptr @mavfi_detected)",
        "  ret ptr null",
        "mavfi.fine:",
    ]

    # Phis after it must name the new block instead of that of the call.
    for number, line in enumerate(lines):
        if " = phi " in line:
            lines[number] = line.replace(f"%{label} ]", "%mavfi.fine ]")
    return "\n".join([*lines[:end], *check, *lines[end:]])


def _called(line: str) -> str:
    """Name of the function that a line calls for a status; "" = none."""
    match = re.match(r'\s*%\S+ = call i32 (@(?:"[^"]*"|[-\w$.]+)) \(', line)
    if match is None:
        return ""
    return match[1]
