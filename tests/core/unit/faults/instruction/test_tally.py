"""Counts of block executions: equal to those of the slow path, whatever the control flow."""

import numpy as np
import pytest

from mavfi.ir.injection.variant import variant_for
from mavfi.levels.instruction.api import digest, histogram
from mavfi.numerics.jit import kernel_jit


@kernel_jit
def collatz(number):
    steps = 0
    while number != 1:
        number = number // 2 if number % 2 == 0 else 3 * number + 1
        steps += 1
    return steps


@kernel_jit
def first_above(values, limit):
    for i in range(len(values)):
        if values[i] > limit:
            return i
    raise ValueError("none")


@kernel_jit
def fill(rows, values):
    for i in range(rows.shape[0]):
        for j in range(i):
            if values[j] > 0.5:
                rows[i, j] = np.sqrt(values[j]) + values[i]
    return rows.sum()


def arguments(function):
    values = np.random.default_rng(0).random(40)
    return {collatz: (27,), first_above: (values, 0.97), fill: (np.zeros((40, 40)), values)}[function]


@pytest.mark.parametrize("function", [collatz, first_above, fill])
def test_counts_results_and_arguments_are_those_of_the_slow_path(function):
    plain, fast, again, slow = (arguments(function) for _ in range(4))
    result = function(*plain)
    variant = variant_for(function, fast)
    counted, times = variant.tally(*fast)
    oracle, wanted, _ = variant.profile(*slow)
    assert digest((counted, fast)) == digest((oracle, slow)) == digest((result, plain))
    assert times.tolist() == wanted.tolist() == variant.tally(*again)[1].tolist(), "each call is counted from zero"
    if function is collatz:
        assert collatz.py_func(27) in times
        assert collatz.py_func(27) in {executions for _, executions in histogram(collatz, 27)}


def test_a_call_that_raises_is_an_exception_as_without_counts():
    with pytest.raises(ValueError, match="none"):
        variant_for(first_above, arguments(first_above)).tally(np.zeros(3), 2.0)
