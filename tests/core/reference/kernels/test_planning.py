import numpy as np
import pytest

from mavfi.kernels.planning import path as paths
from mavfi.kernels.planning import trajectory, travel, waypoint
from mavfi.numerics.random import seed_generator
from mavfi.numerics.voxels import segment_free
from tests.core.reference.kernels import naive, scenes

GRID = scenes.GRID
LIMITS = trajectory.Limits(3.0, 1.0, 3.5, 2.5, 4.0, 2.0, 3.0)


@pytest.mark.parametrize("share", [0.1, 0.5, 0.97])
def test_the_nearest_clear_place_is_that_of_a_full_search(share):
    random = np.random.default_rng(2)
    outcomes = set()
    lower, upper = scenes.LOWER + 0.4, scenes.UPPER - 0.4
    for _ in range(40):
        blocked = scenes.counter(random, share)
        check = blocked * scenes.counter(random, 0.3)
        core = check * scenes.counter(random, 0.5)
        point, result = scenes.point(random, 0.3), np.empty(3)
        is_clear = paths.nearest_clear(blocked, check, core, GRID, point, lower, upper, 1.6, result)
        expected = naive.nearest_clear(blocked, check, core, GRID, point, lower, upper, 1.6)
        assert is_clear == (expected is not None)
        if is_clear:
            assert paths.distance(point, result) == pytest.approx(expected, abs=1e-9)
        outcomes.add(is_clear)
    assert outcomes == {True, False} or share < 0.9


def staircase(random, counter, tries=400):
    """A free polyline of many vertices. Shape (n, 3)."""
    vertices = [scenes.point(random)]
    while not segment_free(counter, GRID, vertices[0], vertices[0]):
        vertices = [scenes.point(random)]
    for _ in range(tries):
        candidate = vertices[-1] + random.normal(size=3) * 0.8
        if segment_free(counter, GRID, vertices[-1], candidate):
            vertices.append(candidate)
        if len(vertices) == 25:
            break
    return np.array(vertices)


@pytest.mark.parametrize("seed", range(6))
def test_shortcuts_keep_the_ends_stay_free_and_never_get_longer(seed):
    random = np.random.default_rng(seed)
    counter = scenes.counter(random, 0.08)
    path = staircase(random, counter)
    assert len(path) > 5
    work, buffer = np.zeros((60, 3)), np.zeros((60, 3))
    work[: len(path)] = path
    count = paths.shortcut_greedy(counter, GRID, work, len(path))
    greedy = naive.length(work[:count])
    assert paths.path_length(work, count) == pytest.approx(greedy)
    assert greedy <= naive.length(path) + 1e-9
    count = paths.shortcut_random(counter, GRID, work, count, 60, seed_generator(seed), buffer)
    short = work[:count]
    assert naive.length(short) <= greedy + 1e-9
    np.testing.assert_array_equal(short[0], path[0])
    np.testing.assert_allclose(short[-1], path[-1], atol=2e-3)
    for a, b in zip(short[:-1], short[1:], strict=True):
        assert naive.first_blocked(counter, GRID, a, b, True) > 1.0


def test_greedy_shortcut_goes_straight_where_nothing_is_in_the_way():
    random = np.random.default_rng(3)
    free = np.zeros(GRID.size, np.int16)
    path = staircase(random, free)
    work = path.copy()
    assert paths.shortcut_greedy(free, GRID, work, len(path)) == 2
    np.testing.assert_array_equal(work[:2], path[[0, -1]])


def zigzag():
    return np.array([[-2.0, -1.5, 1.0], [2.0, 3.5, 1.5], [5.0, -1.0, 3.0], [6.0, 4.5, 1.0]])


def timed(path, blocked=None, wide=None, entry=0.0, limits=LIMITS, inner=0.2):
    """Curve, arc, speed and points of a path."""
    blocked = np.zeros(GRID.size, np.int16) if blocked is None else blocked
    wide = np.zeros(GRID.size, np.int16) if wide is None else wide
    corners, curve = np.zeros((trajectory.CURVE_LIMIT, 3)), np.zeros((trajectory.CURVE_LIMIT, 3))
    arc, speed = np.zeros(trajectory.CURVE_LIMIT), np.zeros(trajectory.CURVE_LIMIT)
    points = np.zeros((trajectory.POINT_LIMIT, 11))
    count = trajectory.smooth(blocked, GRID, path, len(path), limits.blend, inner, corners, curve)
    trajectory.speed_profile(wide, GRID, curve, count, entry, limits, arc, speed)
    n = trajectory.sample(curve, count, arc, speed, 0.02, limits.look, 0.0, points)
    return curve[:count], arc[:count], speed[:count], points[:n]


def test_the_curve_is_evenly_sampled_without_corners_and_keeps_its_ends():
    path = zigzag()
    curve, arc, _, _ = timed(path)
    gaps = np.linalg.norm(np.diff(curve, axis=0), axis=1)
    assert gaps.max() <= 0.1 + 1e-9 and gaps[:-1].min() > 0.09
    np.testing.assert_allclose(arc, [0.0, *np.cumsum(gaps)], atol=1e-9)
    np.testing.assert_array_equal(curve[[0, -1]], path[[0, -1]])
    directions = np.diff(curve, axis=0)[:-1] / gaps[:-1, None]
    assert (directions[:-1] * directions[1:]).sum(1).min() > np.cos(0.6)  # the corners of the path: less than 0


PACE = travel.Pace(5.0, 1.5, 2.5, 3.5, 3.0)


def test_travel_time_is_that_of_the_naive_estimate():
    random = np.random.default_rng(4)
    for count in (2, 3, 6):
        for _ in range(20):
            wide = scenes.counter(random, 0.2)
            path = np.array([scenes.point(random, 0.5) for _ in range(count)])
            velocity = random.uniform(-5.0, 5.0, 3)
            time = travel.travel_time(wide, GRID, path, count, velocity, PACE)
            assert time == pytest.approx(naive.travel_time(wide, GRID, path, velocity, PACE), rel=1e-9)
            share = travel.tight_share(wide, GRID, path[0], path[1])
            assert share == pytest.approx(naive.tight_share(wide, GRID, path[0], path[1]))


def test_a_path_gets_quicker_and_stays_free_inside_of_its_box():
    random = np.random.default_rng(6)
    gained = 0
    for _ in range(20):
        blocked = scenes.counter(random, 0.05)
        path = staircase(random, blocked)
        if len(path) < 3:
            continue
        lower, upper = path.min(0), path.max(0)
        work, buffer, still = np.zeros((300, 3)), np.zeros((300, 3)), np.zeros(3)
        work[: len(path)] = path
        before = travel.travel_time(blocked, GRID, work, len(path), still, PACE)
        count = travel.quicken(
            blocked, blocked, GRID, lower, upper, work, len(path), still, PACE, 100, seed_generator(3), buffer
        )
        after = travel.travel_time(blocked, GRID, work, count, still, PACE)
        gained += after < before
        assert after <= before and 2 <= count <= len(path)
        np.testing.assert_array_equal(work[[0, count - 1]], path[[0, -1]])
        assert ((work[:count] >= lower) & (work[:count] <= upper)).all()
        assert all(segment_free(blocked, GRID, a, b) for a, b in zip(work[: count - 1], work[1:count], strict=True))
    assert gained > 10


def test_the_speed_profile_holds_every_limit_and_is_as_fast_as_one_of_them_allows():
    wide = np.zeros(GRID.size, np.int16)
    wide.reshape(GRID.nx, GRID.ny, GRID.nz)[10:13] = 1
    curve, arc, speed, _ = timed(zigzag(), wide=wide)
    top = np.full(len(curve), LIMITS.speed)
    for i, sample in enumerate(curve):
        cell = naive.cell_of(GRID, sample)
        if cell is not None and wide[naive.flat(GRID, cell)]:
            top[i] = LIMITS.tight_speed
    bends = np.zeros(len(curve))
    for i in range(1, len(curve) - 1):
        ahead, behind = curve[i + 1] - curve[i], curve[i] - curve[i - 1]
        h, k = np.linalg.norm(ahead), np.linalg.norm(behind)
        bends[i] = np.linalg.norm(ahead / h - behind / k) / (0.5 * (h + k))
    segments = 0.5 * (bends[:-1] + bends[1:])
    for i in range(len(curve)):
        sharpest = max(bends[i], segments[max(i - 1, 0) : i + 1].max())
        top[i] = min(top[i], np.sqrt(LIMITS.lateral / sharpest)) if sharpest > 1e-9 else top[i]
    rates = np.diff(speed**2) / (2.0 * np.diff(arc))
    assert (speed <= top + 1e-9).all()
    assert speed[0] == speed[-1] == 0.0
    assert (np.abs(rates) <= LIMITS.tangential + 1e-9).all()
    limited = np.isclose(speed, top)
    limited[:-1] |= np.isclose(np.abs(rates), LIMITS.tangential)
    limited[1:] |= np.isclose(np.abs(rates), LIMITS.tangential)
    assert limited.all()


def test_samples_lie_on_the_curve_at_equal_times():
    curve, _, _, points = timed(zigzag())
    away = np.array([np.linalg.norm(curve - point, axis=1).min() for point in points[:, :3]])
    assert away.max() < 0.06
    np.testing.assert_array_equal(points[:, 10], 0.02)
    np.testing.assert_allclose(points[-1, :3], curve[-1], atol=1e-9)
    moved = np.linalg.norm(np.diff(points[:, :3], axis=0), axis=1) / 0.02
    middle = 0.5 * np.linalg.norm(points[1:, 4:7] + points[:-1, 4:7], axis=1)
    assert np.abs(moved - middle).max() < 0.2
    np.testing.assert_array_equal(points[-1, 4:7], 0.0)


@pytest.mark.parametrize(("per_point", "look"), [(25, 15), (25, 0), (7, 3), (1, 0)])
def test_held_points_are_the_ends_of_their_intervals_with_the_mean_velocity_ahead(per_point, look):
    *_, dense = timed(zigzag())
    held = np.zeros((trajectory.POINT_LIMIT, 11))
    n = trajectory.hold_points(dense, len(dense), per_point, 0.02, look, held)
    np.testing.assert_allclose(held[:n], naive.hold_points(dense, per_point, 0.02, look), atol=1e-9)


def test_the_index_advances_one_point_when_the_present_one_is_used_up():
    points = np.arange(33.0).reshape(3, 11)
    target = np.full(11, -1.0)
    assert waypoint.advance_index(points, -1, 5.0, target) == 0
    np.testing.assert_array_equal(target, points[0])
    assert waypoint.advance_index(points, 0, 0.02, target) == 0
    assert waypoint.advance_index(points, 0, 1e-12, target) == 1
    np.testing.assert_array_equal(target, points[1])
    assert waypoint.advance_index(points, 2, -0.1, target) == 3
    np.testing.assert_array_equal(target, points[1])


def test_a_remaining_time_that_is_not_a_number_hands_nothing_over():
    assert waypoint.advance_index(np.zeros((3, 11)), 1, np.nan, np.zeros(11)) == 1


@pytest.mark.parametrize("seed", range(5))
def test_the_governed_clock_equals_its_twin(seed):
    random = np.random.default_rng(seed)
    points = scenes.smooth_points(random)
    arc = np.empty(len(points))
    waypoint.arc_lengths(points, arc)
    np.testing.assert_allclose(arc, [naive.length(points[: i + 1, :3]) for i in range(len(points))], atol=1e-9)
    clock = np.array([random.uniform(0.0, 100.0), random.uniform(0.0, 1.0), 0.0])
    for _ in range(80):
        blocked, unknown = (random.choice([np.inf, random.uniform(0.0, 12.0)]) for _ in range(2))
        arguments = points, arc, 0.02, blocked, unknown, 2.5, 0.5, 1.0
        expected = naive.advance_clock(clock.copy(), *arguments)
        waypoint.advance_clock(clock, *arguments)
        np.testing.assert_allclose(clock, expected, rtol=1e-12, atol=1e-12)
