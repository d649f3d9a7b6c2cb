import pytest

from mavfi.numerics.random import seed_generator, uniform
from tests.core.reference.kernels.naive import Xoshiro


@pytest.mark.parametrize("seed", [0, 1, 7, 2**40])
def test_the_sequence_is_that_of_xoshiro256_plus(seed):
    state = seed_generator(seed, 1)
    twin = Xoshiro(state)
    assert [uniform(state) for _ in range(1000)] == [twin.uniform() for _ in range(1000)]
    assert [int(word) for word in state] == twin.s


def test_each_address_has_its_own_stream():
    addresses = [(), (0,), (1,), (1, 0), (1, 1), (2,)]
    firsts = {uniform(seed_generator(9, *address)) for address in addresses}
    assert len(firsts) == len(addresses)
    assert uniform(seed_generator(9, 1)) == uniform(seed_generator(9, 1))
    assert seed_generator(0).any()
