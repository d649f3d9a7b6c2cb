import numpy as np
import pytest

from mavfi.numerics import welford


@pytest.mark.parametrize("offset", [0.0, 1e3, 1e9])
def test_mean_and_deviation_are_those_of_numpy_even_far_from_zero(offset):
    values = np.random.default_rng(1).normal(size=20_000) + offset
    count, mean, squares = welford.accumulate(values)
    assert count == len(values)
    assert mean == pytest.approx(values.mean(), rel=1e-14, abs=1e-12)
    assert welford.deviation(count, squares) == pytest.approx((values - offset).std(ddof=1), rel=1e-7)
