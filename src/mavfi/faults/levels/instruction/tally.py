"""Counts the block executions of a kernel at almost the speed of the plain kernel, for golden flights.

Each block with sites gets a counter, unless its count follows from others (`Block.runs_as`).  It lives in a register
while a loop runs: it is a local variable of its function, and the module is optimised after the rewriting.  At each
return, the counters are added to the histogram.
Results are those of the plain kernel, since no optimisation changes a floating-point operation without fast-math flags.
The instrumented variant counts the same blocks on its slow path, without optimisation: the oracle in the tests.
"""

from collections.abc import Mapping

import llvmlite.binding as llvm

from mavfi.ir.module import Block, Function, Module

HISTOGRAM = "mavfi_histogram"
"""Global of the machine code: address of the histogram, int64 of shape (blocks,)."""


def tallied(module: Module) -> str:
    """IR of a module that counts the executions of its blocks with sites, which are numbered in text order."""
    lines, first = [*module.preamble, f"@{HISTOGRAM} = global ptr null"], 0
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
