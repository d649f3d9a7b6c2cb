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


@given(maps, points, points, st.booleans())
def test_the_walk_misses_no_block_and_finds_no_block_that_is_not_there(counter, a, b, outside):
    share = first_blocked(counter, GRID, a, b, outside)
    stretches = naive.intervals(GRID, a, b)

    def blocks(cell):
        return outside if cell is None else counter[naive.flat(GRID, cell)] > 0

    certain = [start for start, length, cell in stretches if blocks(cell) and length > 1e-9]
    if certain:  # touching an edge or a corner may count as entering: never later than the first real stretch
        assert share <= certain[0] + 1e-9
    assert share == FREE or -1e-9 <= share <= 1.0 + 1e-9
    if share < FREE and not certain:
        middle = a + (b - a) * min(max(share, 0.0), 1.0)
        low, high = ((middle - (GRID.x0, GRID.y0, GRID.z0) + d) * GRID.inverse for d in (-1e-6, 1e-6))
        around = {
            (x, y, z)
            for x in {int(np.floor(low[0])), int(np.floor(high[0]))}
            for y in {int(np.floor(low[1])), int(np.floor(high[1]))}
            for z in {int(np.floor(low[2])), int(np.floor(high[2]))}
        }
        inside = [c for c in around if all(0 <= i < n for i, n in zip(c, (GRID.nx, GRID.ny, GRID.nz), strict=True))]
        assert (outside and len(inside) < len(around)) or any(blocks(cell) for cell in inside)


@given(maps, st.integers(0, 2**32))
def test_a_free_way_is_free_in_both_directions(counter, seed):
    # uniform draws touch no edge or corner, where the two directions may differ
    a, b = np.random.default_rng(seed).uniform([-2.0, -1.5, -0.5], [3.5, 3.0, 3.0], (2, 3))
    there, back = first_blocked(counter, GRID, a, b, True), first_blocked(counter, GRID, b, a, True)
    assert (there == FREE) == (back == FREE)
