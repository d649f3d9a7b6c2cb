"""The reference at machine level: execution is the same each time, strikes are seen, outcomes distinguished."""

import os
from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.destinations import destinations, is_out_of_reach
from benchmarks.machine_level import DETECTED, entry_of, inject_all, protected
from benchmarks.single_step import MachineFault, SteppedCall
from mavfi.errors import BadInputError
from mavfi.extras.registers.registers import decode
from mavfi.levels.instruction.api import digest
from mavfi.numerics.jit import kernel_jit
from tests.core.unit.faults.instruction.kernels import LOOP, counted_down, fill, loop
from tests.extras.registers.tracing import require_tracing

SEED = 11


@pytest.fixture(scope="module", autouse=True)
def _traceable():
    require_tracing()


class BriefCall(SteppedCall):
    """Each step takes 0.1 ms: a call of hundreds of instructions hangs sooner than in the reference."""

    budget = 1_000


def stepped(kernel, *args, kind=BriefCall):
    return kind(lambda: digest((kernel(*args), args)), entry_of(kernel, args))


@kernel_jit
def copy_sum(values, total):
    """Reads through one pointer and writes through another."""
    for i in range(len(values)):
        total[0] += values[i]


VALUES, TOTAL = np.linspace(0.5, 4.0, 7), np.zeros(1)


@pytest.fixture(scope="module")
def call():
    return stepped(fill, np.linspace(0.0, 4.0, 6), 2.0)


def held(call, value):
    """A fault in the first register that holds a value after an instruction with this destination."""
    for step, registers in call.sites:
        for register in registers:
            seen = call.inject(MachineFault(step, register, register.bits[0]), null=True)
            if seen.before == value:
                return MachineFault(step, register, 0)
    raise AssertionError(f"no register ever holds {value:#x}")


# ---- what is executed -----------------------------------------------------------------------------------------------
def test_the_same_instructions_are_executed_each_time(call):
    again = stepped(fill, np.linspace(0.0, 4.0, 6), 2.0)
    assert (again.steps, again.own, len(again.sites)) == (call.steps, call.own, len(call.sites))
    assert [again.text(step) for step, _ in again.sites] == [call.text(step) for step, _ in call.sites]
    assert 20 < len(call.sites) <= call.own <= call.steps


def test_a_system_that_forbids_tracing_is_refused_in_one_line(monkeypatch):
    def forbidden(thread):
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr("benchmarks.single_step.Tracee", forbidden)
    with pytest.raises(BadInputError, match="single steps: may not trace a child") as refused:
        stepped(loop, *LOOP)
    assert "\n" not in str(refused.value)
    with suppress(ChildProcessError):  # there is no child
        assert os.waitpid(-1, os.WNOHANG) == (0, 0), "a zombie is left"


# ---- strikes --------------------------------------------------------------------------------------------------------
@pytest.mark.slow
def test_each_strike_flips_the_bit_that_was_drawn_and_no_other(call):
    outcomes = [call.inject(fault) for fault in call.draw(np.random.default_rng(SEED), 12)]
    assert all(outcome.activated and outcome.before ^ outcome.after == 1 << outcome.fault.bit for outcome in outcomes)
    assert len({outcome.how for outcome in outcomes}) > 1
    assert len({outcome.fault.register.name for outcome in outcomes}) > 3


@pytest.mark.slow
def test_an_injector_that_flips_nothing_masks_everything(call):
    outcomes = [call.inject(fault, null=True) for fault in call.draw(np.random.default_rng(SEED), 12)]
    assert {outcome.how for outcome in outcomes} == {"masked"}
    assert not any(outcome.activated for outcome in outcomes)


@pytest.mark.slow
def test_the_same_fault_does_the_same(call):
    faults = call.draw(np.random.default_rng(SEED), 6)
    once, again = ([call.inject(fault) for fault in faults] for _ in range(2))
    assert once == again
    assert faults == call.draw(np.random.default_rng(SEED), 6)


# ---- outcomes -------------------------------------------------------------------------------------------------------
@pytest.mark.slow
def test_a_wrong_number_is_silent():
    call = stepped(copy_sum, VALUES, TOTAL)
    partial_sum = int(np.array([VALUES[0] + VALUES[1]]).view(np.uint64)[0])
    fault = held(call, partial_sum)
    outcome = call.inject(replace(fault, bit=51))
    assert (outcome.how, outcome.before, outcome.after) == ("sdc", partial_sum, partial_sum ^ (1 << 51))


@pytest.mark.slow
def test_a_wrong_pointer_crashes():
    call = stepped(copy_sum, VALUES, TOTAL)
    outcome = call.inject(replace(held(call, VALUES.ctypes.data), bit=62))
    assert (outcome.how, outcome.detail) == ("crash", "SIGSEGV")
    assert outcome.before == VALUES.ctypes.data and outcome.activated


@pytest.mark.slow
def test_a_loop_that_does_not_end_is_a_hang():
    call = stepped(counted_down, 2.5, kind=SteppedCall)
    half = int(np.array([0.5]).view(np.uint64)[0])
    outcome = call.inject(replace(held(call, half), bit=62))  # 2^1023, from which 1 cannot be taken
    assert (outcome.how, outcome.detail, outcome.activated) == ("hang", "instruction budget", True)


@pytest.mark.slow
@pytest.mark.long
def test_protected_code_detects_what_was_silent():
    plain = inject_all(stepped(copy_sum, VALUES, TOTAL), np.random.default_rng(SEED), 40, lambda _: None)
    code, entry = protected(copy_sum, (VALUES, TOTAL))
    guarded = BriefCall(lambda: digest((code(VALUES, TOTAL), VALUES, TOTAL)), entry)
    found = inject_all(guarded, np.random.default_rng(SEED), 40, lambda _: None)
    assert plain["sdc"] > 4 and plain[DETECTED] == 0
    assert found["sdc"] < plain["sdc"] / 4 and found[DETECTED] > 4


# ---- destinations ---------------------------------------------------------------------------------------------------
def run_of(*codes):
    return [decode(bytes.fromhex(code), 0x1000) for code in codes]


def names(registers):
    return [
        (register.name, register.bits if register.name == "rflags" else len(register.bits)) for register in registers
    ]


CMP, JA, JE, ADD, MOV, CALL = "4839d8", "7702", "7402", "4801d8", "4889d8", "e800000000"


@pytest.mark.parametrize(
    ("codes", "first"),
    [
        ([ADD, JE], [("rax", 64)]),  # not the flags
        ([CMP, JA], [("rflags", (0, 6))]),
        ([CMP, MOV, JE, JA], [("rflags", (6,))]),  # those that the next one tests
        ([CMP, ADD, JE], []),  # overwritten unread
        ([CMP, CALL, JE], []),
        ([CMP], []),
        (["f20f58c1"], [("xmm0", 64)]),  # addsd xmm0, xmm1
        (["c5fb1100"], []),  # vmovsd qword ptr [rax], xmm0
        (["488903"], []),  # mov qword ptr [rbx], rax
        (["4883ec30"], [("rsp", 64)]),  # sub rsp, 0x30
        (["48f7f9"], [("rax", 64), ("rdx", 64)]),  # idiv rcx
    ],
)
def test_destinations(codes, first):
    assert names(destinations(run_of(*codes))[0]) == first


def test_registers_that_cannot_be_injected_are_counted_apart():
    masks, high, scalar, compare = run_of("62f1c708c2cf07", "62e1fd0828c0", "c5fb10c1", CMP)
    assert masks.text.startswith("vcmp") and "xmm16" in high.text
    assert [is_out_of_reach(made) for made in (masks, high, scalar, compare)] == [True, True, False, False]
    assert destinations([masks, high]) == [(), ()]
