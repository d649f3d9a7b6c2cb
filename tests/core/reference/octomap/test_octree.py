import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavfi.kernels.perception import octree
from mavfi.kernels.perception.key_sets import KeyFrame
from mavfi.pipeline import maps
from tests.core.reference.octomap.trees import RULE, NaiveOctree, tree_data

FRAME = KeyFrame(0.5, 0.25, 0.25, 0.25, -4, -3, -1, 8, 7, 6)
SIZE = FRAME.nx * FRAME.ny * FRAME.nz
near = st.integers(-3, 2)
anywhere = st.integers(-(1 << 15), (1 << 15) - 1)
keys = st.one_of(st.tuples(near, near, near), st.tuples(near, near, near), st.tuples(anywhere, anywhere, anywhere))
cubes = st.tuples(st.sampled_from([-4, -2, 0, 2]), st.sampled_from([-2, 0]), st.sampled_from([-2, 0]))
"""Lower corners of eight voxels that have one parent: updated together, they are pruned."""
single = st.tuples(keys, st.booleans()).map(lambda update: [update])
eight = st.tuples(cubes, st.booleans(), st.integers(1, 9)).map(
    lambda c: c[2] * [((c[0][0] + i, c[0][1] + j, c[0][2] + k), c[1]) for i in (0, 1) for j in (0, 1) for k in (0, 1)]
)
sequences = st.lists(single | eight, max_size=12).map(lambda parts: [update for part in parts for update in part])


def grown(capacity=8000):
    return octree.new_octree(capacity)


def apply(tree, updates):
    path = np.zeros(octree.DEPTH, np.int64)
    return [octree.update_node(tree, RULE, *key, hit, path) for key, hit in updates]


def held(tree):
    return [array.tobytes() for array in tree]


@pytest.mark.slow
@given(sequences)
def test_the_octree_equals_plain_objects_node_by_node(updates):
    twin, tree = NaiveOctree(), grown()
    for (key, hit), after in zip(updates, apply(tree, updates), strict=True):
        twin.update(key, hit)
        assert twin.search(key) is not None
        assert not np.isnan(after)
    assert tree_data(tree) == twin.data()
    assert tree.counters[octree.NODES] == len(twin.data()) // 5
    for key in {key for key, _ in updates} | {(0, 0, 0), (5, 5, 5)}:
        node, value = twin.search(key), octree.search(tree, *key)
        assert np.isnan(value) if node is None else value == node.value
    used, free = tree.counters[octree.USED], tree.counters[octree.FREE_COUNT]
    assert max(tree.counters[octree.NODES], 1) == used - free


@given(sequences, st.lists(sequences, min_size=1, max_size=3))
def test_rolling_back_restores_every_bit_and_the_same_updates_give_the_same_bits(committed, tries):
    tree = grown()
    apply(tree, committed)
    before, kept_copy = held(tree), octree.compact_copy(tree)
    for updates in tries:
        apply(tree, updates)
        after = held(tree)
        octree.copy_into(kept_copy, tree)
        assert held(tree) == before
        apply(tree, updates)
        assert held(tree) == after
        octree.copy_into(kept_copy, tree)
        assert held(tree) == before


def voxels_of(count, seed=0):
    return np.random.default_rng(seed).permutation(SIZE)[:count].astype(np.int32)


def test_a_full_pool_stops_before_the_first_voxel_without_room():
    voxels, after = voxels_of(SIZE), np.full(SIZE, 7.0, np.float32)
    tree = octree.new_octree(octree.NEEDED + 40)
    done = octree.update_voxels(tree, FRAME, RULE, voxels, SIZE, 0, after)
    assert 0 < done < SIZE
    assert (after[:done] == RULE.miss).all() and (after[done:] == 7.0).all()
    before = held(tree)
    assert octree.update_voxels(tree, FRAME, RULE, voxels, SIZE, done, after) == done
    assert held(tree) == before
    larger = octree.new_octree(octree.largest_tree(FRAME))
    octree.copy_into(tree, larger)
    assert octree.update_voxels(larger, FRAME, RULE, voxels, SIZE, done, after) == SIZE
    whole = octree.new_octree(octree.largest_tree(FRAME))
    assert octree.update_voxels(whole, FRAME, RULE, voxels, SIZE, 0, after) == SIZE
    assert tree_data(larger) == tree_data(whole)


@pytest.mark.parametrize("kx", [-7, -1, 0, 3])
def test_the_largest_tree_has_room_for_every_voxel_and_not_for_much_more(kx):
    frame = FRAME._replace(kx=kx)
    tree = octree.new_octree(octree.largest_tree(frame))
    after, most = np.empty(SIZE, np.float32), 0
    for seed in range(3):
        voxels = voxels_of(SIZE, seed)
        assert octree.update_voxels(tree, frame, RULE, voxels, SIZE // 2, 0, after) == SIZE
        most = max(most, int(tree.counters[octree.NODES]))
    assert most + octree.NEEDED + 1 <= len(tree.log_odds) <= most + octree.NEEDED + 1 + SIZE // 4


def scans(count, seed=0):
    random = np.random.default_rng(seed)
    for _ in range(count):
        yield random.uniform(-6, 6, (80, 3)).astype(np.float32), random.uniform(-1.0, 1.0, 3)


def both():
    return [make(FRAME, RULE, 5.0) for make in maps.MAPS.values()]


def test_a_map_grows_as_it_needs_and_stays_equal_to_the_dense_one(monkeypatch):
    monkeypatch.setattr(maps, "FIRST_CAPACITY", octree.NEEDED + 2)
    dense, tree = both()
    for points, origin in scans(6):
        for a, b in zip(dense.insert(points, origin), tree.insert(points, origin), strict=True):
            assert a.dtype == b.dtype and a.tobytes() == b.tobytes()
        assert dense.log_odds.tobytes() == tree.log_odds.tobytes()
    assert octree.NEEDED + 2 < len(tree.tree.log_odds) <= octree.largest_tree(FRAME)


@pytest.mark.parametrize("kind", maps.MAPS)
def test_a_map_that_is_rolled_back_is_as_it_was_marked(kind, monkeypatch):
    monkeypatch.setattr(maps, "FIRST_CAPACITY", octree.NEEDED + 2)
    map_ = maps.MAPS[kind](FRAME, RULE, 5.0)
    for points, origin in scans(4):
        map_.mark()
        before = map_.log_odds.tobytes()
        first = [array.tobytes() for array in map_.insert(points, origin)]
        after = map_.log_odds.tobytes()
        map_.rollback()
        assert map_.log_odds.tobytes() == before != after
        assert [array.tobytes() for array in map_.insert(points, origin)] == first
        assert map_.log_odds.tobytes() == after


def struck(tree, random):
    """Flip one bit of one number of the memory."""
    array = tree[random.integers(3)]
    flat = array.reshape(-1)
    at = random.integers(min(len(flat), 400))
    bits = flat[at : at + 1].view(np.uint64 if array.itemsize == 8 else np.uint32)
    bits ^= bits.dtype.type(1 << int(random.integers(8 * array.itemsize)))


def test_a_struck_node_is_found_and_healed_as_in_the_library():
    tree = grown()
    twin = NaiveOctree()
    updates = [((i, 1, 0), i % 2 == 0) for i in range(-3, 4)] * 3
    apply(tree, updates)
    for key, hit in updates:
        twin.update(key, hit)
    tree.log_odds[0] = np.float32(1e30)
    twin.root.value = np.float32(1e30)
    assert tree_data(tree) == twin.data()
    apply(tree, updates[:1])
    twin.update(*updates[0])
    assert tree_data(tree) == twin.data() and tree.log_odds[0] < 10.0


def test_a_value_that_is_not_a_number_stays_in_its_leaf_as_in_the_library():
    tree = grown()
    apply(tree, [((0, 0, 0), True), ((1, 0, 0), True)])
    tree.log_odds[octree.DEPTH] = np.nan  # the first leaf
    assert np.isnan(octree.search(tree, 0, 0, 0))
    apply(tree, [((1, 0, 0), True)])
    assert tree.log_odds[0] == octree.search(tree, 1, 0, 0) > 0.0
    assert np.isnan(apply(tree, [((0, 0, 0), False)])[0])
