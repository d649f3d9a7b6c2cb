import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavfi.config import PlannerConfig
from mavfi.numerics.voxels import segment_free
from mavfi.pipeline.planners import make_search
from tests.core.reference.kernels import naive, scenes

GRID, CONFIG = scenes.GRID, PlannerConfig(restarts=3, iterations=400, shortcuts=30, range=2.0)
PLANNERS = ("rrt", "rrt_connect", "rrt_star")
seeds = st.integers(0, 2**32)


def problem(seed, share):
    """A map, and two places that are free in it."""
    random = np.random.default_rng(seed)
    counter = scenes.counter(random, share)
    ends = []
    while len(ends) < 2:
        candidate = scenes.point(random)
        if segment_free(counter, GRID, candidate, candidate):
            ends.append(candidate)
    return counter, *ends


def search(name, seed, counter, start, goal):
    planner = make_search(CONFIG.model_copy(update={"name": name}), seed)
    return planner.search(counter, GRID, start, goal, scenes.LOWER, scenes.UPPER)


@pytest.mark.parametrize("name", PLANNERS)
@given(seeds, st.sampled_from([0.0, 0.1, 0.25, 0.4]))
def test_a_path_is_free_of_collisions_and_joins_start_and_goal(name, seed, share):
    counter, start, goal = problem(seed, share)
    path = search(name, seed, counter, start, goal)
    if share == 0.0:
        assert len(path) == 2
    if len(path) == 0:
        return
    np.testing.assert_array_equal(path[0], start)
    np.testing.assert_allclose(path[-1], goal, atol=2e-3)
    for a, b in zip(path[:-1], path[1:], strict=True):
        assert naive.first_blocked(counter, GRID, a, b, True) > 1.0
    assert naive.length(path) >= np.linalg.norm(goal - start) - 2e-3


@pytest.mark.parametrize("name", PLANNERS)
def test_no_path_leads_into_a_closed_cell_and_most_problems_are_solved(name):
    counter, start, goal = problem(1, 0.0)
    box = np.zeros((GRID.nx, GRID.ny, GRID.nz), np.int16)
    cell = naive.cell_of(GRID, goal)
    box[tuple(slice(max(c - 1, 0), c + 2) for c in cell)] = 1
    box[cell] = 0
    assert len(search(name, 1, box.ravel(), start, goal)) == 0
    solved = sum(len(search(name, seed, *problem(seed, 0.1))) > 0 for seed in range(40))
    assert solved >= 38
