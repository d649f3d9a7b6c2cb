"""Counting, drawing and injecting in kernels of one's own; outcomes; records."""

import json
import runpy
from dataclasses import replace

import numpy as np
import pytest

from mavfi.ir.forked import WILD
from mavfi.ir.injection.variant import variant_for
from mavfi.levels.instruction import count, draw, histogram, inject, resolve, run_forked
from mavfi.levels.instruction.api import digest
from mavfi.levels.instruction.fault import InstructionFault
from mavfi.levels.instruction.plan import budget_for
from tests.core.architecture.source import ROOT
from tests.core.unit.faults.instruction.kernels import LOOP, counted_down, double, fill, loop, raising


def numbers():
    return np.linspace(0.0, 4.0, 12)


def first(kernel, opcode, *args):
    """A fault in the first execution of an opcode; its bit is 0."""
    variant = variant_for(kernel, args)
    copies = tuple(np.copy(arg) if isinstance(arg, np.ndarray) else arg for arg in args)
    total = count(kernel, *copies)
    sites = resolve(kernel, range(total), *copies)
    index = next(index for index, site in enumerate(sites) if site.opcode == opcode)
    name = f"{kernel.py_func.__module__}.{kernel.py_func.__name__}"
    return InstructionFault(name, variant.ir_sha256, index, bits=(0,))


def flipped(injection):
    """Which bits of the value differ."""
    return int(injection.details["before_bits"], 16) ^ int(injection.details["after_bits"], 16)


@pytest.mark.slow
def test_a_kernel_of_ones_own_in_a_few_lines(capsys):
    runpy.run_path(str(ROOT / "examples" / "instruction_fault.py"), run_name="__main__")
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].endswith("dynamic instructions")
    assert len(lines) == 9
    assert all("instruction_fault.py:" in line for line in lines[1:])
    assert {line.split()[0] for line in lines[1:]} <= {"masked", "sdc", "crash", "hang", "exception"}


def test_an_injected_call_changes_its_arguments_and_tells():
    values = numbers()
    fault = replace(first(fill, "fmul", values, 2.0), bits=(62,))
    result, injection = inject(fill, fault, values, 2.0)
    plain = numbers()
    sound = fill(plain, 2.0)
    changed = np.flatnonzero(values != plain)
    assert injection.activated and len(changed) > 0
    assert flipped(injection) == 1 << 62
    assert injection.before == numbers()[1] * 2.0
    assert injection.details["opcode"] == "fmul" and injection.file.endswith("kernels.py")
    assert result == sum(i for i in range(1, len(values)) if values[i] > 3.0) != sound


def test_outcomes_are_distinguished_and_arguments_stay():
    values = numbers()
    before = digest(values)
    sdc = run_forked(fill, replace(first(fill, "fmul", values, 2.0), bits=(62,)), values, 2.0)
    assert (sdc.how, sdc.injection.activated) == ("sdc", True)
    crash = run_forked(fill, replace(first(fill, "getelementptr", values, 2.0), bits=(60,)), values, 2.0)
    assert (crash.how, crash.detail, crash.injection.activated) == ("crash", WILD, True)
    assert flipped(crash.injection) == 1 << 60  # known although the child is gone
    beyond = run_forked(fill, replace(first(fill, "fmul", values, 2.0), index=10**6), values, 2.0)
    assert (beyond.how, beyond.injection.activated, beyond.injection.before) == ("not_activated", False, None)
    assert digest(values) == before


@pytest.mark.slow
def test_the_lanes_of_a_vector_are_injected_one_by_one():
    sites = [site for site, times in histogram(double, np.ones(64)) if site.opcode == "fmul" and times]
    vector = next((site for site in sites if site.kind.startswith("<")), None)
    if vector is None:
        pytest.skip("this CPU has no vectors of double")
    lanes = vector.width // 64
    for lane in range(lanes):
        values = np.ones(64)
        inject(double, replace(first(double, "fmul", values), bits=(64 * lane + 62,)), values)
        changed = np.flatnonzero(values != 2.0)
        assert len(changed) == 1 and changed[0] % lanes == lane


def test_a_loop_that_does_not_end_is_a_hang():
    fault = replace(first(counted_down, "fadd", 1.5), bits=(62,))  # 0.5 becomes 2^1023, from which 1 cannot be taken
    outcome = run_forked(counted_down, fault, 1.5)
    assert (outcome.how, outcome.detail) == ("hang", "instruction budget")
    assert outcome.injection.activated and outcome.injection.after == 2.0**1023


def test_exceptions_are_distinguished():
    fault = first(raising, "icmp", numbers(), 3)
    outcome = run_forked(raising, fault, numbers(), 3)
    assert (outcome.how, outcome.detail) == ("exception", "ValueError: negative")
    with pytest.raises(ValueError, match="negative"):
        inject(raising, fault, numbers(), 3)
    assert inject(raising, replace(fault, index=10**6), numbers(), 3)[0] == raising(numbers(), 3)


# ---- drawing --------------------------------------------------------------------------------------------------------
@pytest.mark.slow
@pytest.mark.parametrize(
    ("which", "belongs"),
    [
        ("floating_point", lambda site: site.kind == "double"),
        ("data", lambda site: site.value_class in ("floating_point", "integer")),
        ("opcode:fmul", lambda site: site.opcode == "fmul"),
        ("line:instruction/kernels.py:44-45", lambda site: site.line in (44, 45)),
    ],
)
def test_faults_are_drawn_from_the_class_that_was_asked_for(which, belongs):
    values = numbers()
    faults = draw(fill, 20, values, 2.0, which=which, seed=4)
    sites = resolve(fill, [fault.index for fault in faults], numbers(), 2.0)
    assert all(belongs(site) and 0 <= fault.bits[0] < site.width for fault, site in zip(faults, sites, strict=True))
    assert {fault.which for fault in faults} == {which}
    assert np.array_equal(values, numbers())
    assert faults == draw(fill, 20, values, 2.0, which=which, seed=4)
    assert faults != draw(fill, 20, values, 2.0, which=which, seed=5)


def test_draws_are_uniform_over_dynamic_instructions_and_bits():
    total = count(loop, *LOOP)
    faults = draw(loop, 20_000, *LOOP, seed=6)
    hits = np.bincount([fault.index for fault in faults], minlength=total)
    expected = len(faults) / total
    assert abs(((hits - expected) ** 2 / expected).sum() - total) < 5 * np.sqrt(2 * total)
    executed = {site.opcode: 0 for site, _ in histogram(loop, *LOOP)}
    for site, times in histogram(loop, *LOOP):
        executed[site.opcode] += times
    assert sum(executed.values()) == total
    assert all(fault.budget == budget_for(total) for fault in faults)


def test_an_injection_names_line_instruction_and_value():
    fault = draw(fill, 1, numbers(), 2.0, which="opcode:fmul", seed=1)[0]
    injection = run_forked(fill, fault, numbers(), 2.0).injection
    record = injection.to_json()
    assert json.loads(json.dumps(record)) == record
    assert injection.file == "tests/core/unit/faults/instruction/kernels.py"
    assert injection.line == fill.py_func.__code__.co_firstlineno + 4
    details = injection.details
    assert (details["opcode"], details["type"], details["value_class"]) == ("fmul", "double", "floating_point")
    assert details["ir_sha256"] == fault.ir_sha256 and flipped(injection) == 1 << fault.bits[0]
    assert injection.activated
