import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binomtest, poisson

from mavfi.campaign.statistics import (
    cluster_sums,
    event_rate,
    mcnemar,
    recovery,
    resample,
    smallest_difference,
    weighted_rate,
    wilson,
)


@given(st.integers(1, 400).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n))))
def test_wilson_is_its_closed_form_and_holds_the_rate(counts):
    k, n = counts
    z = 1.959963984540054
    centre = (k + z * z / 2) / (n + z * z)
    half = z / (n + z * z) * math.sqrt(k * (n - k) / n + z * z / 4)
    rate = wilson(k, n)
    assert rate.low == pytest.approx(max(0, centre - half), abs=1e-9)
    assert rate.high == pytest.approx(min(1, centre + half), abs=1e-9)
    assert rate.low <= rate.rate + 1e-12
    assert rate.rate <= rate.high + 1e-12


@pytest.mark.parametrize(
    ("k", "n", "low", "high"), [(85, 100, 0.767, 0.907), (226, 300, 0.7016, 0.7987), (300, 300, 0.987, 1.0)]
)
def test_wilson_of_the_papers_table(k, n, low, high):
    rate = wilson(k, n)
    assert (rate.low, rate.high) == pytest.approx((low, high), abs=6e-4)


def test_wilson_of_nothing():
    assert wilson(0, 0).rate is None


@given(st.lists(st.tuples(st.booleans(), st.booleans()), min_size=1, max_size=60))
def test_mcnemar_counts_discordant_pairs_and_is_the_binomial_test(pairs):
    first, second = zip(*pairs, strict=True)
    found = mcnemar(first, second)
    assert found.first_only == pairs.count((True, False))
    assert found.second_only == pairs.count((False, True))
    discordant = found.first_only + found.second_only
    assert found.p_value == (pytest.approx(binomtest(found.first_only, discordant).pvalue) if discordant else 1)
    assert mcnemar(second, first).p_value == pytest.approx(found.p_value)


def test_mcnemar_against_the_closed_form():
    assert mcnemar([True] * 8 + [False], [False] * 8 + [True]).p_value == pytest.approx(2 * (1 + 9) / 2**9)


@given(st.integers(0, 50), st.floats(0.1, 100))
def test_poisson_bounds_have_the_stated_tails(events, hours):
    rate = event_rate(events, hours)
    assert poisson.cdf(events, rate.high * hours) == pytest.approx(0.025, abs=1e-6)
    assert poisson.cdf(events, rate.upper * hours) == pytest.approx(0.05, abs=1e-6)
    assert rate.low == 0 if events == 0 else poisson.sf(events - 1, rate.low * hours) == pytest.approx(0.025, abs=1e-6)
    assert rate.low <= rate.per_hour <= rate.upper <= rate.high


def test_no_event_in_four_hours_allows_three_quarters_of_one_per_hour():
    assert event_rate(0, 4.0).upper == pytest.approx(0.749, abs=1e-3)
    assert event_rate(0, 0.0).per_hour is None


def test_cluster_sums():
    sums = cluster_sums(["b", "a", "b"], [1, 2, 3], [1, 1, 1])
    assert sums.tolist() == [[4, 2], [2, 1]]
    assert resample(sums).tolist() == resample(sums).tolist()


def worlds(n, per_world):
    return [place // per_world for place in range(n)]


def test_weighted_rate_finds_the_rate_of_the_population():
    """All of one stratum succeed, none of the other; the population is 3/16 to 13/16 of them."""
    success = [1] * 40 + [0] * 20
    rate = weighted_rate(success, [3 / 16] * 40 + [13 / 16] * 20, ["a"] * 40 + ["b"] * 20, worlds(60, 2))
    assert rate.rate == pytest.approx(3 / 16)
    assert rate.low <= 3 / 16 <= rate.high


def test_weighted_rate_of_one_stratum_is_the_plain_rate():
    random = np.random.default_rng(1)
    success = random.integers(2, size=300).tolist()
    rate = weighted_rate(success, [0.2] * 300, ["a"] * 300, worlds(300, 1))
    plain = wilson(sum(success), 300)
    assert rate.rate == pytest.approx(plain.rate)
    assert (rate.low, rate.high) == pytest.approx((plain.low, plain.high), abs=0.01)


@pytest.mark.parametrize("outcome", [0, 1])
def test_flights_that_all_end_alike_still_leave_doubt(outcome):
    plain = wilson(60 * outcome, 60)
    rate = weighted_rate([outcome] * 60, [1.0] * 60, ["a"] * 60, worlds(60, 2))
    assert (rate.low, rate.high) == pytest.approx((plain.low, plain.high))
    rate = weighted_rate([outcome] * 60, [0.2] * 40 + [0.8] * 20, ["a"] * 40 + ["b"] * 20, worlds(60, 2))
    assert rate.rate == pytest.approx(outcome)
    assert rate.high - rate.low > plain.high - plain.low


def test_flights_of_one_world_are_not_independent():
    """Ten identical flights per world say as much as one: the interval must not shrink."""
    success = [1, 0] * 20
    alone = weighted_rate(success, [1.0] * 40, ["a"] * 40, worlds(40, 1))
    tenfold = weighted_rate(np.repeat(success, 10).tolist(), [1.0] * 400, ["a"] * 400, worlds(400, 10))
    assert (alone.low, alone.high) == pytest.approx((tenfold.low, tenfold.high))


def test_recovery_rate():
    golden = [(world, True) for world in range(100)]
    pairs = [(world, world >= 20, world >= 5) for world in range(100)]
    found = recovery(golden, pairs)
    assert found.loss == pytest.approx(0.2)
    assert found.rate == pytest.approx(0.75)
    assert found.low < 0.75 < found.high
    assert 0 < found.loss_low < 0.2 < found.loss_high


@pytest.mark.parametrize("failing", [0, 1, 2])
def test_recovery_is_undefined_while_the_loss_may_be_nothing(failing):
    golden = [(world, world != 50) for world in range(100)]
    found = recovery(golden, [(world, world >= failing, True) for world in range(100)])
    assert found.rate is None
    assert found.low is None
    assert found.loss_low <= 0 <= found.loss_high


def test_recovery_of_nothing():
    assert recovery([], []) is None


def test_smallest_difference_shrinks_with_n_and_is_the_textbooks():
    # 80 % power, 5 % two-sided: (1.960 + 0.842) sqrt(2 p (1 - p) / n)
    assert smallest_difference(0.5, 100, 100) == pytest.approx(2.8016 * math.sqrt(0.5 / 100), rel=1e-3)
    assert smallest_difference(0.9, 300, 300) < smallest_difference(0.9, 100, 300)
    assert smallest_difference(1.0, 30, 60) > 0
    assert smallest_difference(0.9, 0, 60) is None
