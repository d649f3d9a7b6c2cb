"""Planners whose memory was struck: a search ends with its budget whatever its own counters say."""

import numpy as np
import pytest

from mavfi.config import PlannerConfig
from mavfi.errors import BadInputError
from mavfi.numerics.voxels import Grid
from mavfi.pipeline import planners
from mavfi.pipeline.planners import make_search

GRID = Grid(0.0, 0.0, 0.0, 1.0, 10, 5, 8)
BOX = np.zeros(3), np.array([10.0, 5.0, 8.0])
ENDS = np.array([1.5, 2.5, 1.5]), np.array([8.5, 2.5, 1.5])
STRUCK = 6 ^ (1 << 27)
"""A number of runs with one bit flipped, which once made a plan take hours."""


def wall(gap):
    counter = np.zeros((10, 5, 8), np.int16)
    counter[5, : 5 - gap] = 1
    return counter.ravel()


@pytest.mark.parametrize("name", ["rrt", "rrt_connect", "rrt_star"])
@pytest.mark.parametrize("value", [STRUCK, 2**31 - 1, -(2**31), 0])
def test_a_struck_number_of_runs_is_bounded_by_the_configuration(name, value, monkeypatch):
    config = PlannerConfig(name=name, iterations=300, restarts=4)
    search = make_search(config, 1)
    search._runs = value
    inner, runs = search._run, []
    monkeypatch.setattr(search, "_run", lambda *arguments: runs.append(1) or inner(*arguments))
    path = search.search(wall(gap=2), GRID, *ENDS, *BOX)
    assert len(runs) <= 4
    assert (len(path) > 2) == (value > 0)


class Own:
    """A planner of a user's own that gives what it was told."""

    random = np.zeros(4, np.uint64)

    def __init__(self, config=None, seed=0):
        pass

    def search(self, counter, grid, start, goal, lower, upper):
        return None


def test_a_planner_without_a_generator_is_refused(monkeypatch):
    monkeypatch.setattr(planners, "find_search", lambda name: Own)
    config = PlannerConfig(name="own")
    assert isinstance(planners.make_search(config, 1), Own)
    for random in (None, np.random.default_rng(1)):
        monkeypatch.setattr(Own, "random", random)
        with pytest.raises(BadInputError, match=r"^planner 'own': lacks random, .*uint64"):
            planners.make_search(config, 1)


@pytest.mark.parametrize(
    ("path", "message"),
    [
        (np.full((2, 3), np.nan), "vertices that are not finite; allowed: finite ones"),
        (np.full((2, 3), np.inf), "vertices that are not finite"),
        (np.zeros((301, 3)), "301 vertices; allowed: at most 300"),
        (np.zeros((2, 2)), r"allowed: an array of shape \(n, 3\)"),
        ([(0, 0, 0)], "1 vertex; allowed: 2 or more, from start to goal"),
    ],
)
def test_a_path_that_cannot_be_flown_is_the_planners_mistake(path, message):
    with pytest.raises(BadInputError, match=rf"^planner \S+:Own: search returned .*{message}"):
        planners.checked_path(Own(), path)
