import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from mavfi.config import PlannerConfig
from mavfi.numerics.voxels import segment_free
from mavfi.pipeline.planners import RrtConnect
from tests.reference.kernels import naive, scenes

GRID, CONFIG = scenes.GRID, PlannerConfig(restarts=3, iterations=400, shortcuts=30, range=2.0)
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


def search(seed, counter, start, goal):
    return RrtConnect(CONFIG, seed).search(counter, GRID, start, goal, scenes.LOWER, scenes.UPPER)


@settings(max_examples=60)
@given(seeds, st.sampled_from([0.0, 0.1, 0.25, 0.4]))
def test_a_path_is_free_of_collisions_and_joins_start_and_goal(seed, share):
    counter, start, goal = problem(seed, share)
    path = search(seed, counter, start, goal)
    if share == 0.0:
        assert len(path) == 2
    if len(path) == 0:
        return
    np.testing.assert_array_equal(path[0], start)
    np.testing.assert_allclose(path[-1], goal, atol=2e-3)
    for a, b in zip(path[:-1], path[1:], strict=True):
        assert naive.first_blocked(counter, GRID, a, b, True) > 1.0
    assert naive.length(path) >= np.linalg.norm(goal - start) - 2e-3


@settings(max_examples=30)
@given(seeds)
def test_the_same_seed_finds_the_same_path(seed):
    counter, start, goal = problem(seed, 0.25)
    assert search(seed, counter, start, goal).tobytes() == search(seed, counter, start, goal).tobytes()


def test_no_path_leads_into_a_closed_cell_and_most_problems_are_solved():
    counter, start, goal = problem(1, 0.0)
    box = np.zeros((GRID.nx, GRID.ny, GRID.nz), np.int16)
    cell = naive.cell_of(GRID, goal)
    box[tuple(slice(max(c - 1, 0), c + 2) for c in cell)] = 1
    box[cell] = 0
    assert len(search(1, box.ravel(), start, goal)) == 0
    solved = sum(len(search(seed, *problem(seed, 0.1))) > 0 for seed in range(40))
    assert solved >= 38
