"""Draws of dynamic instructions: uniform over calls."""

import numpy as np

from mavfi.levels.instruction.plan import choose


def test_calls_are_drawn_with_the_weight_of_their_counts():
    counts = [10, 0, 1000, 10]
    drawn = choose(np.random.default_rng(1), counts, 5_000)
    calls = np.bincount([call for call, _ in drawn], minlength=4)
    assert calls[1] == 0
    assert abs(calls[2] - 5_000 * 1000 / 1020) < 200
    assert all(0 <= index < counts[call] for call, index in drawn)
    assert {index for call, index in drawn if call == 0} == set(range(10))
