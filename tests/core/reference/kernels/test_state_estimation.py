"""The state estimator against a plain twin, closed forms, SciPy's Riccati equation and the law of its own errors."""

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from mavfi.kernels.perception import state_estimation as filtering
from tests.core.reference.kernels.estimation import AIRSIM, WEIGHT, Motion, Twin, heading, rotation_of, start_of

DT = 0.004
STEPS_PER_FIX = 25
SPREAD = np.repeat([0.05, 0.1, 0.02], 3)
PERFECT = filtering.Noise(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def covariance_of(deviations=SPREAD, biases=(0.002, 0.0002)):
    return np.diag(np.concatenate([deviations, np.repeat(biases, 3)]) ** 2)


@pytest.mark.parametrize("seed", range(4))
def test_many_steps_equal_the_textbook(seed):
    random = np.random.default_rng(seed)
    motion = Motion(seed)
    nominal = start_of(motion, SPREAD * random.standard_normal(9))
    covariance = covariance_of()
    twin = Twin(nominal, covariance, AIRSIM)
    for step in range(1, 301):
        sample = motion.step() + random.standard_normal(6) * 0.02
        filtering.predict(nominal, covariance, sample, DT, AIRSIM)
        twin.predict(sample, DT)
        if step % 20 == 0:
            fix = motion.fix + random.standard_normal(4) * 0.03
            distance = filtering.correct(nominal, covariance, fix, AIRSIM)
            assert distance == pytest.approx(twin.correct(fix), rel=1e-5)
        assert twin.difference(nominal) < 1e-8
        np.testing.assert_allclose(covariance, twin.covariance, atol=1e-10)
    assert np.linalg.norm(nominal[6:10]) == pytest.approx(1.0, abs=1e-12)


def test_without_noise_a_wrong_start_is_found_out():
    motion = Motion(1)
    nominal = start_of(motion, np.array([0.05, -0.05, 0.02, 0.1, -0.1, 0.1, 0.01, 0.02, -0.02]))
    covariance = covariance_of(biases=(0.0, 0.0))
    noise = PERFECT._replace(position=1e-4, heading=1e-4)
    for step in range(1, 2501):
        filtering.predict(nominal, covariance, motion.step(), DT, noise)
        if step % STEPS_PER_FIX == 0:
            filtering.correct(nominal, covariance, motion.fix, noise)
    assert np.abs(motion.error(nominal)).max() < 2e-4


def hovering(yaw):
    nominal = np.zeros(filtering.NOMINAL_WIDTH)
    nominal[6], nominal[9] = np.cos(0.5 * yaw), np.sin(0.5 * yaw)
    return nominal


@pytest.mark.parametrize("yaw", [0.0, 2.0])
def test_at_rest_its_covariance_becomes_that_of_the_riccati_equation(yaw):
    """With known biases: tilt is seen through the velocity, all nine errors settle."""
    noise = AIRSIM._replace(force=0.05, rate=0.01, force_walk=0.0, rate_walk=0.0)
    nominal, covariance = hovering(yaw), covariance_of(biases=(0.0, 0.0))
    sample = np.concatenate([-WEIGHT, np.zeros(3)])
    fix = np.array([0.0, 0.0, 0.0, yaw])
    for step in range(STEPS_PER_FIX * 200):
        if step % STEPS_PER_FIX == 0:
            before = covariance.copy()
            filtering.correct(nominal, covariance, fix, noise)
        filtering.predict(nominal, covariance, sample, DT, noise)
    body = rotation_of(nominal[6:10]).as_matrix()
    once = np.eye(9)
    once[0:3, 3:6] = np.eye(3) * DT
    f = -WEIGHT
    once[3:6, 6:9] = -body @ np.array([[0, -f[2], f[1]], [f[2], 0, -f[0]], [-f[1], f[0], 0]]) * DT
    added = np.diag(np.repeat([0.0, noise.force**2, noise.rate**2], 3)) * DT
    whole, total = np.eye(9), np.zeros((9, 9))
    for _ in range(STEPS_PER_FIX):
        whole, total = once @ whole, once @ total @ once.T + added
    rows = np.zeros((4, 9))
    rows[:3, :3], rows[3, 8] = np.eye(3), 1.0
    measured = np.diag([noise.position**2] * 3 + [noise.heading**2])
    expected = solve_discrete_are(whole.T, rows.T, total, measured)
    np.testing.assert_allclose(before[:9, :9], expected, rtol=1e-6, atol=1e-12)


@pytest.mark.slow
def test_its_errors_are_as_large_as_it_says():
    """NEES (Bar-Shalom, Li & Kirubarajan 2001, section 5.4.2): over 10 flights within the bounds of chi-square."""
    flights, sums, instants = 10, {}, (250, 500, 1000)
    n = AIRSIM._replace(force_walk=1e-3, rate_walk=1e-4)
    white = np.repeat([n.force, n.rate], 3) / np.sqrt(DT)
    walk = np.repeat([n.force_walk, n.rate_walk], 3) * np.sqrt(DT)
    for seed in range(flights):
        random, motion = np.random.default_rng(100 + seed), Motion(seed)
        bias = np.repeat([0.002, 0.0002], 3) * random.standard_normal(6)
        nominal, covariance = start_of(motion, SPREAD * random.standard_normal(9)), covariance_of()
        for step in range(1, instants[-1] + 1):
            bias = bias + walk * random.standard_normal(6)
            filtering.predict(nominal, covariance, motion.step() + bias + white * random.standard_normal(6), DT, n)
            if step % STEPS_PER_FIX == 0:
                fix = motion.fix + np.array([n.position] * 3 + [n.heading]) * random.standard_normal(4)
                filtering.correct(nominal, covariance, fix, n)
            if step in instants:
                error = np.concatenate([motion.error(nominal), bias - nominal[10:]])
                sums[step] = sums.get(step, 0.0) + error @ np.linalg.solve(covariance, error)
    low, high = chi2.ppf([1e-3, 1 - 1e-3], 15 * flights)
    for step, total in sums.items():
        assert low < total < high, (step, total / flights)


def test_the_row_of_the_heading_is_its_derivative():
    random = np.random.default_rng(0)
    for _ in range(20):
        attitude = Rotation.from_euler("ZYX", random.uniform((-3, -1, -1), (3, 1, 1)))
        y, z = filtering.heading_row(attitude.as_quat(scalar_first=True))
        for axis, expected in enumerate((0.0, y, z)):
            step = 1e-6 * np.eye(3)[axis]
            ends = [heading(attitude * Rotation.from_rotvec(sign * step)) for sign in (1, -1)]
            assert np.angle(np.exp(1j * (ends[0] - ends[1]))) / 2e-6 == pytest.approx(expected, abs=1e-6)
    assert filtering.heading_row(Rotation.from_euler("Y", 0.5 * np.pi).as_quat(scalar_first=True)) == (0.0, 0.0)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e30, -1e300, 200.0])
@pytest.mark.parametrize("index", range(6))
def test_a_sample_that_no_sensor_gives_is_not_usable(index, value):
    sample = np.array([0.0, 0.0, 9.8, 0.1, 0.2, 0.3])
    assert filtering.usable_sample(sample)
    sample[index] = value
    assert not filtering.usable_sample(sample)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e30, 1e300])
@pytest.mark.parametrize("index", range(4))
def test_a_fix_that_is_no_place_is_not_usable_and_would_be_refused(index, value):
    nominal, covariance = hovering(0.3), covariance_of()
    fix = np.array([0.0, 0.0, 0.0, 0.3])
    assert filtering.usable_fix(fix)
    fix[index] = value
    assert not filtering.usable_fix(fix)
    if index < 3 or not np.isfinite(value):
        before = nominal.copy(), covariance.copy()
        assert not filtering.correct(nominal, covariance, fix, AIRSIM) <= filtering.GATE
        np.testing.assert_array_equal(nominal, before[0])
        np.testing.assert_array_equal(covariance, before[1])


@pytest.mark.parametrize("dt", [0.0, -1.0, 0.2, np.nan, np.inf])
def test_a_step_that_cannot_be_changes_nothing(dt):
    nominal, covariance = hovering(0.3), covariance_of()
    filtering.predict(nominal, covariance, np.ones(6), dt, AIRSIM)
    np.testing.assert_array_equal(nominal, hovering(0.3))
    np.testing.assert_array_equal(covariance, covariance_of())
