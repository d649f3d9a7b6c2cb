"""Minimum-snap polynomials against plain linear algebra and against a spline of scipy."""

from math import factorial

import numpy as np
import pytest
from scipy.interpolate import make_interp_spline

from mavfi.kernels.planning import knots, minimum_snap
from tests.core.unit.kernels.cases import CURVE_LIMITS


def problem(seed, count=None):
    random = np.random.default_rng(seed)
    count = count or int(random.integers(2, 12))
    points = random.uniform(-20, 20, (count, 3))
    times = random.uniform(0.3, 4.0, count - 1)
    return points, times, random.normal(size=3), random.normal(size=3)


def solved(points, times, velocity, acceleration):
    count = len(points)
    ends = np.zeros((count, 4, 3))
    assert minimum_snap.solve(points, times, count, velocity, acceleration, np.zeros((count, 3, 6)), ends)
    return ends


def polynomials(points, times, ends):
    """Coefficients in seconds, with the position of the start. Shape (segments, 8, 3)."""
    coefficients = np.zeros((len(times), 8, 3))
    for k, time in enumerate(times):
        minimum_snap.coefficients(ends, k, time, coefficients[k])
        coefficients[k] /= time ** np.arange(8)[:, None]
        coefficients[k, 0] += points[k]
    return coefficients


def row(time, order):
    """What each coefficient adds to a derivative."""
    return np.array([0.0 if k < order else factorial(k) / factorial(k - order) * time ** (k - order) for k in range(8)])


@pytest.mark.parametrize("seed", range(20))
def test_the_curve_is_the_spline_of_degree_seven(seed):
    """A free jerk at the ends of a curve of least snap means that its snap is zero there."""
    points, times, velocity, acceleration = problem(100 + seed)
    ends = solved(points, times, velocity, acceleration)
    instants = np.concatenate([[0.0], np.cumsum(times)])
    nought = np.zeros(3)
    spline = make_interp_spline(
        instants,
        points,
        k=7,
        bc_type=([(1, velocity), (2, acceleration), (4, nought)], [(1, nought), (2, nought), (4, nought)]),
    )
    polynomial, value = np.zeros((8, 3)), np.zeros(9)
    for k, time in enumerate(times):
        minimum_snap.coefficients(ends, k, time, polynomial)
        for u in np.linspace(0.0, 1.0, 7):
            minimum_snap.evaluate(polynomial, points[k], time, u, value)
            at = instants[k] + u * time
            for order in range(3):
                wanted = spline(at, order)
                np.testing.assert_allclose(value[3 * order : 3 * order + 3], wanted, rtol=1e-6, atol=1e-5)


@pytest.mark.parametrize("seed", range(10))
def test_peaks_bound_speed_and_acceleration_closely(seed):
    points, times, velocity, acceleration = problem(300 + seed)
    ends = solved(points, times, velocity, acceleration)
    polynomial, value = np.zeros((8, 3)), np.zeros(9)
    for k, time in enumerate(times):
        minimum_snap.coefficients(ends, k, time, polynomial)
        largest = np.zeros(2)
        for u in np.linspace(0.0, 1.0, 400):
            minimum_snap.evaluate(polynomial, points[k], time, u, value)
            largest = np.maximum(largest, [np.linalg.norm(value[3:6]), np.linalg.norm(value[6:])])
        bounds = np.array(minimum_snap.peaks(ends, k, time))
        assert (bounds >= largest * (1.0 - 1e-9)).all()
        assert (bounds <= largest * 1.15).all()


def test_samples_are_the_curve_at_equal_times():
    points, times, velocity, acceleration = problem(7, 6)
    ends = solved(points, times, velocity, acceleration)
    dense = np.zeros((2000, 11))
    count = minimum_snap.sample(ends, times, 6, 0.02, 3.0, np.nan, 1.5, dense)
    coefficients, instants = polynomials(points, times, ends), np.concatenate([[0.0], np.cumsum(times)])
    assert count == int(np.ceil(instants[-1] / 0.02)) + 1
    for n in range(count - 1):
        k = int(np.searchsorted(instants, 0.02 * n + 1e-12, side="right")) - 1
        late = 0.02 * n - instants[k]
        for order, first in ((0, 0), (1, 4), (2, 7)):
            np.testing.assert_allclose(
                dense[n, first : first + 3], row(late, order) @ coefficients[k], rtol=1e-6, atol=1e-6
            )
    np.testing.assert_array_equal(dense[count - 1, :3], points[-1])
    np.testing.assert_array_equal(dense[count - 1, 4:10], 0.0)


def test_a_full_list_of_points_ends_at_rest_on_the_curve():
    points, times, velocity, acceleration = problem(8, 6)
    ends = solved(points, times, velocity, acceleration)
    dense, part = np.zeros((2000, 11)), np.zeros((50, 11))
    minimum_snap.sample(ends, times, 6, 0.02, 3.0, np.nan, 1.5, dense)
    assert minimum_snap.sample(ends, times, 6, 0.02, 3.0, np.nan, 1.5, part) == 50
    np.testing.assert_array_equal(part[:49, :3], dense[:49, :3])
    assert np.linalg.norm(part[49, :3] - dense[48, :3]) < 0.2
    np.testing.assert_array_equal(part[49, 4:10], 0.0)


def test_yaw_turns_to_the_course_at_its_limit():
    """Half a turn at 1.5 rad/s takes 2.1 s; after that the vehicle looks along the line."""
    points = np.array([[0.0, 0.0, 2.0], [20.0, 0.0, 2.0]])
    ends = solved(points, np.array([10.0]), np.zeros(3), np.zeros(3))
    dense = np.zeros((2000, 11))
    count = minimum_snap.sample(ends, np.array([10.0]), 2, 0.02, 3.0, 3.0, 1.5, dense)
    turns = np.abs(np.diff(np.unwrap(dense[:count, 3])))
    assert turns.max() <= 0.03 + 1e-12
    assert turns[:90].min() > 0.029
    np.testing.assert_allclose(dense[110 : count - 40, 3], 0.0, atol=1e-9)


def test_knots_lie_on_the_path_in_order_around_large_turns_and_at_small_ones():
    path = np.array([[0.0, 0.0, 2.0], [12.0, 0.0, 2.0], [12.0, 8.0, 2.0], [13.0, 14.0, 2.0]])
    work = knots.new_work()
    count = knots.first_knots(path, 4, CURVE_LIMITS, work)
    knots.place(path, 4, work, count)
    at = work.arc[:count]
    lengths = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    expected = [np.interp(at, lengths, path[:, axis]) for axis in range(3)]
    np.testing.assert_allclose(work.points[:count].T, expected, atol=1e-9)
    assert (np.diff(at) > 0.0).all()
    assert np.diff(at)[at[:-1] != 10.0].max() <= CURVE_LIMITS.spacing + 1e-9
    assert {10.0, 14.0, 20.0} <= set(np.round(at, 9))
    assert 12.0 not in np.round(at, 9)
    before = count
    assert knots.insert(work, count, 13.0) == before + 1
    assert knots.insert(work, before + 1, 13.01) == before + 1
    assert (np.diff(work.arc[: before + 1]) > 0.0).all()
