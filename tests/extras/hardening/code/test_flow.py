"""Values, uses and entries of a small loop, read from its IR."""

import pytest

from mavfi.extras.hardening.choose import OUTSIDE, Candidates, PhiInput, choose, total_cost, values_of, weight_of
from mavfi.ir.parser import parse_module

LOOP = """
define i32 @f(ptr %out, ptr %data, i64 %n) {
entry:
  %start = load double, ptr %data
  br label %head
head:
  %i = phi i64 [ 0, %entry ], [ %next, %body ]
  %sum = phi double [ %start, %entry ], [ %more, %body ]
  %inside = icmp slt i64 %i, %n
  br i1 %inside, label %body, label %exit
body:
  %place = getelementptr double, ptr %data, i64 %i
  %x = load double, ptr %place
  %more = fadd double %sum, %x
  %next = add i64 %i, 1
  br label %head
exit:
  store double %sum, ptr %out
  ret i32 0
}
"""
START, COUNTER, SUM, INSIDE, PLACE, X, MORE, NEXT = range(8)
COUNTS = {(0, 0): 1.0, (0, 1): 11.0, (0, 2): 10.0, (0, 3): 1.0}


@pytest.fixture(scope="module")
def module():
    return parse_module(LOOP, "f")


def test_operands_entries_and_uses(module):
    values = values_of(module, COUNTS)
    assert [value.opcode for value in values] == ["load", "phi", "phi", "icmp", "getelementptr", "load", "fadd", "add"]
    assert values[MORE].operands == (SUM, X) and values[X].operands == (PLACE,) and values[PLACE].operands == (COUNTER,)
    assert (
        values[SUM].entries == (PhiInput(START, 1.0, False), PhiInput(MORE, 10.0, True)) and values[SUM].in_loop_header
    )
    assert values[INSIDE].uses == []  # both edges of the branch check its shadow
    assert {use.user for use in values[SUM].uses} == {MORE, OUTSIDE}


def test_cost_of_the_whole_loop_and_of_one_instruction(module):
    values = values_of(module, COUNTS)
    executed = 1 + 3 * 11 + 4 * 10
    # shadows; copy of 0 for the counter; the sum is compared once, where it is stored
    assert total_cost(values, set(range(8))) == executed + 1 + 3 * 1
    assert total_cost(values, {MORE}) == 10 + 10 + 3 * 10


def test_a_slow_instruction_costs_several_simple_ones(module):
    divides = parse_module(LOOP.replace("fadd", "fdiv"), "f")
    plain, slow = values_of(module, COUNTS), values_of(divides, COUNTS)
    for chosen in ({MORE}, set(range(8))):
        assert total_cost(slow, chosen) == total_cost(plain, chosen) + 10 * (slow[MORE].weight - 1)
    benefit = [float(index in (MORE, X)) for index in range(8)]
    assert choose([Candidates(slow, benefit, 1.0)], 60) == [{X}]
    assert choose([Candidates(plain, benefit, 1.0)], 60) == [{MORE, X}]


@pytest.mark.parametrize(
    ("text", "weight"),
    [
        ("%y = call double @llvm.floor.f64(double %x)", 6),
        ("%y = call double @floor(double %x)", 6),
        ("%y = call double @llvm.fabs.f64(double %x)", 1),
        ("%y = call double @llvm.sqrt.f64(double %x)", 6),
        ("%y = fmul double %x, %x", 1),
        ("%y = fdiv double %x, %x", 4),
    ],
)
def test_weights(text, weight):
    body = (
        f"define i32 @g(ptr %p, double %x) {{\nentry:\n  {text}\n  store double %y, ptr %p, align 8\n  ret i32 0\n}}\n"
    )
    block = parse_module(body, "g").functions[0].blocks[0]
    assert weight_of(block.sites[0]) == weight
