import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from mavfi.numerics.voxels import COORDINATE_LIMIT, FREE, Grid, first_blocked, usable, voxel_of
from tests.core.reference.kernels import naive

GRID = Grid(-1.5, -1.0, 0.0, 2.0, 9, 7, 5)
anything = st.floats(allow_nan=True, allow_infinity=True)
near = st.one_of(st.floats(-3.0, 4.0), st.integers(-24, 32).map(lambda n: n / 8.0))
points = st.tuples(near, near, near).map(np.array)
maps = st.builds(
    lambda seed, share: (np.random.default_rng(seed).random(GRID.size) < share).astype(np.int16),
    st.integers(0, 10_000),
    st.sampled_from([0.0, 0.02, 0.2]),
)


@given(anything, anything, anything)
def test_a_voxel_is_inside_of_the_grid_or_minus_one(x, y, z):
    voxel = voxel_of(GRID, x, y, z)
    assert -1 <= voxel < GRID.size
    expected = naive.cell_of(GRID, (x, y, z))
    assert voxel == (-1 if expected is None else naive.flat(GRID, expected))
    assert usable(x, y, z) == all(abs(value) < COORDINATE_LIMIT for value in (x, y, z))


@given(maps, st.integers(0, 2**32))
def test_a_free_way_is_free_in_both_directions(counter, seed):
    # uniform draws touch no edge or corner, where the two directions may differ
    a, b = np.random.default_rng(seed).uniform([-2.0, -1.5, -0.5], [3.5, 3.0, 3.0], (2, 3))
    there, back = first_blocked(counter, GRID, a, b, True), first_blocked(counter, GRID, b, a, True)
    assert (there == FREE) == (back == FREE)
