"""The depth camera."""

import math

import numpy as np
import pytest

from mavfi.config import CameraConfig
from mavfi.sim.camera import Camera
from tests.core.unit.sim.flights import open_world, room

LEVEL = (1.0, 0.0, 0.0, 0.0)


def capture(world, position, quaternion=LEVEL, time_us=0, key=1, **options):
    camera = Camera(CameraConfig(**options), world, key)
    return camera.directions, camera.capture(np.array([*position, *quaternion]), time_us)


def test_what_is_out_of_range_does_not_return():
    world = open_world(lower=[(8.0, -90.0, 0.0)], upper=[(9.0, 90.0, 90.0)])
    assert np.isinf(capture(world, (1.0, 0.0, 40.0), range=6.9)[1]).all()
    assert np.isfinite(capture(world, (1.0, 0.0, 40.0), range=7.2)[1]).any()


@pytest.mark.parametrize("world", (open_world(lower=[(1.0, -9.0, 0.0)], upper=[(2.0, 9.0, 90.0)]), room()))
@pytest.mark.parametrize("value", (math.nan, math.inf, 1e30, -1e300))
@pytest.mark.parametrize("field", range(3))
def test_an_absurd_position_ends_and_invents_no_range(world, value, field):
    position = [2.0, 2.0, 2.0]
    position[field] = value
    ranges = capture(world, position)[1]
    assert not np.isnan(ranges).any()


def test_noise_is_proportional_and_addressed_by_the_instant():
    world = open_world(lower=[(8.0, -90.0, 0.0)], upper=[(9.0, 90.0, 90.0)])
    position = (1.0, 0.0, 40.0)
    _, clean = capture(world, position)
    _, noisy = capture(world, position, time_us=40_000, noise=0.05)
    assert np.std(noisy / clean) == pytest.approx(0.05, rel=0.1)
    np.testing.assert_array_equal(noisy, capture(world, position, time_us=40_000, noise=0.05)[1])
    assert (noisy != capture(world, position, time_us=44_000, noise=0.05)[1]).any()
    assert (noisy != capture(world, position, time_us=40_000, noise=0.05, key=2)[1]).any()
