"""Timing: the loop around a kernel, and ratios within rounds, with clocks that are given."""

import numpy as np
import pytest

from mavfi.hardening.measure import Timed, compare
from mavfi.hardening.sources import cached_source
from mavfi.ir.parser import parse_module
from mavfi.numerics.jit import kernel_jit


@kernel_jit
def count_up(total):
    total[0] += 1.0
    return total[0]


def test_a_call_repeats_the_kernel_and_reads_the_counter():
    total = np.zeros(1)
    count_up(total)
    (signature,) = count_up.signatures
    source = cached_source(count_up, signature)
    module = parse_module(source.text, source.kernel)
    timed = Timed(source, Timed.code_of(source, module), count_up.overloads[signature].environment)
    ticks = timed.ticks((total,), 7)
    assert total[0] == 8.0 and ticks > 0
    timed.ticks((total,), 1)
    assert total[0] == 9.0


def test_ratios_are_medians_within_rounds_and_each_call_weighs_the_same():
    slow, order = [1.0], []

    def clock(factor, name):
        def ticks(args, repetitions):
            order.append(name)
            slow[0] *= 1.01  # the machine gets slower all the time
            return args[0] * factor * slow[0]

        return ticks

    found = compare(
        clock(1.0, "plain"), {"a": clock(1.5, "a"), "b": clock(3.0, "b")}, [(1e5,), (3e5,)], lambda n: n >= 30
    )
    assert found.ratios == pytest.approx({"a": 1.5, "b": 3.0}, rel=0.03)
    assert len(order) == 3 + 3 * 30
    assert {tuple(order[3 + 3 * i : 6 + 3 * i]) for i in range(30)} == {
        ("plain", "a", "b"), ("a", "b", "plain"), ("b", "plain", "a"),
    }  # fmt: skip
    assert found.ticks > 2e5 * 0.9


def test_arguments_of_recorded_calls_are_not_modified():
    values = np.zeros(2)

    def ticks(args, _):
        args[0][:] += 1
        return 1.0

    compare(ticks, {"a": ticks}, [(values,)], lambda n: n >= 3)
    assert not values.any()
