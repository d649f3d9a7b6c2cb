import numpy as np
import pytest

from mavfi.kernels.planning import rrt, rrt_connect, rrt_star
from mavfi.kernels.planning.nearest import PAYS_FROM
from mavfi.numerics.random import seed_generator
from mavfi.numerics.voxels import segment_free
from tests.core.reference.kernels import scenes
from tests.core.reference.planning import twins

GRID = scenes.GRID
STEP, BIAS, BUDGET = 1.5, 0.05, 400


def problem(seed, share=0.22):
    """A map and two free places that do not see each other."""
    random = np.random.default_rng(seed)
    counter = scenes.counter(random, share)
    while True:
        start, goal = scenes.point(random), scenes.point(random)
        single = all(segment_free(counter, GRID, end, end) for end in (start, goal))
        if single and not segment_free(counter, GRID, start, goal):
            return counter, GRID, start, goal, scenes.LOWER, scenes.UPPER


@pytest.mark.parametrize("seed", range(6))
def test_rrt_grows_the_same_tree(seed):
    arguments, tree, path = problem(seed), rrt.new_tree(BUDGET + 1), np.zeros((BUDGET + 1, 3))
    count = rrt.plan(*arguments, STEP, BIAS, BUDGET, seed_generator(seed), tree, path)
    nodes, parents, goal = twins.rrt(arguments, STEP, BIAS, BUDGET, seed_generator(seed))
    np.testing.assert_array_equal(tree.nodes[: len(nodes)], nodes)
    np.testing.assert_array_equal(tree.parents[: len(nodes)], parents)
    assert (count > 0) == (goal is not None)
    if goal is not None:
        way = [goal]
        while way[-1] > 0:
            way.append(parents[way[-1]])
        np.testing.assert_array_equal(path[:count], np.array(nodes)[way[::-1]])


@pytest.mark.parametrize("seed", range(6))
def test_rrt_connect_grows_the_same_trees(seed):
    arguments, trees = problem(seed), rrt_connect.new_trees()
    path = np.zeros((2 * rrt_connect.NODE_LIMIT, 3))
    count = rrt_connect.plan(*arguments, STEP, BUDGET, seed_generator(seed), trees, path)
    *expected, met = twins.rrt_connect(arguments, STEP, BUDGET, seed_generator(seed))
    for which, nodes in enumerate(expected):
        assert trees.counts[which] == len(nodes)
        np.testing.assert_array_equal(trees.nodes[which, : len(nodes)], nodes)
    assert (count > 0) == met


@pytest.mark.parametrize("seed", range(6))
def test_rrt_star_grows_the_same_tree_with_the_same_costs(seed):
    arguments, tree, path = problem(seed), rrt_star.new_tree(BUDGET + 1), np.zeros((BUDGET + 1, 3))
    count = rrt_star.plan(*arguments, STEP, BIAS, BUDGET, BUDGET, seed_generator(seed), tree, path)
    twin = twins.StarTwin(arguments, STEP, BIAS, seed_generator(seed))
    for _ in range(BUDGET):
        twin.step()
    n = len(twin.nodes)
    assert tree.state.tolist() == [n, -1 if twin.goal_node is None else twin.goal_node, BUDGET]
    np.testing.assert_array_equal(tree.nodes[:n], twin.nodes)
    np.testing.assert_array_equal(tree.parents[:n], twin.parents)
    np.testing.assert_array_equal(tree.costs[:n], [twin.cost(i) for i in range(n)])
    assert (count > 0) == (twin.goal_node is not None)


@pytest.mark.slow
def test_large_trees_are_the_same_that_take_their_nearest_nodes_from_the_index():
    arguments, path = problem(7, 0.05), np.zeros((901, 3))
    plain, star = rrt.new_tree(901), rrt_star.new_tree(901)
    rrt.plan(*arguments, STEP, 0.0, 900, seed_generator(7), plain, path)
    rrt_star.plan(*arguments, STEP, 0.0, 900, 900, seed_generator(7), star, path)
    nodes, parents, _ = twins.rrt(arguments, STEP, 0.0, 900, seed_generator(7))
    twin = twins.StarTwin(arguments, STEP, 0.0, seed_generator(7))
    for _ in range(900):
        twin.step()
    assert len(nodes) > 2 * PAYS_FROM and len(twin.nodes) > 2 * PAYS_FROM
    np.testing.assert_array_equal(plain.parents[: len(nodes)], parents)
    np.testing.assert_array_equal(star.parents[: len(twin.nodes)], twin.parents)


def test_problems_of_both_kinds_are_among_them():
    outcomes = {twins.rrt(problem(seed), STEP, BIAS, BUDGET, seed_generator(seed))[2] is None for seed in range(6)}
    assert outcomes == {True, False}


def test_rrt_star_continues_to_the_first_path_where_the_budget_finds_none():
    arguments, path = problem(2, 0.25), np.zeros((3001, 3))
    tree = rrt_star.new_tree(3001)
    assert rrt_star.plan(*arguments, STEP, BIAS, 20, 20, seed_generator(1), tree, path) == 0
    assert rrt_star.plan(*arguments, STEP, BIAS, 20, 3000, seed_generator(1), tree, path) > 0
    assert 20 < tree.state[2] < 3000
    nodes, goal = tree.state[:2]
    assert goal == nodes - 1


def test_a_full_tree_ends_a_search():
    arguments, path = problem(0, 0.3), np.zeros((50, 3))
    assert rrt.plan(*arguments, STEP, 0.0, 10_000, seed_generator(1), rrt.new_tree(50), path) == 0
    tree = rrt_star.new_tree(50)
    assert rrt_star.plan(*arguments, STEP, 0.0, 10_000, 20_000, seed_generator(1), tree, path) == 0
    assert tree.state[0] == 50


@pytest.mark.parametrize("name", ["rrt", "rrt_star"])
def test_what_was_in_the_memory_before_does_not_matter(name):
    kernel = {"rrt": rrt, "rrt_star": rrt_star}[name]
    budget = (BUDGET,) if name == "rrt" else (BUDGET, BUDGET)
    results = []
    for filling in (0, 77):
        tree, path = kernel.new_tree(BUDGET + 1), np.zeros((BUDGET + 1, 3))
        for array in tree:
            for part in array if isinstance(array, tuple) else [array]:
                part.fill(filling)
        count = kernel.plan(*problem(3), STEP, BIAS, *budget, seed_generator(3), tree, path)
        results.append(path[:count].tobytes())
    assert results[0] == results[1]
