import itertools
import math
from dataclasses import astuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import beta, binomtest, poisson

from mavfi.analysis.statistics import (
    cluster_sums,
    clustered_rate,
    event_rate,
    event_rate_by_flight,
    mcnemar,
    paired_difference,
    recovery,
    resample,
    smallest_difference,
    weighted_rate,
    wilson,
)


@pytest.mark.slow
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
    estimate = mcnemar(first, second)
    assert estimate.first_only == pairs.count((True, False))
    assert estimate.second_only == pairs.count((False, True))
    discordant = estimate.first_only + estimate.second_only
    assert estimate.p_value == (pytest.approx(binomtest(estimate.first_only, discordant).pvalue) if discordant else 1)
    assert mcnemar(second, first).p_value == pytest.approx(estimate.p_value)


def test_mcnemar_against_the_closed_form():
    assert mcnemar([True] * 8 + [False], [False] * 8 + [True]).p_value == pytest.approx(2 * (1 + 9) / 2**9)


@given(st.lists(st.tuples(st.booleans(), st.booleans(), st.integers(0, 7)), max_size=40))
def test_mcnemar_of_worlds_is_the_enumeration_of_their_signs(pairs):
    first, second, world = ([pair[column] for pair in pairs] for column in range(3))
    sums = [sum(int(a) - int(b) for a, b, other in pairs if other == world_name) for world_name in set(world)]
    every = [
        abs(sum(s * d for s, d in zip(signs, sums, strict=True)))
        for signs in itertools.product((-1, 1), repeat=len(sums))
    ]
    expected = sum(world_name >= abs(sum(sums)) for world_name in every) / len(every)
    assert mcnemar(first, second, world).p_value == pytest.approx(expected)


def test_faults_of_one_world_are_no_independent_pairs():
    lost, saved = [True] * 30, [False] * 30
    assert mcnemar(lost, saved, ["w"] * 30).p_value == 1.0, "one world shows nothing"
    assert mcnemar(lost, saved, [index // 6 for index in range(30)]).p_value == pytest.approx(2 / 2**5)
    many = mcnemar(lost * 40, saved * 40, [index // 3 for index in range(1200)]).p_value
    assert math.isclose(many, 2 / 2**400, rel_tol=1e-9)


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
    return [index // per_world for index in range(n)]


def test_weighted_rate_finds_the_rate_of_the_population():
    """All of one stratum succeed, none of the other; the population is 3/16 to 13/16 of them."""
    success = [1] * 40 + [0] * 20
    rate = weighted_rate(success, [3 / 16] * 40 + [13 / 16] * 20, ["a"] * 40 + ["b"] * 20, worlds(60, 2))
    assert rate.rate == pytest.approx(3 / 16)
    assert rate.low <= 3 / 16 <= rate.high


@pytest.mark.parametrize("outcome", [0, 1])
def test_flights_that_all_end_alike_still_leave_doubt(outcome):
    plain = wilson(60 * outcome, 60)
    rate = weighted_rate([outcome] * 60, [1.0] * 60, ["a"] * 60, worlds(60, 2))
    assert (rate.low, rate.high) == pytest.approx((plain.low, plain.high))
    rate = weighted_rate([outcome] * 60, [0.2] * 40 + [0.8] * 20, ["a"] * 40 + ["b"] * 20, worlds(60, 2))
    assert rate.rate == pytest.approx(outcome)
    assert rate.high - rate.low > plain.high - plain.low


@pytest.mark.parametrize("failing", range(1, 16))
def test_a_stratum_without_failures_keeps_its_doubt_in_the_whole_word(failing):
    """60 flights of one stratum, of which some fail, and 30 of the other: no tighter than where none fails."""
    weights, strata = [3 / 16] * 60 + [13 / 16] * 30, ["a"] * 60 + ["b"] * 30
    none, some = (
        weighted_rate([0] * k + [1] * (90 - k), weights, strata, [*range(60), *range(30)]) for k in (0, failing)
    )
    alone = wilson(30, 30)
    assert some.high - some.low >= none.high - none.low
    assert some.rate - some.low >= 13 / 16 * (1 - alone.low)


def test_strata_that_fail_in_the_same_worlds_add_up():
    """Correlated strata leave more doubt than the same strata in worlds of their own."""
    success = [0] * 15 + [1] * 15
    arguments = [1.0] * 60, ["a"] * 30 + ["b"] * 30
    together = weighted_rate(success * 2, *arguments, [*range(30), *range(30)])
    apart = weighted_rate(success * 2, *arguments, list(range(60)))
    assert together.high - together.low > 1.2 * (apart.high - apart.low)


@given(st.lists(st.tuples(st.booleans(), st.integers(0, 9)), min_size=1, max_size=60))
def test_worlds_make_intervals_wider_never_narrower(flights):
    success, world = zip(*flights, strict=True)
    estimate, plain = clustered_rate(success, world), wilson(sum(success), len(success))
    assert (estimate.n, estimate.rate, estimate.successes) == (plain.n, plain.rate, plain.successes)
    assert estimate.low <= plain.low + 1e-9
    assert estimate.high >= plain.high - 1e-9
    alone = clustered_rate(success, range(len(success)))
    assert (alone.low, alone.high) == pytest.approx((plain.low, plain.high))


@given(st.lists(st.tuples(st.booleans(), st.booleans()), min_size=1, max_size=60))
def test_paired_difference_holds_the_estimate_and_turns_with_the_pairs(pairs):
    first, second = zip(*pairs, strict=True)
    difference, low, high = astuple(paired_difference(first, second, range(len(pairs))))
    assert difference == pytest.approx((sum(first) - sum(second)) / len(pairs))
    assert -1 <= low < difference + 1e-12
    assert difference - 1e-12 < high <= 1
    turned = astuple(paired_difference(second, first, range(len(pairs))))
    assert turned == pytest.approx((-difference, -high, -low))


def test_no_discordant_pair_leaves_the_doubt_of_so_many_pairs():
    bound = 1 - wilson(30, 30).low
    assert astuple(paired_difference([True] * 30, [True] * 30, range(30))) == pytest.approx((0.0, -bound, bound))


def test_paired_difference_covers():
    random = np.random.default_rng(3)
    kinds = random.choice(3, p=[0.85, 0.12, 0.03], size=(400, 60))
    inside = 0
    for row in kinds:
        difference = paired_difference(row != 2, row != 1, range(60))
        inside += difference.low <= 0.09 <= difference.high
    assert 0.92 < inside / 400 < 0.995


def of_worlds(lost, regained, n=100):
    """Golden always succeeds; fi loses the first missions, and the method brings some of them back."""
    return [(world, True, world >= lost, world >= lost or world < regained) for world in range(n)]


@pytest.mark.parametrize("regained", [0, 1, 15, 20])
def test_recovery_that_does_no_harm_is_a_binomial_share(regained):
    estimate = recovery(of_worlds(20, regained))
    assert estimate.loss.value == pytest.approx(0.2)
    assert 0 < estimate.loss.low < 0.2 < estimate.loss.high
    assert (estimate.lost, estimate.regained) == (20, regained)
    assert estimate.rate.rate == pytest.approx(regained / 20)
    low = beta.ppf(0.025, regained, 21 - regained) if regained else 0.0
    high = beta.ppf(0.975, regained + 1, 20 - regained) if regained < 20 else 1.0
    assert (estimate.rate.low, estimate.rate.high) == pytest.approx((low, high))
    assert estimate.rate.high - estimate.rate.low > 0.1


def test_harm_counts_against_a_method():
    pairs = [*of_worlds(20, 15)[:-5], *((world, True, True, False) for world in range(95, 100))]
    estimate = recovery(pairs)
    assert estimate.rate.rate == pytest.approx(0.5)
    assert estimate.rate.low < 0.5 < estimate.rate.high
    assert (estimate.lost, estimate.regained) == (20, 15)


@pytest.mark.parametrize("failing", [0, 1, 2])
def test_recovery_is_undefined_while_the_loss_may_be_nothing(failing):
    pairs = [(world, world != 50, world >= failing, True) for world in range(100)]
    estimate = recovery(pairs)
    assert estimate.rate.rate is None
    assert estimate.rate.low is None
    assert estimate.loss.low <= 0 <= estimate.loss.high


def test_recovery_of_nothing():
    assert recovery([]) is None


def test_alarms_that_come_together_leave_more_doubt_than_poisson_says():
    events = [1] * 25 + [30] * 5
    estimate, poisson_alone = event_rate_by_flight(events, [0.01] * 30), event_rate(175, 0.3)
    assert estimate.per_hour == pytest.approx(poisson_alone.per_hour)
    assert estimate.low < 0.8 * poisson_alone.low
    assert estimate.high > 1.2 * poisson_alone.high
    assert poisson_alone.upper < estimate.upper < estimate.high


@given(st.lists(st.integers(0, 4), min_size=1, max_size=30))
def test_alarm_rates_are_never_surer_than_poisson(events):
    estimate, poisson_alone = (
        event_rate_by_flight(events, [0.01] * len(events)),
        event_rate(sum(events), 0.01 * len(events)),
    )
    assert estimate.low <= poisson_alone.low + 1e-9
    assert estimate.high >= poisson_alone.high - 1e-9
    if not sum(events):
        assert estimate.upper == pytest.approx(poisson_alone.upper)


def test_smallest_difference_shrinks_with_n_and_is_the_textbooks():
    # 80 % power, 5 % two-sided: (1.960 + 0.842) sqrt(2 p (1 - p) / n)
    assert smallest_difference(0.5, 100, 100) == pytest.approx(2.8016 * math.sqrt(0.5 / 100), rel=1e-3)
    assert smallest_difference(0.9, 300, 300) < smallest_difference(0.9, 100, 300)
    assert smallest_difference(1.0, 30, 60) > 0
    assert smallest_difference(0.9, 0, 60) is None
