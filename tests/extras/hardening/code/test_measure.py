"""Timing: the loop around a kernel, and ratios within rounds, with clocks that are given."""

import numpy as np
import pytest

from mavfi.extras.hardening.compiled import Timed, compare
from mavfi.ir.parser import parse_module
from mavfi.ir.sources import cached_source
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
    timed = Timed(source, module, count_up.overloads[signature].environment)
    ticks = timed.ticks((total,), 7)
    assert total[0] == 8.0 and ticks > 0
    timed.ticks((total,), 1)
    assert total[0] == 9.0


def clocks(order, slower=1.01):
    """Plain code and two variants, on a machine that gets slower all the time; `b` takes longer in short calls."""
    slow = [1.0]

    def clock(name, factor):
        def ticks(args, repetitions):
            order.append((name, repetitions))
            slow[0] *= slower
            return args[0] * factor(args[0]) * slow[0]

        return ticks

    plain = clock("plain", lambda _: 1.0)
    return plain, {"a": clock("a", lambda _: 1.5), "b": clock("b", lambda long: 2.0 if long > 2e7 else 6.0)}


def test_ratios_are_those_within_rounds_and_of_the_time_of_all_calls():
    order = []
    compared = compare(*clocks(order), [(1e7,), (3e7,)], lambda n: n >= 30)
    assert compared.ratios == pytest.approx({"a": 1.5, "b": (1e7 * 6.0 + 3e7 * 2.0) / 4e7}, rel=0.03)
    names = [name for name, _ in order]
    assert len(names) == 3 + 3 * 30
    assert {tuple(names[3 + 3 * i : 6 + 3 * i]) for i in range(30)} == {
        ("plain", "a", "b"),
        ("a", "b", "plain"),
        ("b", "plain", "a"),
    }
    assert compared.ticks > 2e7 * 0.9


def test_rounds_in_which_the_core_is_shared_do_not_count():
    made = iter(range(10**6))

    def clock(alone, shared):
        return lambda args, _: args[0] * (shared if next(made) % 90 < 60 else alone)  # two of three rounds

    compared = compare(clock(1.0, 1.1), {"a": clock(1.25, 1.6)}, [(1e7,)], lambda n: n >= 100)
    assert compared.ratios == pytest.approx({"a": 1.25})
    assert compared.ticks == pytest.approx(1e7)


def test_arguments_of_recorded_calls_are_not_modified():
    values = np.zeros(2)

    def ticks(args, _):
        args[0][:] += 1
        return 1.0

    compare(ticks, {"a": ticks}, [(values,)], lambda n: n >= 3)
    assert not values.any()
