import numpy as np
import pytest

from mavfi.numerics.voxels import FREE, first_blocked, segment_free
from tests.core.reference.kernels import naive, scenes


@pytest.mark.parametrize("outside", [False, True])
@pytest.mark.parametrize("share", [0.0, 0.02, 0.2])
def test_the_walk_enters_the_first_blocked_voxel_where_the_exact_crossings_say(share, outside):
    random = np.random.default_rng(7)
    blocked = 0
    for _ in range(300):
        counter = scenes.counter(random, share)
        a, b = scenes.point(random, 1.0), scenes.point(random, 1.0)
        if random.random() < 0.2:
            b[random.integers(3)] = a[random.integers(3)]
        expected = naive.first_blocked(counter, scenes.GRID, a, b, outside)
        fraction = first_blocked(counter, scenes.GRID, a, b, outside)
        assert fraction == pytest.approx(expected, abs=1e-9)
        blocked += fraction < FREE
    assert (0 < blocked < 300) or (share == 0.0 and not outside)


def test_a_segment_is_free_when_no_voxel_on_it_is_blocked():
    random = np.random.default_rng(8)
    for _ in range(200):
        counter = scenes.counter(random, 0.05)
        a, b = scenes.point(random), scenes.point(random)
        assert segment_free(counter, scenes.GRID, a, b) == (naive.first_blocked(counter, scenes.GRID, a, b, True) > 1.0)
