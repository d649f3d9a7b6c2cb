import numpy as np
from hypothesis import assume, given
from hypothesis import strategies as st

from mavfi.kernels.planning import knots, minimum_snap, time_allocation
from mavfi.numerics.voxels import segment_free
from mavfi.pipeline.clearance_map import ClearanceMap
from mavfi.pipeline.control import MAX_YAW_RATE
from mavfi.pipeline.trajectories import TrajectoryGenerator
from mavfi.states import new_state, rows
from tests.core.unit.pipeline.parts import config

coordinate = st.tuples(st.floats(1.0, 19.0), st.floats(1.0, 9.0), st.floats(1.0, 5.0))
paths = st.lists(coordinate, min_size=2, max_size=8).map(np.array)
CURVE_LIMITS = knots.CurveLimits(3.0, 4.5, 2.0, 3.5, 2.5, 4.0, 2.0, 1.5)
WORK = knots.new_work()


def generated(vertices, autopilot, entry=0.0):
    """Points of a trajectory, and the generator that made them."""
    settings_ = config(autopilot, smoothing="minimum_snap")
    generator = TrajectoryGenerator(settings_, ClearanceMap(settings_))
    path = new_state("planning.path", len(vertices))
    rows(path.elements, 3)[:] = vertices
    path.header["junction"] = -1
    path.header["entry_speed"] = entry
    generator.receive(path, 0)
    (state,) = generator.step(0)
    return rows(state.elements, 11), generator


def apart(vertices, least=0.5):
    return bool((np.linalg.norm(np.diff(vertices, axis=0), axis=1) > least).all())


@given(paths)
def test_speed_and_acceleration_keep_to_their_limits_everywhere(vertices):
    assume(apart(vertices))
    points, generator = generated(vertices, "hardened")
    assert generator.fallbacks == 0
    assert np.isfinite(points).all()
    assert np.linalg.norm(points[:, 4:7], axis=1).max() <= 3.0 + 1e-9
    assert np.linalg.norm(points[:, 7:10], axis=1).max() <= 0.9 * 5.0 + 1e-9
    # the numbers are the derivatives of the positions
    moved = np.diff(points[:-1, :3], axis=0) / 0.02
    np.testing.assert_allclose(moved, 0.5 * (points[:-2, 4:7] + points[1:-1, 4:7]), atol=0.02)
    np.testing.assert_allclose(points[-1, :3], vertices[-1], atol=1e-9)
    np.testing.assert_array_equal(points[-1, 4:10], 0.0)
    turns = np.abs(np.angle(np.exp(1j * np.diff(points[:, 3]))))
    assert turns.max() <= MAX_YAW_RATE * 0.02 + 1e-9


@given(paths, st.floats(0.0, 4.5), st.floats(-0.5, 0.5), st.floats(0.0, 3.0))
def test_the_limits_hold_from_any_present_motion(vertices, speed, angle, push):
    """Speed above the limit falls at the braking that is allowed; where no such curve exists, none is given."""
    assume(apart(vertices))
    nothing = np.zeros(ClearanceMap(config()).grid.size, np.int16)
    forward = (vertices[1] - vertices[0]) / np.linalg.norm(vertices[1] - vertices[0])
    side = np.cross(forward, [0.6, 0.0, 0.8])
    velocity = speed * (np.cos(angle) * forward + np.sin(angle) * side / max(np.linalg.norm(side), 1e-9))
    acceleration = push * side
    n = time_allocation.fit(
        nothing,
        nothing,
        ClearanceMap(config()).grid,
        vertices,
        len(vertices),
        velocity,
        acceleration,
        CURVE_LIMITS,
        WORK,
    )
    if n == 0:
        return
    np.testing.assert_allclose(WORK.ends[0, 1], velocity, atol=1e-9)
    np.testing.assert_allclose(WORK.ends[0, 2], acceleration, atol=1e-9)
    fastest = max(CURVE_LIMITS.speed, 1.05 * np.linalg.norm(velocity))
    for k in range(n - 1):
        largest, hardest = minimum_snap.peaks(WORK.ends, k, WORK.times[k])
        assert largest <= fastest + 1e-9
        assert hardest <= CURVE_LIMITS.acceleration + 1e-9


@given(paths)
def test_held_points_come_from_the_same_curve(vertices):
    assume(apart(vertices))
    points, generator = generated(vertices, "published")
    assert generator.fallbacks == 0
    assert np.isfinite(points).all() and ((points[:, 10] > 0.0) & (points[:, 10] <= 0.5)).all()
    before = np.vstack([vertices[:1], points[:-1, :3]])
    assert (np.linalg.norm(points[:, :3] - before, axis=1) / points[:, 10]).max() <= 0.97 * 3.0 + 1e-9


@given(paths, st.integers(0, 1000), st.sampled_from([0.0, 1.5]))
def test_curves_stay_out_of_what_is_blocked(vertices, seed, speed):
    assume(apart(vertices))
    grid = ClearanceMap(config()).grid
    blocked = (np.random.default_rng(seed).random(grid.size) < 0.02).astype(np.int16)
    assume(all(segment_free(blocked, grid, a, b) for a, b in zip(vertices[:-1], vertices[1:], strict=True)))
    velocity = speed * (vertices[1] - vertices[0]) / np.linalg.norm(vertices[1] - vertices[0])
    n = time_allocation.fit(blocked, blocked, grid, vertices, len(vertices), velocity, np.zeros(3), CURVE_LIMITS, WORK)
    if n == 0:
        return  # corners are rounded instead
    points = np.zeros((15_000, 11))
    count = minimum_snap.sample(WORK.ends, WORK.times, n, 0.02, 3.0, 0.0, 1.5, points)
    assert all(
        segment_free(blocked, grid, a[:3], b[:3]) for a, b in zip(points[: count - 1], points[1:count], strict=True)
    )


def test_blends_are_flown_where_no_polynomial_is_found():
    vertices = np.array([[2.0, 2.0, 2.0], [12.0, 2.0, 2.0]])
    points, generator = generated(vertices, "published", entry=5000.0)
    assert generator.fallbacks == 1
    assert len(points) > 1
