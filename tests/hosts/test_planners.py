import numpy as np
import pytest
from examples.planner_detour import Detour

from mavfi.config import PlannerConfig
from mavfi.hosts.inprocess import fly
from mavfi.mission import MissionStatus
from mavfi.numerics.voxels import Grid
from mavfi.pipeline.planners import PathSearch, make_search
from tests.hosts.missions import STACKS, golden, mission

NAME = "examples.planner_detour:Detour"


@pytest.mark.parametrize("stack", STACKS)
def test_a_planner_of_ones_own_flies_the_mission(stack):
    flight = fly(mission(stack, planner=NAME))
    assert flight.log.status is MissionStatus.SUCCESS
    assert flight.log.digest() != golden(stack).log.digest()
    assert flight.log.digest() == fly(mission(stack, planner=NAME)).log.digest()


def test_it_goes_around_a_wall_and_keeps_its_randomness_in_one_place():
    planner: PathSearch = make_search(PlannerConfig(name=NAME), 1)
    assert isinstance(planner, Detour)
    grid = Grid(0.0, 0.0, 0.0, 1.0, 10, 5, 8)
    counter = np.zeros((10, 5, 8), np.int16)
    counter[5, :3] = 1
    start, goal = np.array([1.5, 2.5, 1.5]), np.array([8.5, 2.5, 1.5])
    path = planner.search(counter.ravel(), grid, start, goal, np.zeros(3), np.array([10.0, 5.0, 8.0]))
    assert len(path) == 3 and path[1, 1] > 3.0
    before = planner.random.copy()
    counter[3, :4] = counter[7, 1:] = 1  # gaps on opposite sides: one detour is not enough
    path = planner.search(counter.ravel(), grid, start, goal, np.zeros(3), np.array([10.0, 5.0, 8.0]))
    assert len(path) > 2 and (planner.random != before).any()
