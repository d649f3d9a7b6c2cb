"""The network of all codes computes the outputs of one publication only: the same as those of the whole network."""

import numpy as np
import pytest

from mavfi.detectors.autoencoder import Network, residuals
from mavfi.extras.bench.all_fields import residuals_of_part

SIZES = (7, 5, 3, 7)


@pytest.fixture
def network():
    random = np.random.default_rng(5)
    count = sum((before + 1) * neurons for before, neurons in zip(SIZES, SIZES[1:], strict=False))
    return Network(random.uniform(0.5, 40.0, 7), np.array(SIZES), random.normal(0.0, 1.0, count), np.zeros((3, 7)))


@pytest.mark.parametrize(("first", "last"), [(0, 7), (0, 3), (2, 6), (6, 7)])
def test_the_errors_of_a_part_are_those_of_the_whole(network, first, last):
    vector = np.array([3, -20, 0, 150, -7, 32767, -32768], np.int16)
    whole, part = np.zeros(7), np.full(7, -1.0)
    residuals(vector, network, whole)
    residuals_of_part(vector, network, first, last, part)
    assert part[first:last] == pytest.approx(whole[first:last], rel=1e-13, abs=1e-13)
    assert (np.delete(part, np.arange(first, last)) == -1.0).all(), "others are not computed"
