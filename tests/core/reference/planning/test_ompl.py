"""Our planners compared with OMPL's: same maps, segment check, range, goal bias and number of samples, no shortcuts."""

import math

import numpy as np
import pytest

from benchmarks import planners

pytest.importorskip("ompl", reason="OMPL (package `ompl`) is not installed; it comes with the extra `dev`")

CASES = [
    ("rrt", "dense", 0, planners.Search(4.0, 10_000), 600),
    pytest.param("rrt", "factory", 0, planners.Search(4.0, 10_000), 1600, marks=pytest.mark.long),
    ("rrt_connect", "dense", 0, planners.Search(4.0, 4000), 600),
    pytest.param("rrt_connect", "factory", 0, planners.Search(4.0, 4000), 1600, marks=pytest.mark.long),
    ("rrt_star", "dense", 0, planners.Search(8.0, 1500), 50),
    pytest.param("rrt_star", "factory", 0, planners.Search(8.0, 2500), 80, marks=pytest.mark.long),
]
SCARCE = [
    pytest.param("rrt", "factory", 0, planners.Search(4.0, 450), 1200, marks=pytest.mark.long),
    ("rrt_connect", "factory", 0, planners.Search(4.0, 350), 1200),
    pytest.param("rrt_star", "factory", 0, planners.Search(8.0, 450), 1200, marks=pytest.mark.long),
]
"""Budgets with which about half of the runs find a path."""


def lengths(name, environment, world, search, seeds):
    """Ours and theirs; infinite where no path was found."""
    given = planners.problem(environment, world)
    own = [planners.ours(name, given, search, seed).length for seed in range(seeds)]
    other = [planners.theirs(name, environment, world, search, seed).length for seed in range(seeds)]
    return np.array(own), np.array(other)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "environment", "world", "search", "seeds"), CASES)
def test_paths_are_as_long_as_those_of_ompl(name, environment, world, search, seeds):
    own, other = lengths(name, environment, world, search, seeds)
    assert np.isfinite(own).mean() > 0.97 and np.isfinite(other).mean() > 0.95
    own, other = own[np.isfinite(own)], other[np.isfinite(other)]
    random = np.random.default_rng(0)
    ratios = [
        np.median(random.choice(own, len(own))) / np.median(random.choice(other, len(other))) for _ in range(2000)
    ]
    low, high = np.quantile(ratios, [0.025, 0.975])
    assert 0.95 < low < high < 1.05, (np.median(own) / np.median(other), low, high)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "environment", "world", "search", "seeds"), SCARCE)
def test_a_scarce_budget_finds_as_many_paths_as_with_ompl(name, environment, world, search, seeds):
    own, other = (np.isfinite(found).mean() for found in lengths(name, environment, world, search, seeds))
    both = 0.5 * (own + other)
    assert 0.2 < both < 0.8
    assert abs(own - other) < 3.3 * math.sqrt(2.0 * both * (1.0 - both) / seeds), (own, other)


def test_ompl_takes_as_many_samples_as_it_is_given():
    search = planners.Search(8.0, 300)
    found = planners.theirs("rrt_star", "dense", 0, search, 0)
    assert found.samples == search.iterations
