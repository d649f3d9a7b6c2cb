import operator

import numpy as np
import polars as pl
import pytest

from mavfi.analysis.runs import Runs
from mavfi.analysis.statistics import quantiles, wilson
from mavfi.extras.paper.worlds import between_worlds, contrast, within_worlds

VALUE = pl.col("value")


def runs(worlds, values):
    return Runs(pl.DataFrame({"world": worlds, "value": values}, schema={"world": pl.String, "value": pl.Float64}))


def test_signs_of_differences_of_worlds():
    worlds = [f"w{place}" for place in range(6)]
    found = within_worlds(runs(worlds, [1.0] * 6), runs(worlds, [0.0] * 6), VALUE)
    assert (found.first.value, found.second.value, found.worlds, found.difference) == (1.0, 0.0, 6, 1.0)
    assert found.p_value == pytest.approx(2 / 2**6), "exact: two of 64 patterns of signs are as extreme"


def test_many_flights_of_one_world_prove_nothing():
    one = runs(["w"] * 100, [1.0] * 100)
    assert within_worlds(one, runs(["w"] * 100, [0.0] * 100), VALUE).p_value is None
    assert within_worlds(one, runs(["other"], [0.0]), VALUE) is None, "no world in common"


def test_different_worlds_are_shuffled():
    found = between_worlds(runs(list("abcd"), [1.0] * 4), runs(list("efgh"), [0.0] * 4), VALUE)
    assert found.difference == 1.0
    assert found.p_value == pytest.approx(2 / 70), "exact: two of the 70 divisions"


@pytest.mark.slow
def test_the_level_is_kept_where_nothing_differs():
    random = np.random.default_rng(1)
    worlds = [f"w{place}" for place in range(12)]
    values = random.random((200, 2, 12)) < 0.8
    found = [within_worlds(runs(worlds, one), runs(worlds, other), VALUE) for one, other in values.astype(float)]
    assert np.mean([one.p_value < 0.05 for one in found]) <= 0.08


def test_a_rate_has_wilsons_interval_and_another_mean_that_of_a_bootstrap():
    worlds = list("abcdefghij")
    one, other = runs(worlds, [1.0] * 10), runs(worlds, [float(place) for place in range(10)])
    rate = wilson(10, 10)
    assert within_worlds(one, other, VALUE > 0).first.bounds == (rate.low, rate.high)
    assert within_worlds(one, other, VALUE).first.bounds == (1.0, 1.0), "no rate, whatever its values"
    low, high = within_worlds(one, other, VALUE).second.bounds
    half = 1.96 * np.std(range(10)) / 10**0.5
    assert (low, high) == (pytest.approx(4.5 - half, abs=0.2), pytest.approx(4.5 + half, abs=0.2))
    alike = within_worlds(runs(["a"] * 5 + ["b"] * 5, range(10)), runs(list("ab"), [0.0] * 2), VALUE).first.bounds
    assert alike[0] < low and alike[1] > high, "two worlds say less than ten"
    single = within_worlds(runs(["a"] * 3, [1.0, 2.0, 3.0]), runs(["a"], [0.0]), VALUE)
    assert single.first.bounds is None and single.p_value is None


def test_a_contrast_of_quantiles_swaps_whole_worlds():
    worlds = list("aabbccdd")
    one, other = runs(worlds, [2.0] * 8), runs(worlds, [1.0] * 8)
    found = contrast((one, other), "value", 1.0, operator.sub)
    assert (found.rate, found.low, found.high, found.n) == (1.0, 1.0, 1.0, 4)
    assert found.p_value == pytest.approx(2 / 2**4), "flights of one world are swapped together"
    assert contrast((one, runs(worlds, [1.0, None] * 4)), "value", 1.0, operator.truediv).rate == 2.0
    assert contrast((one, runs(["a"], [None])), "value", 1.0, operator.sub) is None
    assert contrast((runs(["a"], [1.0]), runs(["a"], [0.0])), "value", 1.0, operator.sub).p_value is None


@pytest.mark.parametrize("share", [0.0, 0.3, 0.95, 1.0])
def test_quantiles_of_counted_values_are_those_of_numpy(share):
    random = np.random.default_rng(1)
    values, counts = np.sort(random.normal(size=9)), random.integers(0, 4, size=(20, 9))
    expected = [np.quantile(np.repeat(values, row), share) for row in counts]
    assert quantiles(values, counts, share) == pytest.approx(expected)
    assert np.isnan(quantiles(values, np.zeros((1, 9), int), share)).all(), "no values"
