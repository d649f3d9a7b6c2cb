"""Choice of values: against exhaustive search on small graphs, and its properties on random ones."""

from itertools import chain, combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mavfi.extras.hardening.choose import OUTSIDE, Chooser, Cuts, Use, Value, total_cost
from mavfi.extras.hardening.plan import ModuleSite

HOT, COLD = 100.0, 1.0


def graph(operands, executions, outside=(), kinds=None):
    """Values with the given operands (indices); those in `outside` are used by something that cannot be duplicated."""
    values = [
        Value(ModuleSite(0, i, 0), "add", (kinds or {}).get(i, "i64"), float(executions[i]), tuple(own))
        for i, own in enumerate(operands)
    ]
    for user, own in enumerate(operands):
        for operand in own:
            values[operand].uses.append(Use(user, f"%b{user}", values[user].executions))
    for i in outside:
        values[i].uses.append(Use(OUTSIDE, f"%out{i}", values[i].executions))
    return values


def modelled(values, chosen):
    """The cost that a cut minimises, from its definition: copies in parts, comparisons with all uses."""
    total = 0.0
    for i in chosen:
        value = values[i]
        total += value.executions
        missing = [operand for operand in value.operands if operand not in chosen]
        total += value.executions * (len(missing) / len(value.operands) if value.operands else 1)
        if any(use.user not in chosen for use in value.uses):
            there = sum({use.block: use.executions for use in value.uses}.values())
            total += value.comparison * min(value.executions, there)
    return total


def subsets(n):
    return map(frozenset, chain.from_iterable(combinations(range(n), size) for size in range(n + 1)))


@st.composite
def graphs(draw, most=7):
    n = draw(st.integers(1, most))
    operands = [draw(st.sets(st.integers(0, i - 1), max_size=2)) if i else set() for i in range(n)]
    executions = [draw(st.sampled_from([1, 3, 10, 50])) for _ in range(n)]
    outside = draw(st.sets(st.integers(0, n - 1)))
    benefit = [draw(st.integers(0, 60)) for _ in range(n)]
    kinds = {i: draw(st.sampled_from(["i64", "double"])) for i in range(n)}
    return graph([sorted(own) for own in operands], executions, outside, kinds), np.array(benefit, float)


@settings(max_examples=30, deadline=None)
@given(graphs(), st.sampled_from([0.05, 0.3, 1.0, 4.0]))
def test_a_cut_is_the_best_of_all_sets_at_its_price(made, price):
    values, benefit = made

    def worth(chosen):
        return benefit[list(chosen)].sum() - price * modelled(values, chosen)

    assert worth(Cuts(values, benefit).at(price)) == pytest.approx(max(map(worth, subsets(len(values)))), abs=1e-4)


@settings(max_examples=30, deadline=None)
@given(graphs(), st.lists(st.floats(0, 600), min_size=2, max_size=6))
def test_a_larger_budget_never_covers_less_and_is_never_exceeded(made, budgets):
    chooser = Chooser(*made)
    choices = [chooser.within(budget) for budget in sorted(budgets)]
    assert all(choice.cost <= budget for choice, budget in zip(choices, sorted(budgets), strict=True))
    assert all(one.benefit <= other.benefit for one, other in zip(choices, choices[1:], strict=False))
    assert all(choice.cost == pytest.approx(total_cost(chooser.values, choice.chosen)) for choice in choices)


@settings(max_examples=30, deadline=None)
@given(graphs(), st.floats(0, 600))
def test_no_choice_beats_the_exhaustive_one_and_the_whole_budget_buys_everything(made, budget):
    values, benefit = made
    chooser = Chooser(values, benefit)
    best = max(benefit[list(s)].sum() for s in subsets(len(values)) if total_cost(values, s) <= budget)
    assert chooser.within(budget).benefit <= best + 1e-9
    assert chooser.within(chooser.full.cost).benefit == pytest.approx(benefit.sum())


def test_a_slice_is_cheaper_than_its_values_alone():
    values = graph([[], [0], [1], [2]], [10] * 4, outside=[3], kinds=dict.fromkeys(range(4), "double"))
    assert total_cost(values, {0, 1, 2, 3}) == 4 * 10 + 10 + 30  # shadows, one copy, one comparison
    assert sum(total_cost(values, {i}) for i in range(4)) == 4 * 50


def test_a_comparison_is_made_where_it_is_executed_less_often():
    value = Value(ModuleSite(0, 0, 0), "load", "double", HOT)
    value.uses.append(Use(OUTSIDE, "%b1", COLD))
    assert total_cost([value], {0}) == HOT + 3 * COLD
    value.uses.append(Use(OUTSIDE, "%b2", None))  # a block whose executions are not counted
    assert total_cost([value], {0}) == HOT + 3 * HOT
