"""The memory of an injected call: what it gets, what it may access, and what it leaves."""

from collections import namedtuple
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavfi.faults.levels import instruction
from mavfi.faults.levels.instruction.accesses import accesses_of, size_of
from mavfi.faults.levels.instruction.api import digest
from mavfi.faults.levels.instruction.arena import _ARGUMENTS, BASE, LINE, SIZE, _plan, arena
from mavfi.faults.levels.instruction.build import assemble
from mavfi.faults.levels.instruction.instrument import instrument
from mavfi.faults.levels.instruction.variant import Variant, signature_of, variant_for
from mavfi.ir.build import source_of
from mavfi.ir.forked import WILD, run_in_child
from mavfi.ir.parser import Cursor, parse_instruction, tokens_of
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


@given(st.lists(st.tuples(st.integers(0, 500), st.integers(0, 120)), max_size=8))
def test_ranges_are_apart_and_hold_every_array_where_they_overlap(pairs):
    bounds = [(low, low + size) for low, size in pairs]
    ranges, free = _plan(bounds)
    assert [there % LINE for _, there, _ in ranges] == [0] * len(ranges)
    ends = [_ARGUMENTS, *(there + size for _, there, size in ranges)]
    assert all(there >= end for (_, there, _), end in zip(ranges, ends[:-1], strict=True)) and free >= ends[-1]
    for low, high in bounds:
        holders = [here for here, _, size in ranges if here <= low and high <= here + size]
        assert len(holders) == 1 or low == high
    assert sum(size for *_, size in ranges) == len({at for low, high in bounds for at in range(low, high)})


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
    found = accesses_of(parse_instruction(Cursor(tokens_of(text, "kernel"), "kernel")))
    assert [(a.pointer, a.size, *((a.mask, a.lanes) if a.lanes else ())) for a in found] == wanted


@pytest.mark.parametrize(
    ("kind", "size"),
    [("i1", 1), ("i60", 8), ("ptr", 8), ("float", 4), ("[3 x double]", 24), ("{ i8, i64 }", 16), ("{ i32, i8 }", 8)],
)
def test_sizes_in_memory(kind, size):
    assert size_of(kind) == size


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


def test_without_the_checks_wild_accesses_leave_the_arena():
    """The mutant that the test above would catch."""
    args = arguments()
    faults = (replace(fault, bits=(40,)) for fault in drawn("opcode:getelementptr"))
    fault = next(fault for fault in faults if instruction.run_forked(shifted, fault, *args).detail == WILD)
    source = source_of(shifted, signature_of(args))
    made = instrument(source.text, source.kernel)
    shifted(*args)
    checked = "br i1 %wild, label %stop, label %fine"
    assert made.text.count(checked) == 1
    built = assemble(replace(made, text=made.text.replace(checked, "br label %fine")), source)
    variant = Variant(built, shifted.overloads[signature_of(args)].environment)
    ended = run_in_child(lambda: bytes(variant.inject(fault.index, *fault.masks, 10**6, *args).size))
    assert (ended.how, ended.detail) != ("crash", WILD)


def test_a_kernel_whose_memory_belongs_to_a_library_is_not_replayable():
    matrix, right = np.eye(3) * 2.0, np.ones(3)
    fault = instruction.draw(solved, 1, matrix, right, which="address", seed=1)[0]
    assert not instruction.run_forked(solved, fault, matrix, right).injection.details["replayable"]
