"""Rewrites the IR of a kernel so that the result of one dynamic instruction can be changed, once.

Each block with n sites becomes

    B:       its phis; counter += n; beyond the threshold? -> B.slow, else -> B.fast
    B.fast:  the original instructions                                               -> B.join
    B.slow:  the same, each followed by (value & keep) ^ flip at the injection site -> B.join
    B.join:  a phi for each value used elsewhere; the terminator

so that all blocks but the injected one run as before.  After the injection all blocks take the slow path, which checks
each memory access.  The result is not optimised further, only translated.
"""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import count

import llvmlite.binding as llvm

from mavfi.ir.build import Rewrite
from mavfi.ir.injection.accesses import (
    Access,
    Constant,
    accesses_of,
    constants_of,
    export_constants,
    is_owned,
    planned_wrapper,
    relocate,
    size_of,
)
from mavfi.ir.injection.arena import LINE
from mavfi.ir.injection.runtime import (
    MASK_BYTES,
    MEMORY,
    REPORT_WORDS,
    RUNTIME,
    ControlWord,
    declarations,
    word_address,
)
from mavfi.ir.injection.table import SiteTable, make_table
from mavfi.ir.module import (
    BasicBlock,
    Function,
    Instruction,
    Module,
    NotInstrumentableError,
    bodies_of,
    digest_of,
    parts,
    width,
)
from mavfi.ir.parser import parse_module

_ENVIRONMENT = re.compile(r'@"?_ZN08NumbaEnv')
"""Beginning of the name of Numba's environment of a kernel."""
_UNLIKELY = '!0 = !{!"branch_weights", i32 1, i32 100000}'
"""Metadata of a branch that is hardly ever taken: the slow path."""


@dataclass(frozen=True, slots=True)
class Instrumented:
    """An instrumented module.

    Attributes:
        text: IR.
        tally: IR that counts block executions only, see `tally`.
        table: Sites.
        ir_sha256: Digest of the fault space, the same in every process.
        constants: Arrays placed in the arena.
        owned: Whether all memory accesses are known, and are checked after an injection.
    """

    text: str
    tally: str
    table: SiteTable
    ir_sha256: str
    constants: tuple[Constant, ...]
    owned: bool


def instrument(text: str, kernel: str, rewrite: Rewrite | None = None) -> Instrumented:
    """Instrument a module from `Dispatcher.inspect_llvm`, rewritten before; `kernel` is the name for error messages.

    Raises:
        NotInstrumentableError: A construct is unknown, or cannot be instrumented exactly.
    """
    # Parse, and refuse what cannot be instrumented exactly.
    module = parse_module(text, kernel)
    if not module.functions:
        raise NotInstrumentableError(kernel, "there is no IR: was it loaded from a cache?")
    if rewrite is not None:
        module = rewrite(module)
    table = make_table(module)
    widest = max((site.width for block in table.blocks for site in block), default=0)
    if widest > 8 * MASK_BYTES:
        raise NotInstrumentableError(kernel, f"a value of {widest} bits")
    if _ENVIRONMENT.search(bodies_of(module)):
        raise NotInstrumentableError(kernel, "Python objects are used within compiled code (Numba's environment)")
    # What belongs to the code as it is: the functions are redirected to the arena below.
    digest = digest_of(module)
    owned = is_owned(module)
    constants = constants_of(module)
    tally = tally_text(module)
    # Assemble the instrumented module: the injection runtime and the rewritten functions.
    names = [function.name for function in module.functions]
    others = [planned_wrapper(text, names) for text in module.others]
    lines = [*(export_constants(line, constants) for line in module.preamble), RUNTIME, MEMORY]
    first_block = 0
    for function in module.functions:
        _move(function, constants)
        lines.append(_Rewriter(function, first_block).text())
        first_block += len(_blocks_with_sites(function))
    lines += [*others, declarations("\n".join([*module.preamble, *others])), _UNLIKELY, ""]
    return Instrumented("\n".join(lines), tally, table, digest, tuple(constants.values()), owned)


def _move(function: Function, constants: dict[str, Constant]) -> None:
    """Redirect a function to the arena's constants and runtime."""
    for block in function.blocks:
        for instruction in block.all():
            instruction.tokens = [relocate(token, constants) for token in instruction.tokens]
            instruction.incoming = [(relocate(value, constants), label) for value, label in instruction.incoming]
            instruction.arguments = [(kind, relocate(value, constants)) for kind, value in instruction.arguments]


class _Rewriter:
    """Rewrites one function."""

    def __init__(self, function: Function, first_block: int) -> None:
        """Prepare.

        Args:
            function: The function.
            first_block: Number of its first block with sites.
        """
        self.function = function
        self.first_block = first_block
        self.lines: list[str] = [function.head()]
        self.temporaries = 0  # number of temporary values so far
        self.reported_values = ""  # pointer to the values in the report, in the slow path of a block
        self.frame = ""  # address of the function's stack frame; "" = it has none
        self.joined = {block.label: f"{block.label}.join" for block in _blocks_with_sites(function)}
        self.shared = _used_elsewhere(function)

    def text(self) -> str:
        """IR of the rewritten function."""
        number = self.first_block
        for block in self.function.blocks:
            if block.sites:
                self._split(block, number)
                number += 1
            else:
                self.lines.append(f"{block.label[1:]}:")
                self._allocate(block)
                self._checked(block.body, {}, lambda instruction: self.lines.append(instruction.line()))
                self._leave(block)
        return "\n".join([*self.lines, "}"])

    def _allocate(self, block: BasicBlock) -> None:
        """Allocate the function's stack frame in the arena."""
        if not block.allocations:
            return
        self.frame = self._let(f"load i64, ptr {word_address(ControlWord.FRAME)}")
        size = 0
        for memory in block.allocations:
            start = self._let(f"add i64 {self.frame}, {size}")
            self.lines.append(f"  {memory.result} = inttoptr i64 {start} to ptr")
            size += -(-size_of(memory.tokens[1]) // LINE) * LINE
        end = self._let(f"add i64 {self.frame}, {size}")
        self.lines.append(f"  store i64 {end}, ptr {word_address(ControlWord.FRAME)}")
        self.lines.append(f"  call void @mavfi_overflow(i64 {end})")

    def _leave(self, block: BasicBlock) -> None:
        """The terminator; a return releases the stack frame."""
        if block.terminator is not None:
            if block.terminator.opcode == "ret" and self.frame:
                self.lines.append(f"  store i64 {self.frame}, ptr {word_address(ControlWord.FRAME)}")
            self.lines.append(f"  {block.terminator.text()}")

    def _checked(self, body: list[Instruction], names: dict[str, str], write: Callable[[Instruction], None]) -> None:
        """Write instructions, each preceded by checks of its memory accesses."""
        for instruction in body:
            for access in accesses_of(instruction):
                self._check(access, names)
            write(instruction)

    def _check(self, access: Access, names: dict[str, str]) -> None:
        """Write the check of an access; of a masked one, lane by lane."""
        pointer = names.get(access.pointer, access.pointer)
        size = names.get(access.size, access.size)
        if not access.lanes:
            self.lines.append(f"  call void @mavfi_check(ptr {pointer}, i64 {size})")
            return
        mask = names.get(access.mask, access.mask)
        for lane in range(access.lanes):
            is_set = self._let(f"extractelement <{access.lanes} x i1> {mask}, i64 {lane}")
            address = self._let(f"extractelement <{access.lanes} x ptr> {pointer}, i64 {lane}")
            accessed = self._let(f"select i1 {is_set}, i64 {size}, i64 0")
            self.lines.append(f"  call void @mavfi_check(ptr {address}, i64 {accessed})")

    def _let(self, text: str) -> str:
        """A new name for the result of an instruction."""
        self.temporaries += 1
        name = f"%t{self.temporaries}"
        self.lines.append(f"  {name} = {text}")
        return name

    def _split(self, block: BasicBlock, number: int) -> None:
        """Write a block with sites as shown at the top of this module."""
        label = block.label
        # The head: count the sites, and choose the path.
        self.lines.append(f"{label[1:]}:")
        raw = {str(phi.result): f"{phi.result}.p" for phi in block.phis}
        self.lines += [phi.line(labels=self.joined, suffix=".p") for phi in block.phis]
        self._allocate(block)
        before = self._let("load i64, ptr @mavfi_control")
        after = self._let(f"add i64 {before}, {len(block.sites)}")
        self.lines.append(f"  store i64 {after}, ptr @mavfi_control")
        threshold = self._let(f"load i64, ptr {word_address(ControlWord.THRESHOLD)}")
        beyond = self._let(f"icmp ugt i64 {after}, {threshold}")
        self.lines.append(f"  br i1 {beyond}, label {label}.slow, label {label}.fast, !prof !0")
        # Both paths, each with its own names for the values of the block.
        fast = self._fast(block, dict(raw))
        slow = self._slow(block, dict(raw), after, number)
        # The join: only values that are used elsewhere need one name.
        self.lines.append(f"{label[1:]}.join:")
        for site in block.sites:
            name = str(site.result)
            if name in self.shared:
                pairs = f"[ {fast[name]}, {label}.fast ], [ {slow[name]}, {label}.slow ]"
                self.lines.append(f"  {name} = phi {site.kind} {pairs}")
        self._leave(block)

    def _fast(self, block: BasicBlock, names: dict[str, str]) -> dict[str, str]:
        """Write the original instructions; returns the names of all values on this path, given those of the phis."""
        self.lines.append(f"{block.label[1:]}.fast:")
        for instruction in block.body:
            self.lines.append(instruction.line(names, suffix=".f"))
            if instruction.result is not None:
                names[instruction.result] = f"{instruction.result}.f"
        self.lines.append(f"  br label {block.label}.join")
        return names

    def _slow(self, block: BasicBlock, names: dict[str, str], after: str, number: int) -> dict[str, str]:
        """Write the instructions with injections and checks; returns names as `_fast`.

        Args:
            block: The block.
            names: Names of the phis before an injection; changed.
            after: The counter after the block.
            number: Number of the block.
        """
        self.lines.append(f"{block.label[1:]}.slow:")
        injected = self._let(f"call i64 @mavfi_slow(i64 {after}, i64 {len(block.sites)}, i64 {number})")
        report = self._let(f"load ptr, ptr {word_address(ControlWord.REPORT)}")
        self.reported_values = self._let(f"getelementptr i64, ptr {report}, i64 {REPORT_WORDS}")
        offsets = count()
        for phi in block.phis:
            names[str(phi.result)] = self._injected(phi, f"{phi.result}.p", injected, next(offsets))

        def write(instruction: Instruction) -> None:
            self.lines.append(instruction.line(names, suffix=".r"))
            if instruction.result is not None:
                raw = f"{instruction.result}.r"
                names[instruction.result] = self._injected(instruction, raw, injected, next(offsets))

        self._checked(block.body, names, write)
        self.lines.append(f"  br label {block.label}.join")
        return names

    def _injected(self, site: Instruction, raw: str, chosen_offset: str, offset: int) -> str:
        """Write code that changes a value if chosen, and reports it before and after; returns its new name."""
        bits = width(site.kind)
        word = f"i{bits}"
        whole_bytes = f"i{-(-bits // 8) * 8}"
        # (value & keep) ^ flip, if this is the chosen site
        is_chosen = self._let(f"icmp eq i64 {chosen_offset}, {offset}")
        value = self._to_bits(raw, site.kind, bits)
        keep = self._resized(self._let(f"load {whole_bytes}, ptr @mavfi_keep"), whole_bytes, word)
        flip = self._resized(self._let(f"load {whole_bytes}, ptr @mavfi_flip"), whole_bytes, word)
        masked = self._let(f"and {word} {value}, {keep}")
        changed = self._let(f"xor {word} {masked}, {flip}")
        result = self._let(f"select i1 {is_chosen}, {word} {changed}, {word} {value}")
        # the values before and after; a select is cheaper here than a branch
        report = self._let(f"select i1 {is_chosen}, ptr {self.reported_values}, ptr @mavfi_unseen")
        self.lines.append(f"  store {whole_bytes} {self._resized(value, word, whole_bytes)}, ptr {report}, align 1")
        second = self._let(f"getelementptr i8, ptr {report}, i64 {MASK_BYTES}")
        self.lines.append(f"  store {whole_bytes} {self._resized(result, word, whole_bytes)}, ptr {second}, align 1")
        return self._from_bits(result, site.kind, bits)

    def _resized(self, value: str, source: str, target: str) -> str:
        """An integer of type `source` as one of type `target`."""
        if source == target:
            return value
        if int(source[1:]) < int(target[1:]):
            return self._let(f"zext {source} {value} to {target}")
        return self._let(f"trunc {source} {value} to {target}")

    def _to_bits(self, value: str, kind: str, bits: int) -> str:
        """The value as one integer."""
        word = f"i{bits}"
        if parts(kind):
            total = "0"
            shift = 0
            for i, part in enumerate(parts(kind)):
                field = self._to_bits(self._let(f"extractvalue {kind} {value}, {i}"), part, width(part))
                wide = self._resized(field, f"i{width(part)}", word)
                shifted = self._let(f"shl {word} {wide}, {shift}")
                total = self._let(f"or {word} {total}, {shifted}")
                shift += width(part)
            return total
        if kind == "ptr":
            return self._let(f"ptrtoint ptr {value} to i64")
        if "ptr" in kind:
            numbers = kind.replace("ptr", "i64")
            addresses = self._let(f"ptrtoint {kind} {value} to {numbers}")
            return self._let(f"bitcast {numbers} {addresses} to {word}")
        if kind == word:
            return value
        return self._let(f"bitcast {kind} {value} to {word}")

    def _from_bits(self, value: str, kind: str, bits: int) -> str:
        """Inverse of `_to_bits`."""
        word = f"i{bits}"
        if parts(kind):
            aggregate = "poison"
            shift = 0
            for i, part in enumerate(parts(kind)):
                field = self._resized(self._let(f"lshr {word} {value}, {shift}"), word, f"i{width(part)}")
                field = self._from_bits(field, part, width(part))
                aggregate = self._let(f"insertvalue {kind} {aggregate}, {part} {field}, {i}")
                shift += width(part)
            return aggregate
        if kind == "ptr":
            return self._let(f"inttoptr i64 {value} to ptr")
        if "ptr" in kind:
            numbers = kind.replace("ptr", "i64")
            addresses = self._let(f"bitcast {word} {value} to {numbers}")
            return self._let(f"inttoptr {numbers} {addresses} to {kind}")
        if kind == word:
            return value
        return self._let(f"bitcast {word} {value} to {kind}")


def _used_elsewhere(function: Function) -> set[str]:
    """Values that are used in another block, in a phi, or by a terminator."""
    home = {site.result: block.label for block in function.blocks for site in block.sites}
    shared: set[str] = set()
    for block in function.blocks:
        for instruction in block.all():
            if instruction.opcode == "phi" or instruction is block.terminator:
                shared.update(instruction.uses())  # they are outside the paths of the block
            else:
                shared.update(name for name in instruction.uses() if home.get(name) != block.label)
    return shared


# ---- Counts the block executions of a kernel at almost the speed of the plain kernel, for golden flights.
# Each block with sites gets a counter, unless its count follows from others (`Block.runs_as`).  It lives in a register
# while a loop runs: it is a local variable of its function, and the module is optimised after the rewriting.  At each
# return, the counters are added to the histogram.
# Results are those of the plain kernel, since no optimisation changes a floating-point operation without fast-math
# flags.  The instrumented variant counts the same blocks on its slow path, without optimisation: the oracle of tests.

HISTOGRAM = "mavfi_histogram"
"""Global of the machine code: address of the histogram, int64 of shape (blocks,)."""


def tally_text(module: Module) -> str:
    """IR of a module that counts the executions of its blocks with sites, which are numbered in text order."""
    lines = [*module.preamble, f"@{HISTOGRAM} = global ptr null"]
    first_block = 0
    for function in module.functions:
        lines.append(_counting(function, first_block))
        first_block += len(_blocks_with_sites(function))
    return "\n".join([*lines, *module.others, ""])


def optimised(module: llvm.ModuleRef, machine: llvm.TargetMachine) -> llvm.ModuleRef:
    """The module after LLVM's standard passes, which keep counters in registers."""
    options = llvm.create_pipeline_tuning_options(speed_level=2)
    options.loop_vectorization = False  # the kernel is vectorised already
    options.slp_vectorization = False
    passes = llvm.create_pass_builder(machine, options)
    passes.getModulePassManager().run(module, passes)
    return module


def _blocks_with_sites(function: Function) -> list[BasicBlock]:
    """The blocks that are numbered."""
    return [block for block in function.blocks if block.sites]


def _counting(function: Function, first_block: int) -> str:
    """Definition of a function whose blocks are numbered from `first_block`."""
    # The counters that are needed, by label, and those that make up the count of each block.
    terms = [block.runs_as or (block.label,) for block in _blocks_with_sites(function)]
    counted_labels = {label for labels in terms for label in labels}
    counters = {block.label: index for index, block in enumerate(function.blocks) if block.label in counted_labels}
    sums = {first_block + i: [counters[label] for label in labels] for i, labels in enumerate(terms)}
    # The function: counters start at 0 in its first block, and are added to the histogram where it returns.
    lines = [function.head()]
    for index, block in enumerate(function.blocks):
        lines += [f"{block.label[1:]}:", *(instruction.line() for instruction in block.phis + block.allocations)]
        if index == 0:
            for counter in counters.values():
                lines += _start(counter)
        if block.label in counters:
            lines += _add(f"%n{index}", "1", f"%c{index}")
        lines += [instruction.line() for instruction in block.body]
        if block.terminator is not None:
            if block.terminator.opcode == "ret" and not block.unreached:
                lines += _flush(sums, block.label)
            lines.append(block.terminator.line())
    return "\n".join([*lines, "}"])


def _start(number: int) -> list[str]:
    """Allocate a counter, and set it to 0."""
    return [f"  %n{number} = alloca i64", f"  store i64 0, ptr %n{number}"]


def _add(pointer: str, increment: str, name: str) -> list[str]:
    """Add to a number in memory; `name` starts the names of intermediate values."""
    return [
        f"  {name}.before = load i64, ptr {pointer}",
        f"  {name}.after = add i64 {name}.before, {increment}",
        f"  store i64 {name}.after, ptr {pointer}",
    ]


def _flush(sums: Mapping[int, list[int]], label: str) -> list[str]:
    """Add to the histogram, for each block, its counter, or the first less the others of several."""
    lines = [f"  {label}.histogram = load ptr, ptr @{HISTOGRAM}"]
    for number, counters in sums.items():
        name = f"{label}.h{number}"
        lines.append(f"  {name}.less0 = load i64, ptr %n{counters[0]}")
        for i, counter in enumerate(counters[1:]):
            lines.append(f"  {name}.other{i} = load i64, ptr %n{counter}")
            lines.append(f"  {name}.less{i + 1} = sub i64 {name}.less{i}, {name}.other{i}")
        lines += [
            f"  {name} = getelementptr i64, ptr {label}.histogram, i64 {number}",
            *_add(name, f"{name}.less{len(counters) - 1}", f"{name}.sum"),
        ]
    return lines
