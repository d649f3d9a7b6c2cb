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

from mavfi.faults.levels.instruction.accesses import (
    Access,
    Constant,
    accesses_of,
    constants_of,
    is_owned,
    moved,
    planned_wrapper,
    size_of,
    visible,
)
from mavfi.faults.levels.instruction.arena import LINE
from mavfi.faults.levels.instruction.runtime import (
    MASK_BYTES,
    MEMORY,
    REPORT_WORDS,
    RUNTIME,
    ControlWord,
    address,
    declarations,
)
from mavfi.faults.levels.instruction.table import SiteTable, make_table
from mavfi.ir.build import Rewrite
from mavfi.ir.module import (
    Block,
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
_UNLIKELY = '!0 = !{!"branch_weights", i32 1, i32 100000}'


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
    digest = digest_of(module)
    owned = is_owned(module)
    constants = constants_of(module)
    tally = tallied(module)  # before functions are redirected to the arena
    names = [function.name for function in module.functions]
    others = [planned_wrapper(text, names) for text in module.others]
    lines = [*(visible(line, constants) for line in module.preamble), RUNTIME, MEMORY]
    first = 0
    for function in module.functions:
        _move(function, constants)
        lines.append(_Rewriter(function, first).text())
        first += sum(bool(block.sites) for block in function.blocks)
    lines += [*others, declarations("\n".join([*module.preamble, *others])), _UNLIKELY, ""]
    return Instrumented("\n".join(lines), tally, table, digest, tuple(constants.values()), owned)


def _move(function: Function, constants: dict[str, Constant]) -> None:
    """Redirect a function to the arena's constants and runtime."""
    for block in function.blocks:
        for instruction in block.all():
            instruction.tokens = [moved(token, constants) for token in instruction.tokens]
            instruction.incoming = [(moved(value, constants), label) for value, label in instruction.incoming]
            instruction.arguments = [(kind, moved(value, constants)) for kind, value in instruction.arguments]


class _Rewriter:
    """Rewrites one function."""

    def __init__(self, function: Function, first_block: int) -> None:
        self.function = function
        self.first_block = first_block
        self.lines: list[str] = [function.head()]
        self.temporaries = 0
        self.seen = self.frame = ""
        self.joined = {block.label: f"{block.label}.join" for block in function.blocks if block.sites}
        self.shared = _used_elsewhere(function)

    def text(self) -> str:
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

    def _allocate(self, block: Block) -> None:
        """Allocate the function's stack frame in the arena."""
        if not block.allocations:
            return
        self.frame = self._let(f"load i64, ptr {address(ControlWord.FRAME)}")
        size = 0
        for memory in block.allocations:
            self.lines.append(f"  {memory.result} = inttoptr i64 {self._let(f'add i64 {self.frame}, {size}')} to ptr")
            size += -(-size_of(memory.tokens[1]) // LINE) * LINE
        end = self._let(f"add i64 {self.frame}, {size}")
        self.lines.append(f"  store i64 {end}, ptr {address(ControlWord.FRAME)}")
        self.lines.append(f"  call void @mavfi_overflow(i64 {end})")

    def _leave(self, block: Block) -> None:
        """The terminator; a return releases the stack frame."""
        if block.terminator is not None:
            if block.terminator.opcode == "ret" and self.frame:
                self.lines.append(f"  store i64 {self.frame}, ptr {address(ControlWord.FRAME)}")
            self.lines.append(f"  {block.terminator.text()}")

    def _checked(self, body: list[Instruction], names: dict[str, str], write: Callable[[Instruction], None]) -> None:
        """Write instructions, each preceded by checks of its memory accesses."""
        for instruction in body:
            for access in accesses_of(instruction):
                self._check(access, names)
            write(instruction)

    def _check(self, access: Access, names: dict[str, str]) -> None:
        pointer, size = (names.get(value, value) for value in (access.pointer, access.size))
        if not access.lanes:
            self.lines.append(f"  call void @mavfi_check(ptr {pointer}, i64 {size})")
            return
        mask = names.get(access.mask, access.mask)
        for lane in range(access.lanes):
            wanted = self._let(f"extractelement <{access.lanes} x i1> {mask}, i64 {lane}")
            at = self._let(f"extractelement <{access.lanes} x ptr> {pointer}, i64 {lane}")
            used = self._let(f"select i1 {wanted}, i64 {size}, i64 0")
            self.lines.append(f"  call void @mavfi_check(ptr {at}, i64 {used})")

    def _let(self, text: str) -> str:
        """A new name for the result of an instruction."""
        self.temporaries += 1
        name = f"%t{self.temporaries}"
        self.lines.append(f"  {name} = {text}")
        return name

    def _split(self, block: Block, number: int) -> None:
        label = block.label
        self.lines.append(f"{label[1:]}:")
        raw = {str(phi.result): f"{phi.result}.p" for phi in block.phis}
        self.lines += [phi.line(labels=self.joined, suffix=".p") for phi in block.phis]
        self._allocate(block)
        before = self._let("load i64, ptr @mavfi_control")
        after = self._let(f"add i64 {before}, {len(block.sites)}")
        self.lines.append(f"  store i64 {after}, ptr @mavfi_control")
        beyond = self._let(f"icmp ugt i64 {after}, {self._let(f'load i64, ptr {address(ControlWord.THRESHOLD)}')}")
        self.lines.append(f"  br i1 {beyond}, label {label}.slow, label {label}.fast, !prof !0")
        fast = self._fast(block, dict(raw))
        slow = self._slow(block, dict(raw), after, number)
        self.lines.append(f"{label[1:]}.join:")
        for site in block.sites:
            name = str(site.result)
            if name in self.shared:
                pairs = f"[ {fast[name]}, {label}.fast ], [ {slow[name]}, {label}.slow ]"
                self.lines.append(f"  {name} = phi {site.kind} {pairs}")
        self._leave(block)

    def _fast(self, block: Block, names: dict[str, str]) -> dict[str, str]:
        self.lines.append(f"{block.label[1:]}.fast:")
        for instruction in block.body:
            self.lines.append(instruction.line(names, suffix=".f"))
            if instruction.result is not None:
                names[instruction.result] = f"{instruction.result}.f"
        self.lines.append(f"  br label {block.label}.join")
        return names

    def _slow(self, block: Block, names: dict[str, str], after: str, number: int) -> dict[str, str]:
        self.lines.append(f"{block.label[1:]}.slow:")
        injected = self._let(f"call i64 @mavfi_slow(i64 {after}, i64 {len(block.sites)}, i64 {number})")
        self.seen = self._let(
            f"getelementptr i64, ptr {self._let(f'load ptr, ptr {address(ControlWord.REPORT)}')}, i64 {REPORT_WORDS}"
        )
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

    def _injected(self, site: Instruction, raw: str, chosen: str, offset: int) -> str:
        """Write code that changes a value if chosen, and reports it before and after; returns its new name."""
        bits = width(site.kind)
        word = f"i{bits}"
        room = f"i{-(-bits // 8) * 8}"
        here = self._let(f"icmp eq i64 {chosen}, {offset}")
        value = self._to_bits(raw, site.kind, bits)
        keep, flip = (self._resized(self._let(f"load {room}, ptr @mavfi_{m}"), room, word) for m in ("keep", "flip"))
        changed = self._let(f"xor {word} {self._let(f'and {word} {value}, {keep}')}, {flip}")
        result = self._let(f"select i1 {here}, {word} {changed}, {word} {value}")
        seen = self._let(f"select i1 {here}, ptr {self.seen}, ptr @mavfi_unseen")
        self.lines.append(f"  store {room} {self._resized(value, word, room)}, ptr {seen}, align 1")
        later = self._let(f"getelementptr i8, ptr {seen}, i64 {MASK_BYTES}")
        self.lines.append(f"  store {room} {self._resized(result, word, room)}, ptr {later}, align 1")
        return self._from_bits(result, site.kind, bits)

    def _resized(self, value: str, source: str, target: str) -> str:
        if source == target:
            return value
        return self._let(f"{'zext' if int(source[1:]) < int(target[1:]) else 'trunc'} {source} {value} to {target}")

    def _to_bits(self, value: str, kind: str, bits: int) -> str:
        """The value as one integer."""
        word = f"i{bits}"
        if parts(kind):
            total = "0"
            at = 0
            for i, part in enumerate(parts(kind)):
                field = self._to_bits(self._let(f"extractvalue {kind} {value}, {i}"), part, width(part))
                wide = self._resized(field, f"i{width(part)}", word)
                total = self._let(f"or {word} {total}, {self._let(f'shl {word} {wide}, {at}')}")
                at += width(part)
            return total
        if kind == "ptr":
            return self._let(f"ptrtoint ptr {value} to i64")
        if "ptr" in kind:
            numbers = kind.replace("ptr", "i64")
            return self._let(f"bitcast {numbers} {self._let(f'ptrtoint {kind} {value} to {numbers}')} to {word}")
        if kind == word:
            return value
        return self._let(f"bitcast {kind} {value} to {word}")

    def _from_bits(self, value: str, kind: str, bits: int) -> str:
        """Inverse of `_to_bits`."""
        word = f"i{bits}"
        if parts(kind):
            whole = "poison"
            at = 0
            for i, part in enumerate(parts(kind)):
                field = self._resized(self._let(f"lshr {word} {value}, {at}"), word, f"i{width(part)}")
                field = self._from_bits(field, part, width(part))
                whole = self._let(f"insertvalue {kind} {whole}, {part} {field}, {i}")
                at += width(part)
            return whole
        if kind == "ptr":
            return self._let(f"inttoptr i64 {value} to ptr")
        if "ptr" in kind:
            numbers = kind.replace("ptr", "i64")
            return self._let(f"inttoptr {numbers} {self._let(f'bitcast {word} {value} to {numbers}')} to {kind}")
        if kind == word:
            return value
        return self._let(f"bitcast {word} {value} to {kind}")


def _used_elsewhere(function: Function) -> set[str]:
    """Values that are used in another block, in a phi, or by a terminator."""
    home = {site.result: block.label for block in function.blocks for site in block.sites}
    found: set[str] = set()
    for block in function.blocks:
        for instruction in block.all():
            anywhere = instruction.opcode == "phi" or instruction is block.terminator
            found.update(name for name in instruction.uses() if anywhere or home.get(name) != block.label)
    return found


# ---- Counts the block executions of a kernel at almost the speed of the plain kernel, for golden flights.
# Each block with sites gets a counter, unless its count follows from others (`Block.runs_as`).  It lives in a register
# while a loop runs: it is a local variable of its function, and the module is optimised after the rewriting.  At each
# return, the counters are added to the histogram.
# Results are those of the plain kernel, since no optimisation changes a floating-point operation without fast-math
# flags.  The instrumented variant counts the same blocks on its slow path, without optimisation: the oracle of tests.

HISTOGRAM = "mavfi_histogram"
"""Global of the machine code: address of the histogram, int64 of shape (blocks,)."""


def tallied(module: Module) -> str:
    """IR of a module that counts the executions of its blocks with sites, which are numbered in text order."""
    lines = [*module.preamble, f"@{HISTOGRAM} = global ptr null"]
    first = 0
    for function in module.functions:
        lines.append(_counting(function, first))
        first += len(_counted(function))
    return "\n".join([*lines, *module.others, ""])


def optimised(module: llvm.ModuleRef, machine: llvm.TargetMachine) -> llvm.ModuleRef:
    """The module after LLVM's standard passes, which keep counters in registers."""
    options = llvm.create_pipeline_tuning_options(speed_level=2)
    options.loop_vectorization = options.slp_vectorization = False  # the kernel is vectorised already
    passes = llvm.create_pass_builder(machine, options)
    passes.getModulePassManager().run(module, passes)
    return module


def _counted(function: Function) -> list[Block]:
    return [block for block in function.blocks if block.sites]


def _counting(function: Function, first: int) -> str:
    """Definition of a function whose blocks are numbered from `first`."""
    counted = _counted(function)
    needed = {label for block in counted for label in block.runs_as or (block.label,)}
    counters = {block.label: place for place, block in enumerate(function.blocks) if block.label in needed}
    sums = {
        first + i: [counters[label] for label in block.runs_as or (block.label,)] for i, block in enumerate(counted)
    }
    lines = [function.head()]
    for place, block in enumerate(function.blocks):
        lines += [f"{block.label[1:]}:", *(instruction.line() for instruction in block.phis + block.allocations)]
        if place == 0:
            lines += [line for counter in counters.values() for line in _start(counter)]
        if block.label in counters:
            lines += _add(f"%n{place}", "1", f"%c{place}")
        lines += [instruction.line() for instruction in block.body]
        if block.terminator is not None:
            if block.terminator.opcode == "ret" and not block.unreached:
                lines += _flush(sums, block.label)
            lines.append(block.terminator.line())
    return "\n".join([*lines, "}"])


def _start(number: int) -> list[str]:
    return [f"  %n{number} = alloca i64", f"  store i64 0, ptr %n{number}"]


def _add(place: str, increment: str, name: str) -> list[str]:
    """Add to a counter; `name` starts the names of intermediate values."""
    return [
        f"  {name}.before = load i64, ptr {place}",
        f"  {name}.after = add i64 {name}.before, {increment}",
        f"  store i64 {name}.after, ptr {place}",
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
