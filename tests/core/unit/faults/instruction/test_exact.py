"""Every fault does exactly what was planned: as by hand, and as an interpreter of LLVM IR has it."""

import functools

import numba
import numpy as np
import pytest

from mavfi.ir.build import source_of
from mavfi.ir.forked import run_in_child
from mavfi.ir.injection.build import assemble
from mavfi.ir.injection.instrument import instrument
from mavfi.ir.injection.variant import Variant
from mavfi.numerics.jit import uncached_copy
from tests.core.unit.faults.instruction.interpreter import HANG, Interpreter, flipped, same, signed
from tests.core.unit.faults.instruction.kernels import LOOP, STRAIGHT, loop, straight

KEEP_ALL = -1
WIDTH = {"double": 64, "i64": 64, "i1": 1, "i60": 60}


def signature(args):
    return tuple(numba.typeof(argument) for argument in args)


def interpreter(kernel, args):
    copy = uncached_copy(kernel)
    copy.compile(signature(args))
    return Interpreter(copy.inspect_llvm(signature(args)), kernel.py_func.__name__)


def instrumented(kernel, args):
    source = source_of(kernel, signature(args))
    return instrument(source.text, source.kernel), source


@functools.cache
def variant_for(kernel, args):
    """Of the IR that the interpreter has: this process compiles for its own CPU, `variant.variant_for` for any."""
    kernel(*args)
    return Variant(assemble(*instrumented(kernel, args)), kernel.overloads[signature(args)].environment)


@pytest.fixture(scope="module")
def oracle():
    return interpreter(loop, LOOP)


@pytest.fixture(scope="module")
def trace(oracle):
    executed = []
    assert oracle.run(LOOP, trace=executed) == loop(*LOOP)
    return executed


def budget(trace):
    return 20 * len(trace)


def injected(variant, args, index, bit, limit=10**9):
    return variant.inject(index, KEEP_ALL, 1 << bit, limit, *args)


# ---- a kernel without branches --------------------------------------------------------------------------------------
def by_hand(chosen, bit, a, b, c, i, j):
    """`straight`, with one bit of one intermediate value flipped."""

    def written(name, value, kind):
        return flipped(value, kind, bit) if name == chosen else value

    total = written("fadd", written("fmul", a * b, "double") + c, "double")
    with np.errstate(all="ignore"):
        root = written("call", float(np.sqrt(total)), "double")
        scaled = written("mul", written("add", i + j, "i64") * 3 & (2**64 - 1), "i64")
        divisor = written("sitofp", float(signed(scaled, 64)), "double")
        return written("fdiv", float(np.divide(root, divisor)), "double")


def test_every_fault_in_a_straight_kernel_is_as_by_hand():
    variant = variant_for(straight, STRAIGHT)
    sites = variant.table.blocks[0]
    assert sorted(site.opcode for site in sites) == ["add", "call", "fadd", "fdiv", "fmul", "mul", "sitofp"]
    for index, site in enumerate(sites):
        for bit in range(site.width):
            wanted, got = by_hand(site.opcode, bit, *STRAIGHT), injected(variant, STRAIGHT, index, bit)
            assert same(wanted, got), (site, bit)


# ---- a loop with integers, floats and branches ----------------------------------------------------------------------
def test_the_trace_is_that_of_the_interpreter(trace):
    variant = variant_for(loop, LOOP)
    result, total = variant.count(*LOOP)
    _, histogram, blocks = variant.profile(*LOOP, room=10_000)
    _, sites = variant.resolve(range(total), *LOOP)
    assert result == loop(*LOOP)
    assert [(site.opcode, site.kind) for site in sites] == trace
    assert total == len(trace) == sum(histogram * variant.table.sizes())
    assert sites == [site for block in blocks for site in variant.table.blocks[block]]


def all_faults(trace):
    return [(index, bit) for index, (_, kind) in enumerate(trace) for bit in range(WIDTH[kind])]


def disagreements(variant, oracle, trace, faults):
    """Faults for which interpreter and machine code differ; those that hang run in children."""
    wrong = []
    for index, bit in faults:
        wanted = oracle.run(LOOP, (index, bit), budget(trace))
        if wanted == HANG:
            ended = run_in_child(
                lambda fault=(index, bit): str(injected(variant, LOOP, *fault, budget(trace))).encode()
            )
            agreed = ended.how == "hang" and ended.detail == "instruction budget"
        else:
            agreed = same(injected(variant, LOOP, index, bit, budget(trace)), wanted)
        if not agreed:
            wrong.append((index, bit))
    return wrong


@pytest.mark.slow
def test_faults_in_a_loop_are_as_interpreted(oracle, trace):
    faults = all_faults(trace)
    some = [faults[i] for i in np.random.default_rng(1).choice(len(faults), 250, replace=False)]
    assert disagreements(variant_for(loop, LOOP), oracle, trace, some) == []


@pytest.mark.slow
@pytest.mark.long
def test_every_fault_in_a_loop_is_as_interpreted(oracle, trace):
    faults = all_faults(trace)
    assert len(faults) > 10_000
    assert disagreements(variant_for(loop, LOOP), oracle, trace, faults) == []


def test_a_fault_beyond_the_end_is_not_hit(trace):
    variant = variant_for(loop, LOOP)
    assert injected(variant, LOOP, len(trace), 0) == loop(*LOOP)
    assert variant.report() is None
    injected(variant, LOOP, len(trace) - 1, 63)
    report = variant.report()
    assert (report.site.opcode, report.site.kind) == trace[-1]
    assert report.before ^ report.after == 1 << 63
