import numpy as np
import pytest

from mavfi.kernels.planning import nearest

LOWER, UPPER = np.array([1.0, -29.0, 1.6]), np.array([119.0, 29.0, 9.6])


def clouds(name, random, count):
    """Nodes in the order in which they come. Shape (count, 3)."""
    whole = random.uniform(LOWER, UPPER, (count, 3))
    if name == "corner":
        whole = random.uniform(LOWER, LOWER + (5.0, 5.0, 3.0), (count, 3))
    elif name == "lattice":  # many at the same distance, many at the same place
        whole = np.round(whole / 8.0) * 8.0
    elif name == "sorted":
        whole = whole[np.argsort(whole[:, 0])]
    elif name == "outside":
        whole *= random.choice([1.0, -3.0, 40.0], (count, 1))
    elif name == "corrupted":
        special = random.choice([np.nan, np.inf, -np.inf, 1e30, -1e300, 5e-324], (count, 3))
        whole = np.where(random.random((count, 3)) < 0.1, special, whole)
    return whole


def index_of(nodes, lower=LOWER, upper=UPPER):
    index = nearest.new_index(len(nodes))
    nearest.clear(index, lower, upper)
    return index


NAMES = ("whole", "corner", "lattice", "sorted", "outside", "corrupted")


@np.errstate(all="ignore")
@pytest.mark.parametrize("name", NAMES)
def test_the_index_finds_the_node_of_a_full_scan_ties_included(name):
    random = np.random.default_rng(3)
    nodes = clouds(name, random, 3000)
    index = index_of(nodes)
    targets = [*clouds("whole", random, 200), *clouds(name, random, 300)]
    for turn, target in enumerate(targets):
        count = min(1 + 7 * turn, len(nodes))  # it grows between the searches
        squares = ((nodes[:count] - target) ** 2).sum(1)
        sound = np.isfinite(squares)
        expected = int(np.argmin(np.where(sound, squares, np.inf))) if sound.any() else 0
        assert nearest.scan(nodes, count, target) == expected
        assert nearest.search(index, nodes, count, target) == expected
        assert nearest.nearest(index, nodes, count, target) == expected


@np.errstate(all="ignore")
@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("radius", [0.0, 3.0, 8.0, 1e4, np.inf, np.nan, -1.0])
def test_the_index_finds_the_nodes_in_a_ball(name, radius):
    random = np.random.default_rng(4)
    nodes = clouds(name, random, 1500)
    index = index_of(nodes)
    indexed, other = np.zeros(len(nodes), np.int32), np.zeros(len(nodes), np.int32)
    for turn, target in enumerate(clouds(name, random, 60)):
        count = min(1 + 40 * turn, len(nodes))
        n = nearest.scan_ball(nodes, count, target, radius, indexed)
        m = nearest.search_ball(index, nodes, count, target, radius, other)
        assert sorted(indexed[:n]) == sorted(other[:m])
        away = np.sqrt(((nodes[:count] - target) ** 2).sum(1))
        assert n == (away <= radius).sum()


@np.errstate(all="ignore")
@pytest.mark.parametrize("box", [(np.nan, 1.0), (np.inf, -np.inf), (-1e300, 1e300), (3.0, 3.0), (5.0, -5.0)])
def test_a_box_that_is_not_sound_changes_no_answer(box):
    random = np.random.default_rng(5)
    nodes = clouds("whole", random, 600)
    index = index_of(nodes, np.full(3, box[0]), np.full(3, box[1]))
    for target in clouds("whole", random, 50):
        assert nearest.search(index, nodes, 600, target) == nearest.scan(nodes, 600, target)


def test_the_index_does_not_get_deep_whatever_the_order_of_the_nodes():
    random = np.random.default_rng(6)
    for name in ("whole", "sorted", "corner"):
        nodes = clouds(name, random, 8000)
        index = index_of(nodes)
        nearest.search(index, nodes, len(nodes), nodes[0])
        depth = np.zeros(len(nodes), int)
        for node in range(len(nodes)):  # a half is always newer than its cell
            for half in index.halves[node]:
                if half >= 0:
                    depth[half] = depth[node] + 1
        assert 12 <= depth.max() < 40
