"""Lengths and products against numpy's."""

import math

import numpy as np
import pytest

from mavfi.numerics.vectors import length, product


@pytest.mark.parametrize("n", [0, 1, 3, 7, 64])
def test_a_length_is_numpys_to_rounding(n):
    vector = np.random.default_rng(n).normal(size=n)
    assert length(vector) == pytest.approx(np.linalg.norm(vector), rel=1e-14)


@pytest.mark.parametrize(
    ("vector", "wanted"), [((3.0, 4.0), 5.0), ((math.inf, 0.0), math.inf), ((1e300, 0.0), math.inf)]
)
def test_lengths_of_special_values(vector, wanted):
    with np.errstate(over="ignore"):
        assert length(np.array(vector)) == wanted
        assert math.isnan(length(np.array([math.nan, 1.0])))


@pytest.mark.parametrize(("n", "k", "m"), [(1, 1, 1), (3, 4, 5), (8, 4, 8), (2, 0, 2)])
def test_a_product_is_the_sum_of_its_terms_in_their_order(n, k, m):
    random = np.random.default_rng(n + k + m)
    a, b = random.normal(size=(n, k)), random.normal(size=(k, m))
    naive = [[0.0] * m for _ in range(n)]
    for i in range(n):
        for j in range(m):
            for x in range(k):
                naive[i][j] += a[i, x] * b[x, j]
    np.testing.assert_array_equal(product(a, b), np.array(naive))
    np.testing.assert_allclose(product(a, b), a @ b, rtol=1e-13, atol=1e-14)
