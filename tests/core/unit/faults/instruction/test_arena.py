"""The memory of an injected call: what it gets, what it may access, and what it leaves."""

from collections import namedtuple

import numpy as np
import pytest

from mavfi.ir.forked import WILD
from mavfi.ir.injection.accesses import accesses_of
from mavfi.ir.injection.arena import BASE, SIZE, arena
from mavfi.ir.injection.variant import variant_for
from mavfi.ir.parser import Cursor, parse_instruction, tokens_of
from mavfi.levels import instruction
from mavfi.levels.instruction.api import digest
from mavfi.numerics.jit import kernel_jit
from tests.core.unit.faults.instruction.kernels import solved

Pair = namedtuple("Pair", "first second")
TABLE = np.array([2.0, 3.0, 5.0, 7.0])


@kernel_jit
def shifted(values, at, scratch):
    """Reads and writes arrays, makes one, and looks into a constant table."""
    fresh = np.zeros(len(values))
    for i in range(len(values)):
        fresh[i] = values[i] * TABLE[i % 4]
    for i in range(len(values)):
        values[i] = fresh[i] - scratch.first[at]
    scratch.second[0] += fresh.sum()
    return fresh


def arguments():
    return np.arange(6.0), 1, Pair(np.full(3, 0.5), np.zeros((2, 2)))


# ---- arguments ------------------------------------------------------------------------------------------------------
def test_arguments_are_copied_with_their_shapes_flags_and_overlaps_and_come_back():
    whole = np.arange(24.0).reshape(4, 6)
    frozen = np.ones(3, np.int16)
    frozen.flags.writeable = False
    given_ = whole, Pair(whole[1:3, ::2], frozen), 7, None, np.zeros((0, 3)), whole.T
    placed = arena().place(given_)
    for here, there in zip(
        (whole, *given_[1], given_[4], given_[5]), (placed.args[0], *placed.args[1], *placed.args[4:]), strict=True
    ):
        assert there.dtype == here.dtype and there.strides == here.strides and (there == here).all()
        assert [there.flags[name] for name in ("C", "F", "W", "A")] == [
            here.flags[name] for name in ("C", "F", "W", "A")
        ]
        assert BASE <= there.ctypes.data < BASE + SIZE
    assert type(placed.args[1]) is Pair and placed.args[2:4] == (7, None)
    placed.args[5][0, 3] = -1.0
    assert placed.args[0][3, 0] == -1.0 and whole[3, 0] == 18.0
    placed.take_back()
    assert whole[3, 0] == -1.0


@pytest.mark.parametrize("value", [[1.0], "text", {"a": 1}, np.array([None]), np.zeros(SIZE)])
def test_other_arguments_are_not_placed(value):
    assert arena().place((1.0, (value,))) is None


# ---- accesses -------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("%v = load double, ptr %p, align 8", [("%p", "8")]),
        ("%v = load <4 x i32>, ptr %p, align 4", [("%p", "16")]),
        ("%v = load double, ptr @table, align 8", []),
        ("store i1 %v, ptr %p, align 1", [("%p", "1")]),
        ("store { i64, double, i8 } %v, ptr %p, align 8", [("%p", "24")]),
        ("call void @llvm.memset.p0.i64(ptr %p, i8 0, i64 %n, i1 false)", [("%p", "%n")]),
        ("call void @llvm.memcpy.p0.p0.i64(ptr %p, ptr %q, i64 48, i1 false)", [("%p", "48"), ("%q", "48")]),
        ("%v = call <8 x i16> @llvm.masked.load.v8i16.p0(ptr %p, <8 x i1> %m, <8 x i16> poison)", [("%p", "16")]),
        ("call void @llvm.masked.store.v4f64.p0(<4 x double> %v, ptr %p, <4 x i1> %m)", [("%p", "32")]),
        ("call void @llvm.masked.scatter.v8i32.v8p0(<8 x i32> %v, <8 x ptr> %p, <8 x i1> %m)", [("%p", "4", "%m", 8)]),
        ("%v = fadd double %a, %b", []),
    ],
)
def test_accesses_of_an_instruction(text, wanted):
    accesses = accesses_of(parse_instruction(Cursor(tokens_of(text, "kernel"), "kernel")))
    assert [(a.pointer, a.size, *((a.mask, a.lanes) if a.lanes else ())) for a in accesses] == wanted


# ---- calls ----------------------------------------------------------------------------------------------------------
def drawn(which, n=60):
    return instruction.draw(shifted, n, *arguments(), which=which, seed=1)


def test_a_call_in_the_arena_without_a_change_is_the_plain_call():
    plain, placed = arguments(), arguments()
    golden = shifted(*plain)
    variant = variant_for(shifted, placed)
    for index in (0, 10, 10**9):  # a flip of no bit, also beyond the last instruction
        again = variant.inject(index, -1, 0, 10**6, *placed)
        assert digest((again, placed)) == digest((golden, plain))
        assert variant.report() is None or variant.report().planned
        placed = arguments()
    assert not BASE <= again.ctypes.data < BASE + SIZE, "the result is no part of the next call's memory"


@pytest.mark.slow
@pytest.mark.long
def test_an_address_is_planned_and_wild_ones_crash():
    faults = drawn("opcode:getelementptr")
    calls = [instruction.run_forked(shifted, fault, *arguments()) for fault in faults]
    assert all(BASE <= call.injection.before < BASE + SIZE for call in calls)
    for fault, call in zip(faults, calls, strict=True):
        if fault.bit >= SIZE.bit_length():
            assert (call.how, call.detail) == ("crash", WILD) or call.how == "masked", "an address that is never used"
        else:
            assert call.how != "crash" or call.detail == WILD
        assert call.injection.details["replayable"]
    assert {call.how for call in calls} >= {"crash", "sdc", "masked"}


@pytest.mark.long
def test_a_kernel_whose_memory_belongs_to_a_library_is_not_replayable():
    matrix, right = np.eye(3) * 2.0, np.ones(3)
    fault = instruction.draw(solved, 1, matrix, right, which="address", seed=1)[0]
    assert not instruction.run_forked(solved, fault, matrix, right).injection.details["replayable"]
