"""Coverage and its interval: against simulation, and at its limits."""

import numpy as np
import pytest

from mavfi.analysis.statistics import Rate, wilson
from mavfi.extras.hardening.certify import coverage, difference, p_value_below, ratio_bounds


def test_added_instructions_do_not_dilute_the_rate():
    before, after = wilson(40, 100), wilson(20, 100)
    assert coverage(before, after, 1.0).rate == pytest.approx(0.5)
    assert coverage(before, after, 2.0).rate == pytest.approx(0.0)  # half the rate over twice the instructions
    assert coverage(before, wilson(0, 400), 2.1).rate == 1.0
    assert coverage(before, wilson(0, 400), 2.1).low == pytest.approx(1 - 2.1 * ratio_bounds(wilson(0, 400), before)[1])


def test_nothing_is_known_without_corruptions_before():
    assert coverage(wilson(0, 50), wilson(0, 50), 2.0).rate is None
    assert coverage(wilson(5, 50), wilson(0, 0), 2.0).rate is None


def test_the_interval_of_a_ratio_has_its_confidence():
    random, p, q, n = np.random.default_rng(3), 0.03, 0.4, 400
    hits = 0
    for k, m in zip(random.binomial(n, p, 1000), random.binomial(n, q, 1000), strict=True):
        low, high = ratio_bounds(wilson(int(k), n), wilson(int(m), n))
        hits += low <= p / q <= high
    assert 0.93 <= hits / 1000 <= 0.98


def test_differences_of_coverages():
    low, high = difference(Rate(0, 0.9, 0.85, 0.93), Rate(0, 0.95, 0.9, 0.97))
    assert low < 0 < high
    low, high = difference(Rate(0, 0.6, 0.5, 0.7), Rate(0, 0.95, 0.9, 0.97))
    assert high < 0
    assert difference(Rate(0, None, None, None), Rate(0, 0.5, 0.4, 0.6)) == (float("-inf"), float("inf"))


@pytest.mark.parametrize("rate", [0.5, 0.75, 0.8, 0.85, 0.88])
def test_p_is_below_5_per_cent_where_the_interval_of_the_difference_is_below_0(rate):
    measured, predicted = Rate(0, rate, rate - 0.1, rate + 0.04), Rate(0, 0.9, 0.86, 0.92)
    assert (p_value_below(measured, predicted) < 0.05) == (difference(measured, predicted)[1] < 0)
