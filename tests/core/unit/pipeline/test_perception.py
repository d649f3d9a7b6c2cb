from dataclasses import replace

import numpy as np
import pytest

from mavfi.config import MapConfig
from mavfi.numerics.voxels import voxel_of
from mavfi.pipeline.kernel import map_grid
from mavfi.pipeline.maps import MAPS
from mavfi.pipeline.perception import CollisionCheck, OctoMap, PointCloud
from mavfi.states import floats, new_state
from tests.core.unit.pipeline.parts import AUTOPILOTS, config, map_update, odometry, same, trajectory, waypoint


def depth(ranges=(4.0, 5.0, np.inf), position=(2.0, 5.0, 3.0)):
    state = new_state("sensor.depth", len(ranges))
    floats(state.header, 7)[:] = [*position, 1.0, 0.0, 0.0, 0.0]
    state.elements["range"] = ranges
    return state


def clouds():
    kernel = PointCloud(config())
    for position in ((2.0, 5.0, 3.0), (2.5, 5.2, 3.0), (3.0, 4.8, 2.9)):
        kernel.receive(depth(position=position), 0)
        yield kernel.step(0)[0]


def octomap_kernel(kind):
    return OctoMap(replace(config(), map=MapConfig(kind=kind)))


def test_every_kind_of_map_gives_the_same_updates():
    kernels = [octomap_kernel(kind) for kind in MAPS]
    for cloud in clouds():
        for kernel in kernels:
            kernel.receive(cloud, 0)
        first, *others = [kernel.step(0) for kernel in kernels]
        assert all(same(first, other) for other in others) and len(first[0].elements) > 10


def at(grid, *point):
    return voxel_of(grid, *point)


def checker(autopilot):
    kernel = CollisionCheck(config(autopilot))
    path = trajectory(count=20, period=0.5 if autopilot == "published" else 0.1)
    point = waypoint()
    point.header["trajectory_seq"] = 1
    for state in (odometry(), path, point):
        kernel.receive(state, 0)
    return kernel


@pytest.mark.parametrize("autopilot", AUTOPILOTS)
def test_an_obstacle_on_the_trajectory_is_predicted_once_for_each_epoch(autopilot):
    kernel = checker(autopilot)
    grid = map_grid(config(autopilot))
    assert kernel.receive(map_update([at(grid, 4.0, 5.0, 3.0)], -1.0), 0)
    (free,) = kernel.step(0)
    assert not free.header["collision"][0] and free.header["time_to_collision"][0] == 30.0
    kernel.receive(free, 0)
    kernel.receive(map_update([at(grid, 5.0, 5.0, 3.0)]), 0)
    (hit,) = kernel.step(0)
    assert hit.header["collision"][0] and int(hit.header["future_collision_seq"][0]) == 1
    assert 0.0 <= hit.header["time_to_collision"][0] < 2.0
    kernel.receive(hit, 0)
    kernel.receive(map_update([]), 0)
    (next_,) = kernel.step(0)
    assert bool(next_.header["collision"][0]) == (autopilot == "hardened")  # published waits for an answer


def test_counting_continues_from_whatever_was_published():
    kernel = checker("hardened")
    grid = map_grid(config("hardened"))
    kernel.receive(map_update([at(grid, 5.0, 5.0, 3.0)]), 0)
    (hit,) = kernel.step(0)
    hit.header["future_collision_seq"] = 2**31 - 1
    kernel.receive(hit, 0)
    kernel.receive(map_update([]), 0)
    assert int(kernel.step(0)[0].header["future_collision_seq"][0]) == -(2**31)


@pytest.mark.parametrize("autopilot", AUTOPILOTS)
def test_a_check_that_is_repeated_works_on_the_inputs_of_the_first_time(autopilot):
    kernel = checker(autopilot)
    grid = map_grid(config(autopilot))
    update = map_update([at(grid, 6.0, 5.0, 3.0)])
    kernel.mark()
    kernel.receive(update, 0)
    first = kernel.step(0)
    kernel.rollback()
    kernel.receive(odometry((3.0, 6.0, 3.0)), 0)
    kernel.receive(update, 0)
    assert same(first, kernel.step(0))
