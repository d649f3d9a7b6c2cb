"""Contact of a sphere with voxels."""

import math

import numpy as np
import pytest

from mavfi.sim.vehicle import sphere_touches_voxels


def touches(centre, radius=0.3, solid=((5, 5, 5),)):
    occupied = np.zeros((10, 10, 10), bool)
    for voxel in solid:
        occupied[voxel] = True
    return sphere_touches_voxels(np.array(centre, float), radius, occupied, np.array([-1.0, 0.0, 0.0]), 0.5)


@pytest.mark.parametrize(
    ("centre", "expected"),
    (
        ((1.75, 2.75, 2.75), True),  # in the middle of the voxel
        ((1.21, 2.75, 2.75), True),  # its face is at 1.5
        ((1.19, 2.75, 2.75), False),
        ((1.32, 2.32, 2.75), True),  # across an edge: 0.18 sqrt(2) = 0.25
        ((1.28, 2.28, 2.75), False),
        ((1.31, 2.31, 2.31), False),  # across a corner: 0.19 sqrt(3) = 0.33
    ),
)
def test_distance_to_the_box_of_the_voxel_decides(centre, expected):
    assert touches(centre) is expected


@pytest.mark.parametrize("centre", ((-1.2, 2.0, 2.0), (2.0, 4.9, 2.0), (2.0, 2.0, 1e300), (math.nan, 2.0, 2.0)))
def test_outside_of_the_grid_is_solid(centre):
    assert touches(centre, solid=())
