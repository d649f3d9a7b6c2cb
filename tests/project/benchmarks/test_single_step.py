"""The reference at machine level: execution is the same each time, strikes are seen, outcomes distinguished."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.destinations import destinations, is_out_of_reach
from benchmarks.machine_level import DETECTED, entry_of, inject_all, protected
from benchmarks.single_step import MachineFault, SteppedCall
from mavfi.extras.registers.registers import decode
from mavfi.levels.instruction.api import digest
from mavfi.numerics.jit import kernel_jit
from tests.core.unit.faults.instruction.kernels import counted_down, fill
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


# ---- strikes --------------------------------------------------------------------------------------------------------
@pytest.mark.slow
def test_each_strike_flips_the_bit_that_was_drawn_and_no_other(call):
    outcomes = [call.inject(fault) for fault in call.draw(np.random.default_rng(SEED), 12)]
    assert all(outcome.activated and outcome.before ^ outcome.after == 1 << outcome.fault.bit for outcome in outcomes)
    assert len({outcome.how for outcome in outcomes}) > 1
    assert len({outcome.fault.register.name for outcome in outcomes}) > 3


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


CMP, JA, JE, ADD, MOV, CALL = "4839d8", "7702", "7402", "4801d8", "4889d8", "e800000000"


def test_registers_that_cannot_be_injected_are_counted_apart():
    masks, high, scalar, compare = run_of("62f1c708c2cf07", "62e1fd0828c0", "c5fb10c1", CMP)
    assert masks.text.startswith("vcmp") and "xmm16" in high.text
    assert [is_out_of_reach(made) for made in (masks, high, scalar, compare)] == [True, True, False, False]
    assert destinations([masks, high]) == [(), ()]
