"""Error-state Kalman filter: position, velocity, attitude and IMU biases from an IMU, position fixes and a compass.

After J. Solà, *Quaternion kinematics for the error-state Kalman filter*, arXiv:1711.02508, sections 5.4 (discrete
motion of the nominal and of the error state) and 6 (correction; attitude errors are local, and the error reset is
approximated by the identity, section 6.3).  Gravity is known.  The numbers of a fix are processed one after the other,
which is equivalent for uncorrelated noise.
"""

import math
from typing import NamedTuple

import numpy as np

from mavfi.numerics.elementary import cos, sin
from mavfi.numerics.jit import kernel_jit
from mavfi.numerics.rotations import rotation_matrix, turn, wrap_angle, yaw_of

GRAVITY = 9.80665
"""m/s^2, along -z."""
NOMINAL_WIDTH = 16
"""Position (m), velocity (m/s), quaternion w x y z, biases of accelerometer (m/s^2) and gyro (rad/s)."""
ERROR_WIDTH = 15
"""Errors of position, velocity, attitude (rotation vector in the body frame, rad), and both biases."""
FIX_WIDTH = 4
"""Position (m) and heading (rad), world frame."""
GATE = 30.0
"""Largest squared innovation of an accepted fix."""

_POSITION, _VELOCITY, _ATTITUDE, _FORCE_BIAS, _RATE_BIAS = 0, 3, 6, 9, 12
LARGEST_FORCE, LARGEST_RATE = 160.0, 35.0
"""Range of the sensor by axis: 16 g (m/s^2) and 2000 deg/s (rad/s) of an MPU-6000."""
_LONGEST_STEP = 0.1
_LEAST_VARIANCE = 1e-12
_LARGEST_POSITION = 1e6


class Noise(NamedTuple):
    """Sensor noise assumed by the filter.

    Attributes:
        force: White noise of the accelerometer (m/s^2 sqrt(s)).
        rate: White noise of the gyro (rad/s sqrt(s)).
        force_walk: Random walk of the accelerometer bias (m/s^2 / sqrt(s)).
        rate_walk: Random walk of the gyro bias (rad/s / sqrt(s)).
        position: Standard deviation of a fix (m).
        heading: Standard deviation of the compass (rad).
    """

    force: float
    rate: float
    force_walk: float
    rate_walk: float
    position: float
    heading: float


class Spread(NamedTuple):
    """Initial standard deviations: velocity (m/s), tilt (rad), biases (m/s^2, rad/s)."""

    velocity: float
    tilt: float
    force_bias: float
    rate_bias: float


@kernel_jit
def usable_sample(sample: np.ndarray) -> bool:
    """Whether a sample is within the sensor's range; NaN is not.

    Args:
        sample: Specific force (m/s^2) and rates (rad/s). Shape (6,).
    """
    for axis in range(3):
        if not (abs(sample[axis]) <= LARGEST_FORCE and abs(sample[3 + axis]) <= LARGEST_RATE):
            return False
    return True


@kernel_jit
def usable_fix(fix: np.ndarray) -> bool:
    """Whether a fix is finite and plausible.

    Args:
        fix: Position (m) and heading (rad). Shape (4,).
    """
    for axis in range(3):
        if not abs(fix[axis]) <= _LARGEST_POSITION:
            return False
    return bool(abs(fix[3]) <= 2.0 * math.pi)


@kernel_jit
def align(nominal: np.ndarray, covariance: np.ndarray, fix: np.ndarray, noise: Noise, spread: Spread) -> None:
    """Initialize at a fix: level, without bias, with unchanged velocity.

    Args:
        nominal: Output, except the velocity. Shape (16,).
        covariance: Output. Shape (15, 15).
        fix: Position (m) and heading (rad). Shape (4,).
        noise: Noise of the fix.
        spread: Initial standard deviations of all other quantities.
    """
    nominal[0], nominal[1], nominal[2] = fix[0], fix[1], fix[2]
    nominal[6], nominal[7], nominal[8], nominal[9] = cos(0.5 * fix[3]), 0.0, 0.0, sin(0.5 * fix[3])
    for i in range(10, NOMINAL_WIDTH):
        nominal[i] = 0.0
    for i in range(ERROR_WIDTH):
        for j in range(ERROR_WIDTH):
            covariance[i, j] = 0.0
    for axis in range(3):
        covariance[_POSITION + axis, _POSITION + axis] = noise.position**2
        covariance[_VELOCITY + axis, _VELOCITY + axis] = spread.velocity**2
        covariance[_ATTITUDE + axis, _ATTITUDE + axis] = spread.tilt**2
        covariance[_FORCE_BIAS + axis, _FORCE_BIAS + axis] = spread.force_bias**2
        covariance[_RATE_BIAS + axis, _RATE_BIAS + axis] = spread.rate_bias**2
    covariance[_ATTITUDE + 2, _ATTITUDE + 2] = noise.heading**2


@kernel_jit
def transition_of(rotation: np.ndarray, force: np.ndarray, rates: np.ndarray, dt: float) -> np.ndarray:
    """Transition matrix of the error over one step (Solà, section 5.4.3).

    Args:
        rotation: Body to world before the step. Shape (3, 3).
        force: Specific force without bias, body frame (m/s^2). Shape (3,).
        rates: Rates without bias, body frame (rad/s). Shape (3,).
        dt: Step (s).

    Returns:
        Shape (15, 15).
    """
    matrix = np.eye(ERROR_WIDTH)
    back = np.array((1.0, 0.0, 0.0, 0.0))
    turn(back, -rates[0] * dt, -rates[1] * dt, -rates[2] * dt)
    turned = np.empty((3, 3))
    rotation_matrix(back, turned)
    for i in range(3):
        matrix[_POSITION + i, _VELOCITY + i] = dt
        matrix[_ATTITUDE + i, _RATE_BIAS + i] = -dt
        # row i of -R [f]x
        matrix[_VELOCITY + i, _ATTITUDE] = -(rotation[i, 1] * force[2] - rotation[i, 2] * force[1]) * dt
        matrix[_VELOCITY + i, _ATTITUDE + 1] = -(rotation[i, 2] * force[0] - rotation[i, 0] * force[2]) * dt
        matrix[_VELOCITY + i, _ATTITUDE + 2] = -(rotation[i, 0] * force[1] - rotation[i, 1] * force[0]) * dt
        for j in range(3):
            matrix[_VELOCITY + i, _FORCE_BIAS + j] = -rotation[i, j] * dt
            matrix[_ATTITUDE + i, _ATTITUDE + j] = turned[i, j]
    return matrix


@kernel_jit
def _carry(covariance: np.ndarray, matrix: np.ndarray) -> None:
    """P <- F P F^T; sums in a fixed order, bit-identical on every processor."""
    half = np.zeros((ERROR_WIDTH, ERROR_WIDTH))
    for i in range(ERROR_WIDTH):
        for k in range(ERROR_WIDTH):
            factor = matrix[i, k]
            if factor != 0.0:
                for j in range(ERROR_WIDTH):
                    half[i, j] += factor * covariance[k, j]
    for i in range(ERROR_WIDTH):
        for j in range(i, ERROR_WIDTH):
            total = 0.0
            for k in range(ERROR_WIDTH):
                total += half[i, k] * matrix[j, k]
            covariance[i, j] = total
            covariance[j, i] = total


@kernel_jit
def predict(nominal: np.ndarray, covariance: np.ndarray, sample: np.ndarray, dt: float, noise: Noise) -> None:
    """Propagate the state over one IMU sample (Solà, section 5.4).

    Args:
        nominal: Updated. Shape (16,).
        covariance: Updated. Shape (15, 15).
        sample: Specific force (m/s^2) and rates (rad/s), body frame, mean over the step; see `usable_sample`.
            Shape (6,).
        dt: Step (s); steps above 0.1 s or not above 0 have no effect.
        noise: Noise of the IMU.
    """
    if not 0.0 < dt <= _LONGEST_STEP:
        return
    rotation = np.empty((3, 3))
    rotation_matrix(nominal[6:10], rotation)
    force = sample[:3] - nominal[10:13]
    rates = sample[3:6] - nominal[13:16]
    _carry(covariance, transition_of(rotation, force, rates, dt))
    for axis in range(3):
        covariance[_VELOCITY + axis, _VELOCITY + axis] += noise.force**2 * dt
        covariance[_ATTITUDE + axis, _ATTITUDE + axis] += noise.rate**2 * dt
        covariance[_FORCE_BIAS + axis, _FORCE_BIAS + axis] += noise.force_walk**2 * dt
        covariance[_RATE_BIAS + axis, _RATE_BIAS + axis] += noise.rate_walk**2 * dt
        a = rotation[axis, 0] * force[0] + rotation[axis, 1] * force[1] + rotation[axis, 2] * force[2]
        if axis == 2:
            a -= GRAVITY
        nominal[axis] += nominal[3 + axis] * dt + 0.5 * a * dt * dt
        nominal[3 + axis] += a * dt
    turn(nominal[6:10], rates[0] * dt, rates[1] * dt, rates[2] * dt)


@kernel_jit
def heading_row(quaternion: np.ndarray) -> tuple[float, float]:
    """Derivative of the heading with respect to the local attitude error about body y and z; about x it is zero.

    Args:
        quaternion: Unit quaternion w x y z. Shape (4,).
    """
    r = np.empty((3, 3))
    rotation_matrix(quaternion, r)
    level = r[0, 0] * r[0, 0] + r[1, 0] * r[1, 0]
    if not level > 1e-6:
        return 0.0, 0.0  # nose up or down: the heading is undefined
    return (r[1, 0] * r[0, 2] - r[0, 0] * r[1, 2]) / level, (r[0, 0] * r[1, 1] - r[1, 0] * r[0, 1]) / level


@kernel_jit
def _absorb(error: np.ndarray, covariance: np.ndarray, row: np.ndarray, innovation: float, variance: float) -> float:
    """Apply one measured number to the error and its covariance; returns squared innovation / its variance."""
    gain = np.zeros(ERROR_WIDTH)
    for i in range(ERROR_WIDTH):
        innovation -= row[i] * error[i]
        for j in range(ERROR_WIDTH):
            gain[i] += covariance[i, j] * row[j]
    variance = max(variance, _LEAST_VARIANCE)
    for i in range(ERROR_WIDTH):
        variance += row[i] * gain[i]
    for i in range(ERROR_WIDTH):
        error[i] += gain[i] / variance * innovation
        for j in range(ERROR_WIDTH):
            covariance[i, j] -= gain[i] * gain[j] / variance
    return innovation * innovation / variance


@kernel_jit
def _inject(nominal: np.ndarray, error: np.ndarray) -> None:
    """Add the error to the nominal state."""
    for axis in range(3):
        nominal[axis] += error[_POSITION + axis]
        nominal[3 + axis] += error[_VELOCITY + axis]
        nominal[10 + axis] += error[_FORCE_BIAS + axis]
        nominal[13 + axis] += error[_RATE_BIAS + axis]
    turn(nominal[6:10], error[_ATTITUDE], error[_ATTITUDE + 1], error[_ATTITUDE + 2])


@kernel_jit
def correct(nominal: np.ndarray, covariance: np.ndarray, fix: np.ndarray, noise: Noise) -> float:
    """Apply a fix, unless it is too improbable (Solà, section 6).

    Args:
        nominal: Updated. Shape (16,).
        covariance: Updated. Shape (15, 15).
        fix: Position (m) and heading (rad); see `usable_fix`. Shape (4,).
        noise: Noise of the fix.

    Returns:
        Squared innovation in units of its covariance, chi-square with 4 degrees of freedom.  Above 30, or NaN, the
        fix is rejected without effect (5e-6 of valid fixes).
    """
    error = np.zeros(ERROR_WIDTH)
    updated = covariance.copy()
    row = np.zeros(ERROR_WIDTH)
    distance = 0.0
    for axis in range(3):
        row[:] = 0.0
        row[_POSITION + axis] = 1.0
        distance += _absorb(error, updated, row, fix[axis] - nominal[axis], noise.position**2)
    row[:] = 0.0
    row[_ATTITUDE + 1], row[_ATTITUDE + 2] = heading_row(nominal[6:10])
    distance += _absorb(error, updated, row, wrap_angle(fix[3] - yaw_of(nominal[6:10])), noise.heading**2)
    if distance <= GATE:
        covariance[:, :] = updated
        _inject(nominal, error)
    return distance
