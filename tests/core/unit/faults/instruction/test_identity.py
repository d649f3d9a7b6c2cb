"""Without a fault an instrumented kernel is as the kernel, bit for bit; and kernels are as without line tables."""

import re

import llvmlite.binding as llvm
import numba
import numpy as np
import pytest

from mavfi.ir.injection.instrument import instrument
from mavfi.ir.injection.variant import variant_for
from mavfi.ir.module import width
from mavfi.kernels.control import pid
from mavfi.levels.instruction import resolve
from mavfi.levels.instruction.api import digest
from mavfi.numerics.jit import uncached_copy
from tests.core.unit.kernels.cases import CASES
from tests.night import at_night

COMPILED = {name: case for name, case in CASES.items() if hasattr(case.function, "py_func")}
QUICK = ("back_project", "time_to_collision", "track", "shortcut_greedy", "voxel_of", "steer")
LARGE = ("insert_scan",)
"""Large: loops within loops, callees of callees.  The planner is counted in a flight below."""


def marked(name):
    marks = () if name in QUICK else pytest.mark.slow if name in LARGE else (pytest.mark.slow, pytest.mark.long)
    return pytest.param(name, marks=marks)


NAMES = [marked(name) for name in COMPILED]


def signature(args):
    return tuple(numba.typeof(argument) for argument in args)


@pytest.mark.parametrize("name", NAMES)
def test_results_and_arguments_are_the_same_bits(name):
    case = COMPILED[name]
    plain, counted, tallied, traced, resolved = (case.arguments() for _ in range(5))
    result = case.function(*plain)
    variant = variant_for(case.function, tuple(counted))
    again, total = variant.count(*counted)
    assert digest((again, counted)) == digest((result, plain))
    again, times = variant.tally(*tallied)
    assert digest((again, tallied)) == digest((result, plain))
    _, oracle, blocks = variant.profile(*traced, room=total)
    assert times.tolist() == oracle.tolist()
    assert variant.written(times) == total
    trace = [site for block in blocks for site in variant.table.blocks[block]]
    some = [*np.random.default_rng(0).integers(total, size=300).tolist(), 0, total - 1]
    assert len(trace) == total
    assert resolve(case.function, [*some, total], *resolved) == [*(trace[index] for index in some), None]
    assert len({digest(args) for args in (plain, counted, tallied, traced, resolved)}) == 1


@pytest.mark.slow
@pytest.mark.parametrize("name", ["track", *at_night(*QUICK[:2], "shortcut_greedy", "insert_scan", "rrt_connect")])
def test_the_table_has_the_types_that_llvm_has(name):
    """LLVM's own reading of the text is the oracle of ours."""
    case = COMPILED[name]
    signature_ = signature(case.arguments())
    copy = uncached_copy(case.function)
    copy.compile(signature_)
    text = copy.inspect_llvm(signature_)
    made = instrument(text, name)
    our_sites = [(site.opcode, site.kind, site.width) for block in made.table.blocks for site in block]
    assert our_sites == [(op, kind, width(kind)) for op, kind in llvm_reads(text)]
    variant = variant_for(case.function, tuple(case.arguments()))
    if variant.ir_sha256 == made.ir_sha256:  # where callees were compiled here, they may be inlined otherwise
        assert our_sites == [(site.opcode, site.kind, site.width) for block in variant.table.blocks for site in block]


def llvm_reads(text):
    outside = re.compile(r"_ZN7cpython|cfunc\.|NRT_|numba_|\.dtor|__excinfo")
    dropped = re.compile(r"@llvm\.(lifetime|assume|experimental\.noalias)")
    for function in llvm.parse_assembly(text).functions:
        if function.is_declaration or outside.match(function.name):
            continue
        for block in function.blocks:
            for instruction in block.instructions:
                kind = str(instruction.type)
                if kind != "void" and instruction.opcode != "alloca" and not dropped.search(str(instruction)):
                    yield instruction.opcode, kind


def assembly(dispatcher, signature_):
    """Instructions and labels, without what only tells debuggers something."""
    dispatcher.compile(signature_)
    text = dispatcher.inspect_asm(signature_)
    body = text[text.index(".type\t_ZN5mavfi7kernels") : text.index("_ZN7cpython5mavfi7kernels")]
    lines = [line.split("#")[0].rstrip() for line in body.split("\n")]
    labels = {}
    code_lines = [line for line in lines if re.match(r"\t[a-z]", line)]
    return [re.sub(r"\.L\w+|_ZN\S+", lambda m: labels.setdefault(m[0], f"L{len(labels)}"), line) for line in code_lines]


@pytest.mark.slow
def test_machine_code_is_as_without_line_tables():
    flags = {name: value for name, value in pid.track.targetoptions.items() if name != "nopython"}
    plain = numba.njit(**flags)(pid.track.py_func)
    signature_ = signature(COMPILED["track"].arguments())
    with_tables = assembly(uncached_copy(pid.track), signature_)
    assert len(with_tables) > 100
    assert with_tables == assembly(plain, signature_)
