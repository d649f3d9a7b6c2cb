"""Every fault does exactly what was planned: as by hand, as an interpreter has it; wrong injectors are caught."""

import functools
import math
import re
from dataclasses import replace

import numba
import numpy as np
import pytest

from mavfi.faults.levels.instruction.build import assemble
from mavfi.faults.levels.instruction.instrument import instrument
from mavfi.faults.levels.instruction.runtime import ControlWord
from mavfi.faults.levels.instruction.variant import Variant
from mavfi.ir.build import source_of
from mavfi.ir.forked import run_in_child
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
    found = []
    assert oracle.run(LOOP, trace=found) == loop(*LOOP)
    return found


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


def test_lines_and_classes_of_a_straight_kernel():
    sites = {site.opcode: site for site in variant_for(straight, STRAIGHT).table.blocks[0]}
    first = straight.py_func.__code__.co_firstlineno + 1
    assert {name: site.line - first for name, site in sites.items()} == {
        "fmul": 1,
        "fadd": 2,
        "add": 3,
        "mul": 4,
        "call": 5,
        "sitofp": 5,
        "fdiv": 5,
    }
    assert {site.value_class for site in sites.values()} == {"floating_point", "integer"}
    assert sites["add"].file.endswith("tests/core/unit/faults/instruction/kernels.py")


def test_variables_and_classes_of_a_loop():
    sites = [site for block in variant_for(loop, LOOP).table.blocks for site in block]
    assert {"s", "k"} <= {site.variable for site in sites} <= {"s", "k", "i", None}
    assert {site.value_class for site in sites if site.opcode in ("fcmp", "icmp")} == {"control"}
    assert {site.value_class for site in sites} == {"control", "floating_point", "integer"}
    assert all(site.line > 0 for site in sites)


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


def test_values_before_and_after_are_those_that_were_there(oracle, trace):
    variant = variant_for(loop, LOOP)
    for index in range(0, len(trace), 7):
        if oracle.run(LOOP, (index, 0), budget(trace)) == HANG:
            continue
        injected(variant, LOOP, index, 0, budget(trace))
        report = variant.report()
        assert (report.site.opcode, report.site.kind) == trace[index]
        assert report.before ^ report.after == 1
    last = [index for index, (op, _) in enumerate(trace) if op == "fadd"][-1]
    injected(variant, LOOP, last, 0)
    assert math.isclose(np.array(variant.report().before, np.uint64).view(float), loop(*LOOP))


@pytest.mark.parametrize(("keep", "flip", "after"), [(0, 0, 0), (0, 0x1234, 0x1234), (KEEP_ALL, 0b1010, None)])
def test_other_fault_models_change_the_value_as_planned(trace, keep, flip, after):
    variant = variant_for(loop, LOOP)
    index = next(index for index, (op, _) in enumerate(trace) if op == "uitofp")
    variant.inject(index, keep, flip, 10**9, *LOOP)
    report = variant.report()
    assert report.after == (report.before ^ flip if after is None else after)


# ---- wrong injectors ------------------------------------------------------------------------------------------------
def next_bit(text):
    return re.sub(
        r"^  (%t\d+) = xor (i\d\d) (%t\d+), (%t\d+)$",
        r"  \1.m = shl \2 \4, 1\n  \1 = xor \2 \3, \1.m",
        text,
        flags=re.MULTILINE,
    )


def next_index(text):
    return re.sub(
        r"^(  %t\d+ = icmp eq i64 %t\d+, )(\d+)$", lambda m: f"{m[1]}{int(m[2]) + 1}", text, flags=re.MULTILINE
    )


def never(text):
    return re.sub(r"^(  %t\d+ = select i1) %t\d+(, i\d+)", r"\1 false\2", text, flags=re.MULTILINE)


def injected_again(text, still):
    """An injector that stays armed after its injection, as long as `still` (IR that sets %still) says so."""
    leave = "br i1 %over, label %exhausted, label %located\n"
    assert text.count(leave) == 1
    more = f"armed:\n{still}\n  br i1 %still, label %again, label %located\nagain:\n  ret i64 0\n"
    return text.replace(leave, f"br i1 %over, label %exhausted, label %armed\n{more}")


def word(control):
    return f"ptr getelementptr (i8, ptr @mavfi_control, i64 {8 * control})"


def sticky(text):
    return injected_again(text, "  %still = icmp ne i64 %done, 0")


def twice(text):
    first = "  %still = icmp eq i64 %done, 1\n"
    return injected_again(text, f"{first}  store volatile i64 2, {word(ControlWord.INJECTED)}")


MUTANTS = {"bit + 1": next_bit, "index + 1": next_index, "never": never, "sticky": sticky, "twice": twice}


@pytest.fixture(scope="module")
def sample(oracle, trace):
    """Faults that do not hang, and what comes of them."""
    faults = all_faults(trace)
    found = []
    for i in np.random.default_rng(2).permutation(len(faults)):
        wanted = oracle.run(LOOP, faults[i], budget(trace))
        if wanted != HANG:
            found.append((*faults[i], wanted))
        if len(found) == 150:
            return found


@pytest.fixture(scope="module")
def prepared():
    return instrumented(loop, LOOP)


def mismatches(prepared, change, sample, limit):
    made, source = prepared
    changed = replace(made, text=change(made.text))
    assert change is same_text or changed.text != made.text
    loop(*LOOP)
    variant = Variant(assemble(changed, source), loop.overloads[signature(LOOP)].environment)
    wrong = sum(not same(injected(variant, LOOP, index, bit, limit), wanted) for index, bit, wanted in sample)
    return bytes([min(wrong, 255)])


def same_text(text):
    return text


def test_the_injector_itself_has_no_mismatch(prepared, sample, trace):
    ended = run_in_child(lambda: mismatches(prepared, same_text, sample, budget(trace)))
    assert (ended.how, ended.payload) == ("done", b"\0")


@pytest.mark.slow
@pytest.mark.parametrize("mutant", MUTANTS)
def test_wrong_injectors_are_caught(mutant, prepared, sample, trace):
    ended = run_in_child(lambda: mismatches(prepared, MUTANTS[mutant], sample, budget(trace)))
    assert ended.how in ("done", "hang"), ended.detail
    assert ended.how == "hang" or ended.payload[0] > 10
