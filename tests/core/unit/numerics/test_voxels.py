import numpy as np
import pytest

from mavfi.numerics.voxels import COORDINATE_LIMIT, FREE, Grid, first_blocked, offsets_within, usable, voxel_of

GRID = Grid(-1.0, -1.0, 0.0, 2.0, 8, 6, 4)
BAD = [np.nan, np.inf, -np.inf, 1e30, 1e300, -1e300, COORDINATE_LIMIT, -COORDINATE_LIMIT]


@pytest.mark.parametrize(
    ("point", "voxel"),
    [
        ((-1.0, -1.0, 0.0), 0),
        ((-0.51, -0.51, 0.49), 0),
        ((-1.0, -1.0, 0.5), 1),
        ((-1.0, -0.5, 0.0), 4),
        ((-0.5, -1.0, 0.0), 24),
        ((2.99, 1.99, 1.99), 191),
        ((3.0, 1.0, 1.0), -1),
        ((0.0, 0.0, -1e-9), -1),
    ],
)
def test_a_point_lies_in_the_voxel_whose_lower_faces_it_may_touch(point, voxel):
    assert voxel_of(GRID, *point) == voxel


@pytest.mark.parametrize("value", BAD)
@pytest.mark.parametrize("axis", range(3))
def test_unusable_points_have_no_voxel_and_block_where_the_outside_does(axis, value):
    point = np.zeros(3)
    point[axis] = value
    assert not usable(*point) and voxel_of(GRID, *point) == -1
    free, good = np.zeros(GRID.size, np.int16), np.array([0.1, 0.1, 0.1])
    for a, b in ((point, good), (good, point), (point, point)):
        assert first_blocked(free, GRID, a, b, True) == 0.0
        assert first_blocked(free, GRID, a, b, False) == FREE


def test_leaving_the_grid_blocks_only_if_asked_and_the_walk_continues_behind():
    counter = np.zeros(GRID.size, np.int16)
    a, b = np.array([-3.0, 0.25, 0.75]), np.array([1.25, 0.25, 0.75])
    assert first_blocked(counter, GRID, a, b, True) == 0.0
    assert first_blocked(counter, GRID, a, b, False) == FREE
    counter[voxel_of(GRID, *b)] = 1
    assert first_blocked(counter, GRID, a, b, False) == pytest.approx(4.0 / 4.25)


@pytest.mark.parametrize("tiny", [5e-324, -5e-324, 1e-310, -1e-310, 1e-301])
@pytest.mark.parametrize("axis", [1, 2])
def test_a_denormal_slope_does_not_lead_the_walk_astray(tiny, axis):
    grid = Grid(0.0, 0.0, 0.0, 1.0, 8, 4, 4)
    counter = np.zeros(grid.size, np.int16)
    counter[voxel_of(grid, 5.5, 0.0, 0.0)] = 1
    a, b = np.zeros(3), np.array([7.5, 0.0, 0.0])
    a[0] = 0.5
    b[axis] = abs(tiny)
    a[axis] = abs(tiny) - tiny if tiny > 0 else -2 * tiny
    assert first_blocked(counter, grid, a, b, False) == pytest.approx(4.5 / 7.0)


@pytest.mark.parametrize("radius", [0.2, 0.5, 0.9, 1.4])
def test_offsets_are_all_voxels_within_the_radius(radius):
    reach = range(-5, 6)
    every = [(x, y, z) for x in reach for y in reach for z in reach]
    centres = {o for o in every if 0.5 * np.linalg.norm(o) <= radius}
    boxes = {o for o in every if 0.5 * np.linalg.norm(np.maximum(np.abs(o) - 1, 0)) < radius}
    assert {tuple(o) for o in offsets_within(radius, 0.5, False).tolist()} == centres
    assert {tuple(o) for o in offsets_within(radius, 0.5, True).tolist()} == boxes
    assert centres < boxes
