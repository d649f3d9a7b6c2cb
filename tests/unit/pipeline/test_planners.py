"""Planners whose memory was struck: a search ends with its budget whatever its own counters say."""

from dataclasses import replace

import numpy as np
import pytest

from mavfi.config import PlannerConfig
from mavfi.numerics.voxels import Grid
from mavfi.pipeline.functions import PLAIN
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


@pytest.mark.parametrize("value", [STRUCK, 2**31 - 1])
def test_a_struck_longest_search_is_bounded_by_the_configuration(value):
    config = PlannerConfig(name="rrt_star", iterations=50, restarts=4)
    asked = []
    functions = replace(PLAIN, plan_rrt_star=lambda *arguments: asked.append(arguments[9]) or 0)
    search = make_search(config, 1, functions)
    search._longest = value
    assert len(search.search(wall(gap=0), GRID, *ENDS, *BOX)) == 0
    assert asked == [200]
