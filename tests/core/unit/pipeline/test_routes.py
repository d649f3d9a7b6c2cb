import numpy as np
import pytest

from mavfi.numerics.voxels import segment_free
from mavfi.pipeline.routes import Routes
from tests.core.unit.pipeline.parts import config, map_update

START, STILL = np.array([2.0, 5.0, 3.0]), np.zeros(3)


def routes(*, gap=None, wall=True, **rules):
    """A wall across the arena with a passage at its end, and one of `gap` voxels in its middle."""
    finder = Routes(config("hardened", **{"searches": 3, **rules}))
    grid = finder.clearance_map.grid
    finder.clearance_map.apply(map_update(np.arange(grid.size), -1.0))
    middle = grid.ny // 2
    solid = [
        (30 * grid.ny + iy) * grid.nz + iz
        for iy in range(19, grid.ny)
        for iz in range(grid.nz)
        if gap is None or abs(iy - middle) > gap // 2
    ]
    if wall:
        finder.clearance_map.apply(map_update(solid))
    return finder


def test_a_wide_way_keeps_the_planners_radius_and_the_flight_box():
    finder = routes()
    path = finder.fastest(START, STILL)
    assert len(path) > 2
    clearance, config_ = finder.clearance_map, finder._config
    assert all(segment_free(clearance.wide, clearance.grid, a, b) for a, b in zip(path[:-1], path[1:], strict=True))
    assert ((path >= config_.flight_lower - 1e-9) & (path <= config_.flight_upper + 1e-9)).all()
    np.testing.assert_array_equal(path[0], START)


@pytest.mark.parametrize(("gap", "tight"), [(6, False), (4, True)])
def test_a_narrow_passage_is_flown_only_where_there_is_no_room_for_more(gap, tight):
    finder = routes(gap=gap)
    grid = finder.clearance_map.grid
    closed = [(30 * grid.ny + iy) * grid.nz + iz for iy in range(19) for iz in range(grid.nz)]
    finder.clearance_map.apply(map_update(closed))
    path = finder.fastest(START, STILL)
    legs = list(zip(path[:-1], path[1:], strict=True))
    assert all(segment_free(finder.clearance_map.narrow, grid, a, b) for a, b in legs)
    assert all(segment_free(finder.clearance_map.wide, grid, a, b) for a, b in legs) == (not tight)


def test_no_way_is_no_path():
    finder = routes()
    grid = finder.clearance_map.grid
    finder.clearance_map.apply(
        map_update([(30 * grid.ny + iy) * grid.nz + iz for iy in range(19) for iz in range(grid.nz)])
    )
    assert finder.fastest(START, STILL) is None
    assert finder.first_found(START) is None
