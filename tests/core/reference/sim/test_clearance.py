"""Clearances against an obvious computation over all boxes and voxels."""

import numpy as np
import pytest

from mavfi.sim.environments.generated import clutter
from mavfi.sim.environments.world import World
from mavfi.sim.vehicle import sphere_touches_voxels


def to_boxes(points, lower, upper):
    beyond = np.maximum(np.maximum(lower[None] - points[:, None], points[:, None] - upper[None]), 0.0)
    return np.sqrt((beyond**2).sum(axis=-1)).min(axis=1)


@pytest.mark.parametrize("seed", range(3))
def test_boxes(seed):
    world = clutter(seed)
    points = np.random.default_rng(seed).uniform((-10.0, -40.0, -1.0), (130.0, 40.0, 20.0), (500, 3))
    expected = np.minimum(to_boxes(points, world.lower, world.upper), np.maximum(points[:, 2], 0.0))
    np.testing.assert_allclose(world.clearance(points), expected, atol=1e-12)


@pytest.mark.parametrize("density", (0.0, 0.002, 0.05))
def test_voxels(density):
    stream = np.random.default_rng(5)
    shape, origin, resolution = (20, 14, 10), np.array([-2.0, 1.0, 0.5]), 0.25
    occupied = stream.random(shape) < density
    occupied[0, 0, 0] = True
    upper = origin + resolution * np.array(shape)
    world = World(origin, origin, origin, upper, origin, upper, occupied=occupied, origin=origin, resolution=resolution)
    points = stream.uniform(origin, upper, (400, 3))
    corners = origin + resolution * np.argwhere(occupied)
    walls = np.minimum(points - origin, upper - points).min(axis=1)
    expected = np.minimum(to_boxes(points, corners, corners + resolution), walls)
    np.testing.assert_allclose(world.clearance(points), expected, atol=1e-12)
    for radius in (0.1, 0.4):
        touched = [sphere_touches_voxels(point, radius, occupied, origin, resolution) for point in points]
        np.testing.assert_array_equal(touched, expected < radius)
