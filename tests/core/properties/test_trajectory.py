import numpy as np
from hypothesis import assume, given
from hypothesis import strategies as st

from mavfi.kernels.planning import trajectory
from mavfi.numerics.voxels import segment_free
from mavfi.pipeline.clearance_map import ClearanceMap
from mavfi.pipeline.trajectories import TrajectoryGenerator
from mavfi.states import new_state, rows
from tests.core.unit.pipeline.parts import config

V_TOLERANCE = 1.02
"""The step in which the limit is reached is a little too long."""
A_TOLERANCE_SHARP = 1.1
"""Mean acceleration over 0.2 s / a_max for turns of any angle; turns of less than a right angle keep to a_max always.

A reversal happens between two samples of the curve, 0.1 m, where a direction cannot turn evenly.
"""

coordinate = st.tuples(st.floats(1.0, 19.0), st.floats(1.0, 9.0), st.floats(1.0, 5.0))
paths = st.lists(coordinate, min_size=2, max_size=8).map(np.array)


def points_of(vertices, autopilot):
    settings_ = config(autopilot)
    generator = TrajectoryGenerator(settings_, ClearanceMap(settings_))
    path = new_state("planning.path", len(vertices))
    rows(path.elements, 3)[:] = vertices
    path.header["junction"] = -1
    generator.receive(path, 0)
    (state,) = generator.step(0)
    return rows(state.elements, trajectory.POINT_WIDTH), settings_


def mean_acceleration(points, window=10):
    """Largest change of the velocity over some points, 0.2 s by default, as an acceleration (m/s^2)."""
    velocity = np.vstack([np.zeros((window, 3)), points[:, 4:7], np.zeros((window, 3))])
    return np.linalg.norm(velocity[window:] - velocity[:-window], axis=1).max() / (0.02 * window)


@given(paths)
def test_trajectories_keep_to_the_limits_of_speed_and_acceleration(vertices):
    legs = np.diff(vertices, axis=0)
    lengths = np.linalg.norm(legs, axis=1)
    assume(lengths.min() > 0.5)
    points, rules = points_of(vertices, "hardened")
    assert np.isfinite(points).all() and (points[:, 10] == 0.02).all()
    assert np.linalg.norm(points[:, 4:7], axis=1).max() <= V_TOLERANCE * rules.v_max
    moved = np.linalg.norm(np.diff(points[:, :3], axis=0), axis=1) / 0.02
    assert moved.max() <= V_TOLERANCE * rules.v_max
    np.testing.assert_allclose(points[-1, :3], vertices[-1], atol=1e-6)
    np.testing.assert_array_equal(points[-1, 4:7], 0.0)
    gentle = ((legs[:-1] * legs[1:]).sum(1) > 0.0).all()
    if gentle:
        assert mean_acceleration(points, window=1) <= rules.a_max
    assert mean_acceleration(points) <= A_TOLERANCE_SHARP * rules.a_max


@given(paths, st.integers(0, 1000), st.sampled_from([0.2, 1.0 / 3.0]))
def test_blends_stay_out_of_what_is_blocked(vertices, seed, inner):
    assume((np.linalg.norm(np.diff(vertices, axis=0), axis=1) > 0.5).all())
    clearance = ClearanceMap(config("hardened"))
    blocked = (np.random.default_rng(seed).random(clearance.grid.size) < 0.03).astype(np.int16)
    assume(all(segment_free(blocked, clearance.grid, a, b) for a, b in zip(vertices[:-1], vertices[1:], strict=True)))
    corners, curve = np.zeros((trajectory.CURVE_LIMIT, 3)), np.zeros((trajectory.CURVE_LIMIT, 3))
    count = trajectory.smooth(blocked, clearance.grid, vertices, len(vertices), 2.0, inner, corners, curve)
    length = np.linalg.norm(np.diff(vertices, axis=0), axis=1).sum()
    assert np.linalg.norm(np.diff(curve[:count], axis=0), axis=1).sum() <= length + 1e-6
    free = [segment_free(blocked, clearance.grid, sample, sample) for sample in curve[:count]]
    assert np.mean(free) > 0.99  # evenly spaced samples may cut a corner of the finer blend
