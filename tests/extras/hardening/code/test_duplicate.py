"""Protected kernels: no fault is silent, results are those of the plain kernel, shadows stay in the machine code."""

import re
from collections import Counter
from dataclasses import replace
from functools import cache

import llvmlite.binding as llvm
import numpy as np
import pytest

from mavfi.extras.hardening.compiled import copied
from mavfi.extras.hardening.duplicate import candidates, protect
from mavfi.ir.build import target_machine
from mavfi.ir.module import bodies_of, is_floating
from mavfi.levels.instruction.api import digest
from tests.core.unit.kernels.cases import CASES as REAL
from tests.extras.hardening.code.kernels import CASES, blend
from tests.extras.hardening.code.strikes import Full, module_of, strike_all, variant


@cache
def module(name):
    return module_of(*CASES[name])


@cache
def struck(name, *, addresses):
    return variant(*CASES[name], Full(addresses=addresses))


@pytest.mark.parametrize("name", ["mean_square", "walk"])
def test_with_compared_addresses_every_fault_is_detected_or_harmless(name):
    """Every bit of every dynamic instruction."""
    detected, silent = strike_all(struck(name, addresses=True), CASES[name][1])
    assert set(detected) == {"detected", "masked"}, silent
    assert detected["detected"] > 7000


@pytest.mark.parametrize("name", ["mean_square", "walk"])
def test_fully_duplicated_no_fault_is_silent(name):
    detected, silent = strike_all(struck(name, addresses=False), CASES[name][1], step=41)
    assert detected["sdc"] == detected["hang"] == 0, silent
    assert detected["detected"] > 100 and detected["crash"] > 0


def test_what_is_not_duplicated_can_be_silent():
    """Calls of libm."""
    detected, silent = strike_all(struck("blend", addresses=True), CASES["blend"][1], step=31)
    assert detected["sdc"] > 0
    assert all("call double" in site for site in silent)


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("addresses", [False, True])
def test_without_a_fault_results_are_those_of_the_plain_kernel(name, addresses):
    kernel, args = CASES[name]
    plain, protected_arguments = copied(args), copied(args)
    assert digest((struck(name, addresses=addresses).count(*protected_arguments)[0], protected_arguments)) == digest(
        (kernel(*plain), plain)
    )


@pytest.mark.parametrize("name", ["walk", "blend"])
def test_executions_are_counted_as_in_plain_code(name):
    """The fast count derives those of split blocks from others; the slow one counts each block."""
    kernel, args = CASES[name]
    protected = struck(name, addresses=True)
    fast, slow = protected.tally(*copied(args))[1], protected.profile(*copied(args))[1]
    assert fast.tolist() == slow.tolist()
    originals = [count for site, count in protected.table.executions(fast) if not site.role]
    plain = variant(kernel, args)
    assert originals == [count for _, count in plain.table.executions(plain.tally(*copied(args))[1])]


def test_exceptions_pass():
    args = (np.zeros(3), np.zeros(2), np.zeros(3))
    with pytest.raises(ValueError, match="lengths"):
        struck("blend", addresses=True).count(*args)


@pytest.mark.long
@pytest.mark.parametrize("name", [name for name, case in REAL.items() if hasattr(case.function, "py_func")])
def test_kernels_of_the_pipeline_keep_their_results(name):
    case = REAL[name]
    args, plain, protected_args = (case.arguments() for _ in range(3))
    protected = variant(case.function, args, Full(addresses=True))
    result = protected.count(*protected_args)[0]
    assert digest((result, protected_args)) == digest((case.function(*plain), plain))


def test_a_protected_module_is_a_copy():
    plain = module("walk")
    bodies = bodies_of(plain)
    protect(plain, candidates(plain), addresses=True)
    assert bodies_of(plain) == bodies
    assert protect(plain, [], addresses=True) == plain


def arithmetic(text):
    """Number of floating-point instructions in the machine code of the fault space, by mnemonic."""
    parsed = llvm.parse_assembly(text)
    lines = target_machine().emit_assembly(parsed).split("\n")
    return Counter(
        word
        for word in (line.split()[0] for line in lines if line.startswith("\t"))
        if re.fullmatch(r"(?:add|sub|mul|div|sqrt)[sp]d", word)
    )


def whole(some):
    return "\n".join([*some.preamble, *(function.text() for function in some.functions), *some.others])


@pytest.mark.parametrize("name", ["mean_square", "blend"])
def test_code_generation_keeps_all_shadows(name):
    plain = module(name)
    protected = protect(plain, candidates(plain), addresses=False)
    before, after = arithmetic(whole(plain)), arithmetic(whole(protected))
    assert before and after == {word: 2 * count for word, count in before.items()}


def test_only_functions_that_can_report_are_duplicated():
    """A function without a status, and what it calls, stay as they are."""
    plain = module("walk")
    assert candidates(plain)
    mute = replace(plain, functions=[replace(function, kind="i64") for function in plain.functions])
    assert candidates(mute) == []


def test_floating_point_values_are_compared_as_bits():
    """NaN differs from itself as a number, and 0.0 equals -0.0."""
    protected = protect(module("blend"), candidates(module("blend")), addresses=False)
    for function in protected.functions:
        for block in function.blocks:
            for site in block.sites:
                assert not (site.role == "check" and site.opcode == "fcmp")
                assert not (site.role == "check" and is_floating(site.kind))
    assert blend(np.array([np.nan, -0.0]), np.ones(2), np.zeros(2)) != 0
    args = (np.array([np.nan, -0.0]), np.ones(2), np.zeros(2))
    assert np.isnan(struck("blend", addresses=True).count(*args)[0])
