"""Our planners compared with OMPL's: same maps, segment check, range, goal bias and number of samples, no shortcuts."""

import math

import numpy as np
import pytest

from benchmarks import planners
from tests.night import at_night

pytest.importorskip("ompl", reason="OMPL (package `ompl`) is not installed; it comes with the extra `dev`")

RRT, CONNECT, STAR = planners.Search(4.0, 10_000), planners.Search(4.0, 4000), planners.Search(8.0, 1500)
CASES = at_night(  # the last number: the factor within which the medians agree
    ("rrt", "dense", RRT, 600, 1.05),
    ("rrt", "factory", RRT, 1600, 1.05),
    ("rrt_connect", "dense", CONNECT, 200, 1.1),
    ("rrt_connect", "factory", CONNECT, 1600, 1.05),
    ("rrt_star", "dense", STAR, 50, 1.05),
    ("rrt_star", "factory", planners.Search(8.0, 2500), 80, 1.05),
)
SCARCE = at_night(
    ("rrt", planners.Search(4.0, 450), 1200),
    ("rrt_connect", planners.Search(4.0, 350), 1200),
    ("rrt_star", planners.Search(8.0, 450), 1200),
)
"""Budgets with which about half of the runs find a path."""


def lengths(name, environment, search, seeds):
    """Ours and theirs; infinite where no path was found."""
    problem = planners.problem(environment, 0)
    ours = [planners.ours(name, problem, search, seed).length for seed in range(seeds)]
    theirs = [planners.theirs(name, environment, 0, search, seed).length for seed in range(seeds)]
    return np.array(ours), np.array(theirs)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "environment", "search", "seeds", "factor"), CASES)
def test_paths_are_as_long_as_those_of_ompl(name, environment, search, seeds, factor):
    ours, theirs = lengths(name, environment, search, seeds)
    assert np.isfinite(ours).mean() > 0.97 and np.isfinite(theirs).mean() > 0.95
    ours, theirs = ours[np.isfinite(ours)], theirs[np.isfinite(theirs)]
    random = np.random.default_rng(0)
    ratios = [
        np.median(random.choice(ours, len(ours))) / np.median(random.choice(theirs, len(theirs))) for _ in range(2000)
    ]
    low, high = np.quantile(ratios, [0.025, 0.975])
    assert 1.0 / factor < low < high < factor, (np.median(ours) / np.median(theirs), low, high)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "search", "seeds"), SCARCE)
def test_a_scarce_budget_finds_as_many_paths_as_with_ompl(name, search, seeds):
    ours, theirs = (np.isfinite(paths).mean() for paths in lengths(name, "factory", search, seeds))
    both = 0.5 * (ours + theirs)
    assert 0.2 < both < 0.8
    assert abs(ours - theirs) < 3.3 * math.sqrt(2.0 * both * (1.0 - both) / seeds), (ours, theirs)


def test_ompl_takes_as_many_samples_as_it_is_given():
    search = planners.Search(8.0, 300)
    plan = planners.theirs("rrt_star", "dense", 0, search, 0)
    assert plan.samples == search.iterations
