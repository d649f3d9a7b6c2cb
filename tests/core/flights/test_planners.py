import numpy as np
import pytest

from mavfi.config import PlannerConfig
from mavfi.errors import BadInputError
from mavfi.flight.compose import find_planner
from mavfi.flight.fly import fly
from mavfi.mission import MissionStatus
from mavfi.numerics.voxels import Grid
from mavfi.pipeline.planners import make_search
from tests.core.flights.missions import FAR_GOAL, each_autopilot, golden, mission

NAME = "examples.planner_detour:Detour"


@each_autopilot
def test_a_planner_of_ones_own_flies_the_mission(autopilot):
    flight = fly(mission(autopilot, planner=NAME))
    assert flight.log.status is MissionStatus.SUCCESS
    assert flight.log.digest() != golden(autopilot).log.digest()
    assert flight.log.digest() == fly(mission(autopilot, planner=NAME)).log.digest()


@pytest.mark.slow
@each_autopilot
@pytest.mark.parametrize("planner", ["rrt", "rrt_star"])
def test_every_shipped_planner_flies_the_mission(autopilot, planner):
    flight = fly(mission(autopilot, FAR_GOAL, planner=planner))
    assert flight.log.status is MissionStatus.SUCCESS
    assert flight.log.digest() != fly(mission(autopilot, FAR_GOAL)).log.digest()
    assert flight.log.digest() == fly(mission(autopilot, FAR_GOAL, planner=planner)).log.digest()


def test_a_planner_is_chosen_by_name_by_file_and_by_class(tmp_path):
    star = find_planner("rrt_star")
    assert (star.name, star.range, star.iterations) == ("rrt_star", 8.0, 1500)
    assert find_planner("rrt_connect") == PlannerConfig()
    assert find_planner(NAME) == PlannerConfig(name=NAME)
    mine = tmp_path / "mine.yaml"
    mine.write_text("{name: rrt, goal_bias: 0.2, range: 3.0, iterations: 700}", encoding="utf-8")
    assert find_planner(str(mine)) == PlannerConfig(name="rrt", goal_bias=0.2, range=3.0, iterations=700)
    mine.write_text("{name: rrt, goal_bias: 2}", encoding="utf-8")
    with pytest.raises(BadInputError, match="goal_bias"):
        find_planner(str(mine))


def test_range_goal_bias_and_budget_reach_the_search():
    grid = Grid(0.0, 0.0, 0.0, 1.0, 10, 5, 8)
    counter = np.zeros((10, 5, 8), np.int16)
    counter[5, :3] = 1
    ends = np.array([1.5, 2.5, 1.5]), np.array([8.5, 2.5, 1.5])
    box = np.zeros(3), np.array([10.0, 5.0, 8.0])

    def path(**changes):
        config = PlannerConfig(restarts=1, shortcuts=0, iterations=2000).model_copy(update=changes)
        return make_search(config, 1).search(counter.ravel(), grid, *ends, *box).tobytes()

    for name in ("rrt", "rrt_star"):
        assert path(name=name)
        assert path(name=name, iterations=2) == b""
        assert path(name=name, goal_bias=0.0) == b""  # the goal itself is then never drawn
        assert path(name=name) != path(name=name, range=1.0)
        assert path(name=name) != path(name=name, goal_bias=0.5)
