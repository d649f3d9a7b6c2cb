"""What cannot be instrumented exactly is refused with its name, never passed over."""

from dataclasses import replace

import numba
import numpy as np
import pytest

from mavfi.errors import BadInputError
from mavfi.ir.injection.instrument import instrument
from mavfi.ir.injection.variant import MismatchError
from mavfi.ir.module import NotInstrumentableError
from mavfi.ir.parser import parse_module
from mavfi.levels.instruction import count, draw, inject, run_forked
from mavfi.numerics.jit import kernel_jit
from tests.core.unit.faults.instruction.kernels import LOOP, fill, loop


def scaled(x):
    return x * 2.0 + 1.0


@kernel_jit
def leaving(x):
    with numba.objmode(y="float64"):
        y = float(str(x))
    return y + 1.0


quick = numba.njit(fastmath=True)(scaled)


@kernel_jit
def calling(x):
    return quick(x) + 1.0


@kernel_jit
def applied(function, x):
    return function(x)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:Code running in object mode")
@pytest.mark.parametrize(
    ("function", "arguments", "message"),
    [
        (numba.njit(fastmath={"nnan"})(scaled), (1.0,), "scaled: cannot be instrumented: fastmath"),
        (numba.njit(parallel=True)(scaled), (1.0,), "scaled: cannot be instrumented: parallel"),
        (numba.jit(forceobj=True)(scaled), (1.0,), "forceobj"),
        (leaving, (1.0,), "leaving: cannot be instrumented: object mode"),
        (calling, (1.0,), r"calling: cannot be instrumented: fast math \('fast'"),
        (applied, (numba.cfunc("float64(float64)")(scaled), 1.0), "indirect call"),
        (scaled, (1.0,), "not a function compiled by kernel_jit"),
    ],
)
def test_functions_whose_faults_could_not_be_replayed_are_refused(function, arguments, message):
    with pytest.raises(NotInstrumentableError, match=message):
        count(function, *arguments)


MODULE = """
define i64 @kernel(i64 %a, ptr %p) {{
entry:
  {line}
  ret i64 %a
}}
"""
UNKNOWN = {
    "%b = freeze token %a": "'token'",
    "%b = atomicrmw add ptr %p, i64 1 monotonic, align 8": "'atomicrmw'",
    '%b = call i64 asm "nop", "=r,r"(i64 %a)': "assembly",
    "call void @numba_parallel_for(i64 %a)": "parallel execution",
    "%b = fadd nnan double %a, %a": "fast math",
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


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"which": "everything"}, "allowed: all, floating_point"),
        ({"which": "opcode:frem"}, "0 found in"),
        ({"model": "two_bits"}, "allowed: one_bit, bits, random, zero"),
    ],
)
def test_what_cannot_be_drawn_is_refused(options, message):
    with pytest.raises(BadInputError, match=message):
        draw(loop, 1, *LOOP, **options)
