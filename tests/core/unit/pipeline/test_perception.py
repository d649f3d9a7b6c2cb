from dataclasses import replace

import numpy as np
import pytest

from mavfi.config import MapConfig
from mavfi.numerics.voxels import voxel_of
from mavfi.pipeline.clearance_map import ClearanceMap
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


def test_a_depth_image_becomes_a_cloud_in_the_world_frame():
    kernel = PointCloud(config())
    assert kernel.receive(depth(), 0)
    (cloud,) = kernel.step(0)
    points = cloud.elements.view(np.float32).reshape(3, 3)
    np.testing.assert_allclose(points, [[6, 5, 3], [6, 8, 3], [2 + 20, 5 - 15, 3]], atol=1e-5)
    assert floats(cloud.header, 3).tolist() == [2.0, 5.0, 3.0]


def clouds():
    kernel = PointCloud(config())
    for position in ((2.0, 5.0, 3.0), (2.5, 5.2, 3.0), (3.0, 4.8, 2.9)):
        kernel.receive(depth(position=position), 0)
        yield kernel.step(0)[0]


def octomap_kernel(kind):
    return OctoMap(replace(config(), map=MapConfig(kind=kind)))


@pytest.mark.parametrize("kind", MAPS)
def test_a_scan_that_is_taken_back_and_repeated_gives_the_same_update_and_map(kind):
    kernel = octomap_kernel(kind)
    for cloud in clouds():
        kernel.receive(cloud, 0)
        kernel.mark()
        before = kernel.map.log_odds.tobytes()
        first = kernel.step(0)
        after = kernel.map.log_odds.tobytes()
        kernel.rollback()
        assert kernel.map.log_odds.tobytes() == before != after
        assert same(first, kernel.step(0))
        assert kernel.map.log_odds.tobytes() == after


@pytest.mark.parametrize("kind", MAPS)
def test_the_update_carries_the_log_odds_of_the_map(kind):
    kernel = octomap_kernel(kind)
    for number, cloud in enumerate(clouds(), start=1):
        kernel.receive(cloud, 0)
        (update,) = kernel.step(0)
        assert int(update.header["scan"][0]) == number
        np.testing.assert_array_equal(kernel.map.log_odds[update.elements["voxel"]], update.elements["log_odds"])


def test_every_kind_of_map_gives_the_same_updates():
    kernels = [octomap_kernel(kind) for kind in MAPS]
    for cloud in clouds():
        for kernel in kernels:
            kernel.receive(cloud, 0)
        first, *others = [kernel.step(0) for kernel in kernels]
        assert all(same(first, other) for other in others) and len(first[0].elements) > 10


def at(grid, *point):
    return voxel_of(grid, *point)


@pytest.mark.parametrize("autopilot", AUTOPILOTS)
def test_updates_taken_back_leave_the_clearance_map_as_before(autopilot):
    clearance = ClearanceMap(config(autopilot))
    random = np.random.default_rng(0)
    clearance.apply(map_update(random.integers(0, clearance.grid.size, 400), random.normal(size=400)))
    clearance.mark()
    before = clearance.cells.copy(), clearance.wide.copy(), clearance.narrow.copy(), clearance.updates
    for _ in range(3):
        clearance.apply(map_update(random.integers(-9, clearance.grid.size + 9, 400), random.normal(size=400)))
    assert (clearance.wide != before[1]).any()
    clearance.rollback()
    np.testing.assert_array_equal(clearance.cells, before[0])
    np.testing.assert_array_equal(clearance.wide, before[1])
    np.testing.assert_array_equal(clearance.narrow, before[2])
    assert clearance.updates == before[3]
    clearance.rollback()
    np.testing.assert_array_equal(clearance.cells, before[0])


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


@pytest.mark.parametrize("autopilot", AUTOPILOTS)
def test_a_check_that_had_not_run_yet_works_on_the_latest_inputs(autopilot):
    fresh, other = checker(autopilot), checker(autopilot)
    grid = map_grid(config(autopilot))
    for kernel in (fresh, other):
        kernel.receive(map_update([]), 0)
        kernel.step(0)
        kernel.mark()
    other.rollback()  # an alarm at the cloud, before the map update came
    far = waypoint((6.0, 5.0, 3.0), index=4)
    far.header["trajectory_seq"] = 1
    results = []
    for kernel in (fresh, other):
        kernel.receive(far, 0)
        kernel.receive(map_update([at(grid, 9.0, 5.0, 3.0)]), 0)
        results.append(kernel.step(0))
    assert same(*results)


@pytest.mark.parametrize("index", [-1, 20, 2**31 - 1, -(2**31)])
def test_an_index_outside_of_the_trajectory_predicts_nothing(index):
    kernel = checker("published")
    point = waypoint(index=index)
    point.header["trajectory_seq"] = 1
    kernel.receive(point, 0)
    kernel.receive(map_update([]), 0)
    assert not kernel.step(0)[0].header["collision"][0]
