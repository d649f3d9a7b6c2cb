"""Greedy choice of values: its costs, what it takes first, and that it keeps to its budget."""

from hypothesis import given
from hypothesis import strategies as st

from mavfi.extras.hardening.choose import OUTSIDE, Candidates, Use, Value, choose, total_cost
from mavfi.extras.hardening.plan import ModuleSite

HOT, COLD = 100.0, 1.0


def graph(operands, executions, outside=(), kinds=None):
    """Values with the given operands (indices); those in `outside` are used by something that cannot be duplicated."""
    values = [
        Value(ModuleSite(0, i, 0), "add", (kinds or {}).get(i, "i64"), float(executions[i]), tuple(inputs))
        for i, inputs in enumerate(operands)
    ]
    for user, inputs in enumerate(operands):
        for operand in inputs:
            values[operand].uses.append(Use(user, f"%b{user}", values[user].executions))
    for i in outside:
        values[i].uses.append(Use(OUTSIDE, f"%out{i}", values[i].executions))
    return values


@st.composite
def graphs(draw, most=7):
    n = draw(st.integers(1, most))
    operands = [draw(st.sets(st.integers(0, i - 1), max_size=2)) if i else set() for i in range(n)]
    executions = [draw(st.sampled_from([1, 3, 10, 50])) for _ in range(n)]
    outside = draw(st.sets(st.integers(0, n - 1)))
    benefit = [draw(st.integers(0, 60)) for _ in range(n)]
    kinds = {i: draw(st.sampled_from(["i64", "double"])) for i in range(n)}
    return Candidates(graph([sorted(inputs) for inputs in operands], executions, outside, kinds), benefit, 0.5)


@given(graphs(), graphs(), st.floats(0, 600))
def test_a_budget_is_never_exceeded_and_a_large_one_buys_all_that_is_worth_anything(first, second, budget):
    functions = [first, second]
    chosen = choose(functions, budget)
    assert (
        sum(0.5 * total_cost(function.values, picked) for function, picked in zip(functions, chosen, strict=True))
        <= budget
    )
    worth = [{index for index, benefit in enumerate(function.benefit) if benefit} for function in functions]
    assert choose(functions, 1e9) == worth


def test_what_removes_most_per_time_is_taken_first_in_all_functions():
    """Each value alone costs its execution, a copy and a comparison: 30; the second function is three times slower."""
    fast = Candidates(graph([[], []], [10, 10], outside=[0, 1]), [9.0, 30.0], 1.0)
    slow = Candidates(graph([[], []], [10, 10], outside=[0, 1]), [60.0, 15.0], 3.0)
    for budget, expected in ((29, [set(), set()]), (30, [{1}, set()]), (120, [{1}, {0}]), (150, [{0, 1}, {0}])):
        assert choose([fast, slow], budget) == expected


def test_a_slice_grows_where_its_next_value_is_cheap():
    """Value 3 is worth no more than 0, 1 and 2, but next to the chosen 4 it costs less."""
    values = graph([[], [], [], [], [3]], [10] * 5, outside=[0, 1, 2, 4])
    (chosen,) = choose([Candidates(values, [10.0, 10.0, 10.0, 10.0, 50.0], 1.0)], 45)
    assert chosen == {3, 4} and total_cost(values, chosen) == 40


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
