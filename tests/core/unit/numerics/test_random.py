import numpy as np
import pytest

from mavfi.numerics.random import seed_generator, uniform
from tests.core.reference.kernels.naive import Xoshiro


@pytest.mark.parametrize("seed", [0, 1, 7, 2**40])
def test_the_sequence_is_that_of_xoshiro256_plus(seed):
    state = seed_generator(seed, 1)
    twin = Xoshiro(state)
    assert [uniform(state) for _ in range(1000)] == [twin.uniform() for _ in range(1000)]
    assert [int(word) for word in state] == twin.s


def test_the_first_numbers_of_a_known_state():
    state = np.array([1, 2, 3, 4], np.uint64)
    assert uniform(state) == (5 >> 11) / 2**53 == 0.0
    assert [int(word) for word in state] == [7, 0, 262146, 6 << 45]


def test_numbers_are_spread_evenly_over_the_unit_interval():
    state = seed_generator(3)
    values = np.array([uniform(state) for _ in range(20_000)])
    assert values.min() >= 0.0 and values.max() < 1.0
    counts, _ = np.histogram(values, 20, (0.0, 1.0))
    assert ((counts - 1000) ** 2 / 1000).sum() < 50.0  # chi-square, 19 degrees of freedom: p < 0.0002


def test_a_copied_state_continues_the_same():
    state = seed_generator(5, 1)
    uniform(state)
    copy = state.copy()
    assert [uniform(state) for _ in range(5)] == [uniform(copy) for _ in range(5)]


def test_each_address_has_its_own_stream():
    addresses = [(), (0,), (1,), (1, 0), (1, 1), (2,)]
    firsts = {uniform(seed_generator(9, *address)) for address in addresses}
    assert len(firsts) == len(addresses)
    assert uniform(seed_generator(9, 1)) == uniform(seed_generator(9, 1))
    assert seed_generator(0).any()
