import numpy as np
import pytest

from mavfi.kernels.perception import clearance, collision_check, key_sets, octomap, point_cloud
from mavfi.kernels.perception.key_sets import KeyFrame
from mavfi.numerics.rotations import rotation_matrix
from mavfi.numerics.voxels import offsets_within
from tests.core.reference.kernels import naive, scenes

RULE = octomap.UpdateRule(*(octomap.log_odds(p) for p in (0.7, 0.4, 0.12, 0.97)))
FRAME = octomap.KeyFrame(0.5, 0.25, 0.25, 0.25, -9, -8, -1, 20, 18, 9)
SIZE = FRAME.nx * FRAME.ny * FRAME.nz
SEEDS = range(8)


def test_back_projection_is_origin_plus_rotated_ray():
    random = np.random.default_rng(1)
    directions = random.normal(size=(200, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    ranges = random.uniform(0.0, 25.0, 200).astype(np.float32)
    ranges[::9] = np.inf
    ranges[::11] = np.nan
    quaternion = random.normal(size=4)
    rotation = np.empty((3, 3))
    rotation_matrix(quaternion / np.linalg.norm(quaternion), rotation)
    origin = np.array([10.0, -3.0, 2.0])
    points = np.empty((200, 3), np.float32)
    point_cloud.back_project(ranges, directions, rotation, origin, 20.0, points)
    expected = naive.back_project(ranges, directions, rotation, origin, 20.0)
    np.testing.assert_allclose(points, expected, rtol=1e-6)
    assert np.isnan(points[::11]).all() and np.isfinite(points[1]).all()


class Map:
    """The kernel's map with its buffers."""

    def __init__(self):
        self.log_odds = np.zeros(SIZE, np.float32)
        self.stamp = np.zeros(SIZE, np.int32)
        self.touched = np.zeros(SIZE + 1, np.int32)
        self.before = np.zeros(SIZE, np.float32)
        self.scan = 0

    def insert(self, points, origin, max_range=6.0):
        self.scan += 1
        return octomap.insert_scan(
            points, origin, max_range, FRAME, RULE, self.log_odds, self.stamp, self.scan, self.touched, self.before
        )


def clouds(seed, scans=6, rays=150):
    """Scans from a moving sensor: hits, points beyond the range, points outside of the grid, invalid ones."""
    random = np.random.default_rng(seed)
    for scan in range(scans):
        origin = np.array([-2.0 + 0.7 * scan, random.uniform(-1, 1), random.uniform(0.5, 2.0)])
        directions = random.normal(size=(rays, 3))
        directions /= np.linalg.norm(directions, axis=1)[:, None]
        points = (origin + directions * random.uniform(0.1, 9.0, (rays, 1))).astype(np.float32)
        points[:5] = [[np.nan, 0, 0], [np.inf, 0, 0], [0, 1e30, 0], [0, 0, -np.inf], [5000.0, 0, 0]]
        points[5] = origin
        points[6:9, 1:] = origin[1:]  # rays along an axis
        yield points, origin


@pytest.mark.parametrize("seed", SEEDS)
def test_the_map_equals_a_dictionary_under_octomaps_rule_bit_by_bit(seed):
    twin, kernel = naive.OctoMapTwin(FRAME, RULE), Map()
    with np.errstate(all="ignore"):
        for points, origin in clouds(seed):
            kernel.insert(points, origin)
            twin.insert(points, origin, 6.0)
            assert kernel.log_odds.tobytes() == twin.dense().tobytes()
    assert (kernel.log_odds > 0).sum() > 50 and (kernel.log_odds < 0).sum() > 200


def walked_alone(points, origin, max_range, frame):
    """Free voxels in the order in which rays that are walked one after the other come to them, and the voxels hit."""
    size = frame.nx * frame.ny * frame.nz
    stamp, touched, end = np.zeros(size, np.int32), np.zeros(size + 1, np.int32), np.empty(3, np.float32)
    start = (origin + np.array([frame.shift_x, frame.shift_y, frame.shift_z])).astype(np.float32)
    ends, hits = [], []
    for point in points:
        voxel = key_sets._end_of_ray(start, point, max_range, frame, end)
        ends.append(end.copy())
        if voxel >= 0 and voxel not in hits:
            hits.append(voxel)
            stamp[voxel] = 3
    count = 0
    for end in ends:
        count = key_sets._walk_free(frame, start, end, stamp, 2, touched, count)
    return touched[:count].tolist(), hits


FINE = KeyFrame(0.02, 0.01, 0.01, 0.01, -150, -150, -20, 320, 310, 100)


@pytest.mark.parametrize("frame", (FRAME, FINE), ids=("coarse", "fine"))
@pytest.mark.parametrize("seed", SEEDS)
def test_rays_walked_side_by_side_meet_the_same_voxels_in_the_same_order(frame, seed):
    random = np.random.default_rng(100 + seed)
    origin = random.uniform([-2.0, -1.0, 0.3], [2.0, 1.0, 1.0])
    directions = random.normal(size=(key_sets.RAYS + 37, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    points = (origin + directions * random.uniform(0.01, 9.0, (len(directions), 1))).astype(np.float32)
    # along an axis, and from corner to corner of voxels: faces are met at the same time
    points[:9] = origin + np.round(points[:9] - origin) * np.float32(frame.resolution)
    points[9:12, 1:] = origin[1:]
    size = frame.nx * frame.ny * frame.nz
    stamp, touched = np.zeros(size, np.int32), np.zeros(size + 1, np.int32)
    n_free, count = key_sets.collect(points, origin, 6.0, frame, stamp, 1, touched)
    free, hits = walked_alone(points, origin, 6.0, frame)
    assert touched[:n_free].tolist() == free and touched[n_free:count].tolist() == hits
    assert len(free) > 300 and len(hits) > 20


def test_each_voxel_is_updated_once_a_scan_and_occupied_wins():
    kernel = Map()
    points = np.array([[2.0, 0.1, 1.1]] * 4 + [[4.0, 0.1, 1.1]], np.float32)
    count = kernel.insert(points, np.array([0.0, 0.1, 1.1]))
    touched = kernel.touched[:count]
    assert len(set(touched.tolist())) == count
    assert sorted(kernel.log_odds[kernel.log_odds > 0].tolist()) == [RULE.hit, RULE.hit]


@pytest.mark.parametrize("boxes", [False, True])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_clearance_counters_equal_a_recount_and_undo_restores_them(seed, boxes):
    random = np.random.default_rng(seed)
    grid = scenes.GRID
    wide_offsets, narrow_offsets = offsets_within(1.2, 0.5, boxes), offsets_within(0.6, 0.5, boxes)
    cells, wide, narrow = (np.zeros(grid.size, kind) for kind in (np.uint8, np.int16, np.int16))
    journals = []
    states = [(cells.copy(), wide.copy(), narrow.copy())]
    for _ in range(4):
        voxels = random.integers(-5, grid.size + 5, 300).astype(np.int32)
        log_odds = random.normal(size=300).astype(np.float32)
        log_odds[:10] = np.nan
        changed_voxels, changed_cells = np.empty(300, np.int32), np.empty(300, np.uint8)
        count = clearance.apply_updates(
            voxels, log_odds, grid, cells, wide, wide_offsets, narrow, narrow_offsets, changed_voxels, changed_cells
        )
        journals.append((changed_voxels, changed_cells, count))
        states.append((cells.copy(), wide.copy(), narrow.copy()))
        for voxel, value in zip(voxels, log_odds, strict=True):  # the last word on each voxel
            if 0 <= voxel < grid.size:
                states[0][0][voxel] = 2 if value > 0.0 else 1
        np.testing.assert_array_equal(cells, states[0][0])
        np.testing.assert_array_equal(wide, naive.recount(grid, cells == 2, wide_offsets))
        np.testing.assert_array_equal(narrow, naive.recount(grid, cells == 2, narrow_offsets))
    states[0][0][:] = 0
    for journal, expected in zip(reversed(journals), reversed(states[:-1]), strict=True):
        clearance.undo_updates(grid, cells, wide, wide_offsets, narrow, narrow_offsets, *journal)
        for array, was in zip((cells, wide, narrow), expected, strict=True):
            np.testing.assert_array_equal(array, was)


@pytest.mark.parametrize("outside", [False, True])
@pytest.mark.parametrize("share", [0.0, 0.02, 0.3])
def test_time_to_collision_is_the_reference_time_of_the_first_blocked_leg(share, outside):
    random = np.random.default_rng(5)
    grid, seen = scenes.GRID, set()
    for _ in range(60):
        counter = scenes.counter(random, share)
        points = scenes.smooth_points(random, 12, 0.5)
        first, remaining = int(random.integers(-2, 14)), random.uniform(-0.5, 0.5)
        position = scenes.point(random, 0.5)
        arguments = counter, grid, position, points, first, remaining, outside
        time = collision_check.time_to_collision(*arguments)
        assert time == pytest.approx(naive.time_to_collision(*arguments), abs=1e-12)
        seen.add(np.sign(time))
    assert len(seen) >= 2 or share == 0.0


@pytest.mark.parametrize("escaping", [False, True])
def test_known_free_distance_is_the_arc_length_of_the_first_bad_sample(escaping):
    random = np.random.default_rng(6)
    grid = scenes.GRID
    blocked_found = unknown_found = 0
    for _ in range(150):
        cells = random.choice([0, 1, 2], grid.size, p=[0.002, 0.99, 0.008]).astype(np.uint8)
        counter = naive.recount(grid, cells == 2, [(0, 0, 0), (1, 0, 0), (-1, 0, 0)])
        points = scenes.smooth_points(random)
        first = int(random.integers(0, 60))
        arguments = counter, cells, grid, points, first, 2.5, 1, escaping
        blocked, unknown = collision_check.known_free_distance(*arguments)
        assert (blocked, unknown) == pytest.approx(naive.known_free_distance(*arguments), abs=1e-9)
        blocked_found += blocked < np.inf
        unknown_found += unknown < np.inf
    assert 10 < blocked_found < 150 and 10 < unknown_found < 150


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e200, 1e300, 4000.0])
def test_a_corrupted_point_is_blocked_where_the_last_usable_one_lies(value):
    grid = scenes.GRID
    points = np.zeros((10, 11))
    points[:, 0] = 0.1 * np.arange(10)
    points[:, 2] = 1.0
    points[7, 0] = value
    free, known_cells = np.zeros(grid.size, np.int16), np.ones(grid.size, np.uint8)
    blocked, unknown = collision_check.known_free_distance(free, known_cells, grid, points, 0, 9.0, 1, False)
    assert blocked == pytest.approx(0.6 if not abs(value) < 1e100 else value)
    assert unknown == np.inf


def test_a_work_array_that_could_run_over_is_refused():
    kernel = Map()
    kernel.touched = kernel.touched[:-1]
    with pytest.raises(ValueError, match="longer than the map"):
        kernel.insert(np.ones((1, 3), np.float32), np.zeros(3))


def test_a_scan_that_touches_every_voxel_stays_within_its_work_array():
    frame = octomap.KeyFrame(0.5, 0.25, 0.25, 0.25, 0, 0, 0, 4, 1, 1)
    log_odds, stamp, touched = np.zeros(4, np.float32), np.zeros(4, np.int32), np.full(6, -7, np.int32)
    points = np.array([[3.0, 0.0, 0.0]] * 3, np.float32)
    count = octomap.insert_scan(
        points, np.array([-1.0, 0.0, 0.0]), 9.0, frame, RULE, log_odds, stamp, 1, touched[:5], np.zeros(4, np.float32)
    )
    assert count == 4 and touched[:4].tolist() == [0, 1, 2, 3] and touched[5] == -7
    assert (log_odds == RULE.miss).all()
