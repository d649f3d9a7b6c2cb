import numpy as np
import pytest

from mavfi.errors import BadInputError
from mavfi.numerics.voxels import segment_free
from mavfi.pipeline.planners import Rrt, RrtConnect, RrtStar, make_search
from mavfi.pipeline.planning import MotionPlanner
from mavfi.pipeline.ppc import build_pipeline
from mavfi.pipeline.trajectories import TrajectoryGenerator
from mavfi.states import STATES, new_state, rows
from tests.core.unit.pipeline.parts import AUTOPILOTS, config, map_update, odometry, same, status, waypoint


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


@pytest.mark.parametrize("autopilot", AUTOPILOTS)
def test_a_plan_from_the_same_memory_has_the_same_bits(autopilot):
    kernel = planner(autopilot)
    request(kernel, autopilot)
    kernel.mark()
    first = kernel.step(600_000)
    kernel.rollback()
    assert same(first, kernel.step(600_000))


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


@pytest.mark.parametrize("autopilot", AUTOPILOTS)
def test_a_repeated_trajectory_has_the_same_bits_and_number(autopilot):
    kernel = generator(autopilot)
    for number in (1, 2):
        kernel.receive(path(*LEGS), 0)
        kernel.mark()
        first = kernel.step(0)
        kernel.rollback()
        assert same(first, kernel.step(0))
        assert int(first[0].header["trajectory_seq"][0]) == number


@pytest.mark.parametrize(("autopilot", "slower"), [("published", False), ("hardened", True)])
def test_narrow_places_slow_hardened_flights_only(autopilot, slower):
    kernel = generator(autopilot)
    durations = []
    for narrow in (0, 1):
        kernel._clearance_map.wide[:] = narrow
        kernel.receive(path(*LEGS), 0)
        durations.append(kernel.step(0)[0].elements["duration"].sum())
    assert (durations[1] > 1.2 * durations[0]) == slower


@pytest.mark.parametrize("autopilot", AUTOPILOTS)
@pytest.mark.parametrize("value", [np.nan, np.inf, 1e30, 1e300, -1e300])
def test_corrupted_paths_give_a_trajectory_without_an_error(autopilot, value):
    with np.errstate(all="ignore"):
        for row in range(4):
            bad = path(*LEGS)
            rows(bad.elements, 3)[row, 1] = value
            kernel = generator(autopilot)
            kernel.receive(bad, 0)
            assert len(kernel.step(0)) == 1
        kernel.receive(path(*LEGS, entry=value), 0)
        assert len(kernel.step(0)) == 1


def test_every_state_but_the_sensors_has_one_writer_in_the_pipeline():
    kernels = build_pipeline(config())
    written = [name for kernel in kernels.values() for name in kernel.writes]
    assert sorted(written) == sorted(name for name, spec in STATES.items() if spec.writer in kernels)
    for kernel in kernels.values():
        assert all(STATES[name].writer == kernel.name and STATES[name].stage is kernel.stage for name in kernel.writes)
        assert set(kernel.reads) <= set(STATES)


IMPORTED = ["mavfi:Nothing", "no_such_package:Planner"]


@pytest.mark.parametrize("name", ["dowsing", *IMPORTED, ":Planner", ".x:Y", "mavfi:"])
def test_an_unknown_planner_is_refused_with_what_is_allowed(name):
    planner_config = config(planner=name).planner
    allowed = "not known; allowed: .*rrt_connect.*, or package:object" if name not in IMPORTED else "cannot be imported"
    with pytest.raises(BadInputError, match=f"planner '.*': {allowed}"):
        make_search(planner_config, 1)


def test_a_planner_is_found_by_name_and_by_address():
    assert isinstance(make_search(config().planner, 1), RrtConnect)
    assert isinstance(make_search(config(planner="rrt").planner, 1), Rrt)
    assert isinstance(make_search(config(planner="rrt_star").planner, 1), RrtStar)
    address = config(planner="mavfi.pipeline.planners:RrtConnect").planner
    assert isinstance(make_search(address, 1), RrtConnect)
