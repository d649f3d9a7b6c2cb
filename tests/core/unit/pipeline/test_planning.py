import numpy as np
import pytest

from mavfi.numerics.voxels import segment_free
from mavfi.pipeline.planning import MotionPlanner
from mavfi.pipeline.trajectories import TrajectoryGenerator
from mavfi.states import new_state, rows
from tests.core.unit.pipeline.parts import AUTOPILOTS, config, map_update, odometry, status, waypoint


def planner(autopilot="published", **rules):
    """A planner behind whose start a wall with a gap stands."""
    kernel = MotionPlanner(config(autopilot, **rules))
    grid = kernel.clearance_map.grid
    wall = [(ix * grid.ny + iy) * grid.nz + iz for ix in (30,) for iy in range(19, grid.ny) for iz in range(grid.nz)]
    everything = np.arange(grid.size)
    kernel.receive(map_update(everything, -1.0), 0)
    kernel.receive(map_update(wall), 0)
    kernel.receive(odometry(), 0)
    return kernel


def request(kernel, autopilot):
    held = waypoint(index=-1)
    kernel.receive(held, 0)
    return kernel.receive(status() if autopilot == "hardened" else odometry(), 600_000)


@pytest.mark.parametrize("autopilot", AUTOPILOTS)
def test_a_plan_is_wanted_when_nothing_is_flown_and_leads_around_the_wall(autopilot):
    kernel = planner(autopilot, distance="centres", plan_radius=0.6, check_radius=0.36)
    assert request(kernel, autopilot)
    (path,) = kernel.step(600_000)
    vertices = rows(path.elements, 3)
    np.testing.assert_allclose(vertices[0], [2.0, 5.0, 3.0])
    np.testing.assert_allclose(vertices[-1], kernel._config.goal, atol=2e-3)
    for a, b in zip(vertices[:-1], vertices[1:], strict=True):
        assert segment_free(kernel.clearance_map.wide, kernel.clearance_map.grid, a, b)
    assert vertices[:, 1].min() < 4.0


def test_no_plan_is_wanted_before_the_first_map():
    kernel = MotionPlanner(config())
    kernel.receive(waypoint(index=-1), 0)
    assert not kernel.receive(odometry(), 600_000)


@pytest.mark.parametrize("autopilot", AUTOPILOTS)
def test_a_closed_wall_gives_an_empty_path_and_an_empty_trajectory(autopilot):
    kernel = planner(autopilot)
    grid = kernel.clearance_map.grid
    wall = [(30 * grid.ny + iy) * grid.nz + iz for iy in range(grid.ny) for iz in range(grid.nz)]
    kernel.receive(map_update(wall), 0)
    assert request(kernel, autopilot)
    (path,) = kernel.step(600_000)
    assert len(path.elements) == 0
    generator = TrajectoryGenerator(kernel._config, kernel.clearance_map)
    assert generator.receive(path, 0)
    assert len(generator.step(0)[0].elements) == 0


def test_a_new_collision_makes_a_step_due_once():
    kernel = planner()
    kernel.receive(waypoint(index=3), 0)
    assert not kernel.receive(odometry(), 600_000)
    kernel.receive(status(seq=1, time=4.0, collision=True), 600_000)
    assert kernel.receive(odometry(), 620_000)
    (path,) = kernel.step(620_000)
    assert int(path.header["future_collision_seq"][0]) == 1
    kernel.receive(status(seq=1, time=4.0, collision=True), 640_000)
    assert not kernel.receive(odometry(), 660_000)
    kernel.receive(status(seq=0, time=4.0, collision=True), 680_000)
    assert not kernel.receive(odometry(), 700_000)


def generator(autopilot="published"):
    kernel = planner(autopilot)
    kernel_config = kernel._config
    return TrajectoryGenerator(kernel_config, kernel.clearance_map)


def path(*vertices, entry=0.0):
    state = new_state("planning.path", len(vertices))
    rows(state.elements, 3)[:] = vertices
    state.header["junction"], state.header["entry_speed"] = -1, entry
    return state


LEGS = ((2.0, 5.0, 3.0), (8.0, 5.0, 3.0), (12.0, 2.0, 3.0), (17.0, 5.0, 3.0))


@pytest.mark.parametrize(("autopilot", "slower"), [("published", False), ("hardened", True)])
def test_narrow_places_slow_hardened_flights_only(autopilot, slower):
    kernel = generator(autopilot)
    durations = []
    for narrow in (0, 1):
        kernel._clearance_map.wide[:] = narrow
        kernel.receive(path(*LEGS), 0)
        durations.append(kernel.step(0)[0].elements["duration"].sum())
    assert (durations[1] > 1.2 * durations[0]) == slower
