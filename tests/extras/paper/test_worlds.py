import operator

import numpy as np
import polars as pl
import pytest

from mavfi.analysis.runs import Runs
from mavfi.extras.paper.worlds import between_worlds, contrast, within_worlds

VALUE = pl.col("value")


def runs(worlds, values):
    return Runs(pl.DataFrame({"world": worlds, "value": values}, schema={"world": pl.String, "value": pl.Float64}))


def test_signs_of_differences_of_worlds():
    worlds = [f"w{number}" for number in range(6)]
    p_value = within_worlds(runs(worlds, [1.0] * 6), runs(worlds, [0.0] * 6), VALUE)
    assert (p_value.first.value, p_value.second.value, p_value.worlds, p_value.difference) == (1.0, 0.0, 6, 1.0)
    assert p_value.p_value == pytest.approx(2 / 2**6), "exact: two of 64 patterns of signs are as extreme"


def test_many_flights_of_one_world_prove_nothing():
    faster = runs(["w"] * 100, [1.0] * 100)
    assert within_worlds(faster, runs(["w"] * 100, [0.0] * 100), VALUE).p_value is None
    assert within_worlds(faster, runs(["other"], [0.0]), VALUE) is None, "no world in common"


def test_different_worlds_are_shuffled():
    p_value = between_worlds(runs(list("abcd"), [1.0] * 4), runs(list("efgh"), [0.0] * 4), VALUE)
    assert p_value.difference == 1.0
    assert p_value.p_value == pytest.approx(2 / 70), "exact: two of the 70 divisions"


@pytest.mark.slow
@pytest.mark.long
def test_the_level_is_kept_where_nothing_differs():
    random = np.random.default_rng(1)
    worlds = [f"w{number}" for number in range(12)]
    values = random.random((200, 2, 12)) < 0.8
    p_values = [within_worlds(runs(worlds, first), runs(worlds, other), VALUE) for first, other in values.astype(float)]
    assert np.mean([first.p_value < 0.05 for first in p_values]) <= 0.08


def test_a_contrast_of_quantiles_swaps_whole_worlds():
    worlds = list("aabbccdd")
    slower, other = runs(worlds, [2.0] * 8), runs(worlds, [1.0] * 8)
    p_value = contrast((slower, other), "value", 1.0, operator.sub)
    assert (p_value.rate, p_value.low, p_value.high, p_value.n) == (1.0, 1.0, 1.0, 4)
    assert p_value.p_value == pytest.approx(2 / 2**4), "flights of one world are swapped together"
    assert contrast((slower, runs(worlds, [1.0, None] * 4)), "value", 1.0, operator.truediv).rate == 2.0
    assert contrast((slower, runs(["a"], [None])), "value", 1.0, operator.sub) is None
    assert contrast((runs(["a"], [1.0]), runs(["a"], [0.0])), "value", 1.0, operator.sub).p_value is None
