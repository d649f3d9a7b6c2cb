"""What cannot be instrumented exactly is refused with its name, never passed over."""

from dataclasses import replace

import numba
import numpy as np
import pytest

from mavfi.errors import BadInputError
from mavfi.faults.levels.instruction import MismatchError, NotInstrumentableError, count, draw, inject, run_forked
from mavfi.faults.levels.instruction.instrument import instrument
from mavfi.ir.parser import parse_module
from mavfi.numerics.jit import kernel_jit
from tests.core.unit.faults.instruction.kernels import LOOP, fill, loop


def scaled(x):
    return x * 2.0 + 1.0


@pytest.mark.parametrize("flags", [{"fastmath": True}, {"fastmath": {"nnan"}}, {"parallel": True}])
def test_flags_under_which_faults_cannot_be_replayed_are_refused(flags):
    with pytest.raises(NotInstrumentableError, match=f"scaled: cannot be instrumented: {next(iter(flags))}"):
        count(numba.njit(**flags)(scaled), 1.0)


def test_object_mode_is_refused():
    with pytest.raises(NotInstrumentableError, match="forceobj"):
        count(numba.jit(forceobj=True)(scaled), 1.0)


@kernel_jit
def leaving(x):
    with numba.objmode(y="float64"):
        y = float(str(x))
    return y + 1.0


@pytest.mark.filterwarnings("ignore:Code running in object mode")
def test_leaving_compiled_code_is_refused():
    with pytest.raises(NotInstrumentableError, match="leaving: cannot be instrumented: object mode"):
        count(leaving, 1.0)


quick = numba.njit(fastmath=True)(scaled)


@kernel_jit
def calling(x):
    return quick(x) + 1.0


@pytest.mark.slow
def test_fast_math_in_a_callee_is_refused():
    with pytest.raises(NotInstrumentableError, match=r"calling: cannot be instrumented: fast math \('fast'"):
        count(calling, 1.0)


@kernel_jit
def applied(function, x):
    return function(x)


def test_a_call_through_a_pointer_is_refused():
    plus = numba.cfunc("float64(float64)")(scaled)
    with pytest.raises(NotInstrumentableError, match="indirect call"):
        count(applied, plus, 1.0)


def test_a_python_function_is_refused():
    with pytest.raises(NotInstrumentableError, match="not a function compiled by kernel_jit"):
        count(scaled, 1.0)


MODULE = """
define i64 @kernel(i64 %a, ptr %p) {{
entry:
  {line}
  ret i64 %a
}}
"""
UNKNOWN = {
    "%b = freeze token %a": "'token'",
    "store volatile i64 %a, ptr %p, align 8": "'volatile'",
    '%b = call i64 asm "", "=m,0"(i64 %a)': "'\"=m,0\"'",
    "%b = load atomic i64, ptr %p seq_cst, align 8": "'atomic'",
    "store i64 %a, ptr addrspace(1) %p": "'addrspace'",
    "%b = atomicrmw add ptr %p, i64 1 monotonic, align 8": "'atomicrmw'",
    "fence release": "'fence'",
    '%b = call i64 asm "nop", "=r,r"(i64 %a)': "assembly",
    "%b = call i64 %p(i64 %a)": "indirect call",
    "%b = musttail call i64 @kernel(i64 %a, ptr %p)": "'musttail'",
    "%b = call i64 @llvm.coro.size.i64()": "intrinsic @llvm.coro.size.i64",
    "call void @numba_parallel_for(i64 %a)": "parallel execution",
    "call void @numba_gil_ensure(ptr %p)": "object mode",
    "%b = add x86_fp80 %a, %a": "'x86_fp80'",
    "%b = add <vscale x 2 x i64> %a, %a": "'vscale'",
    "%b = icmp samesign strange i64 %a, 1": "'strange'",
    "%b = fadd nnan double %a, %a": "fast math",
    "%b = alloca i64, i64 %a, align 8": "'i64'",
    "%b = invoke i64 @kernel() to label %x unwind label %y": "'invoke'",
    "%b = add i64 %c, 1": "'%c' is used but not defined",
    "%b = add i64 %a, `": "text '`'",
}


@pytest.mark.parametrize("line", UNKNOWN)
def test_unknown_constructs_are_refused_by_name(line):
    with pytest.raises(NotInstrumentableError, match="my kernel: cannot be instrumented: ") as caught:
        instrument(MODULE.format(line=line), "my kernel")
    assert UNKNOWN[line] in caught.value.construct


@pytest.mark.parametrize(
    "text",
    [
        'module asm "nop"',
        "define i64 @k(ptr sret(i64) %a) {\n}",
        "define i64 @k() #0 {\n}\nattributes #0 = { naked }",
    ],
)
def test_unknown_lines_around_functions_are_refused(text):
    with pytest.raises(NotInstrumentableError):
        parse_module(text, "my kernel")


def test_ir_that_is_not_there_is_refused():
    with pytest.raises(NotInstrumentableError, match="loaded from a cache"):
        instrument("; nothing", "my kernel")


# ---- faults that belong elsewhere -----------------------------------------------------------------------------------
@pytest.fixture(scope="module")
def fault():
    return draw(loop, 1, *LOOP, which="floating_point", seed=3)[0]


@pytest.mark.parametrize("call", [inject, run_forked])
def test_a_fault_for_other_machine_code_is_refused(call, fault):
    with pytest.raises(MismatchError, match="drawn for IR 000"):
        call(loop, replace(fault, ir_sha256="000"), *LOOP)
    with pytest.raises(MismatchError, match=r"kernels\.loop: given to .*kernels\.fill"):
        call(fill, fault, np.zeros(3), 1.0)


@pytest.mark.parametrize("which", ["", "everything", "opcode:", "line:kernels.py", "line:kernels.py:a-b"])
def test_classes_that_are_none_are_refused(which):
    with pytest.raises(BadInputError, match="allowed: all, floating_point"):
        draw(loop, 1, *LOOP, which=which)


@pytest.mark.slow
def test_a_class_that_is_not_executed_is_refused():
    with pytest.raises(BadInputError, match="0 found in"):
        draw(loop, 1, *LOOP, which="opcode:frem")


def test_a_model_that_is_none_is_refused():
    with pytest.raises(BadInputError, match="allowed: one_bit, bits, random, zero"):
        draw(loop, 1, *LOOP, model="two_bits")
