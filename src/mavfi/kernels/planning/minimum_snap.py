"""Minimum-snap polynomials: one of degree 7 per segment, through given points at given times.

Of all curves through the points with given initial velocity and acceleration that end at rest, this has the least
integral of squared snap (Mellinger & Kumar 2011), in the unconstrained form of Richter, Bry & Roy 2013: the unknowns
are velocity, acceleration and jerk at the points, three per point, coupled only to the neighbouring points; so a
block-tridiagonal system is solved.  Derivatives up to the sixth are continuous.
"""

import math
from math import comb

import numpy as np

from mavfi.kernels.planning.path import distance
from mavfi.kernels.planning.trajectory import POINT_WIDTH
from mavfi.numerics.elementary import atan2
from mavfi.numerics.jit import kernel_jit
from mavfi.numerics.vectors import product

KNOT_LIMIT = 1500
"""Largest number of points of one curve."""
_LONGEST = 1e4
_SHORTEST = 1e-4
"""Shortest and longest segment (s)."""
_HUGE = 1e6
"""Upper bound on the derivatives of a valid curve (SI units)."""
_PIECES = 4

# Rows: contributions of p, v, a, j at the start and at the end of a segment of duration 1 to the coefficients of
# 1, u .. u^7 (two-point Hermite interpolation).
BASIS = np.array(
    [
        [1.0, 0.0, 0.0, 0.0, -35.0, 84.0, -70.0, 20.0],
        [0.0, 1.0, 0.0, 0.0, -20.0, 45.0, -36.0, 10.0],
        [0.0, 0.0, 0.5, 0.0, -5.0, 10.0, -7.5, 2.0],
        [0.0, 0.0, 0.0, 1.0 / 6.0, -2.0 / 3.0, 1.0, -2.0 / 3.0, 1.0 / 6.0],
        [0.0, 0.0, 0.0, 0.0, 35.0, -84.0, 70.0, -20.0],
        [0.0, 0.0, 0.0, 0.0, -15.0, 39.0, -34.0, 10.0],
        [0.0, 0.0, 0.0, 0.0, 2.5, -7.0, 6.5, -2.0],
        [0.0, 0.0, 0.0, 0.0, -1.0 / 6.0, 0.5, -0.5, 1.0 / 6.0],
    ]
)


def _snap_costs() -> np.ndarray:
    """Q of the cost d' Q d, d = the eight end values of a segment of duration 1. Shape (8, 8)."""
    factor = np.array([math.perm(k + 4, 4) for k in range(4)], float)
    snap = BASIS[:, 4:] * factor
    powers = 1.0 / (np.arange(4)[:, None] + np.arange(4)[None, :] + 1.0)
    return product(product(snap, powers), snap.T)


def _velocity_pieces() -> np.ndarray:
    """End values -> Bezier control points of the velocity in each quarter of a segment. Shape (4, 7, 8)."""
    velocity: np.ndarray = BASIS[:, 1:] * np.arange(1, 8)
    pieces = np.zeros((_PIECES, 7, 8))
    for piece in range(_PIECES):
        for j in range(7):
            for k in range(j + 1):
                # coefficient k of the same polynomial in w, u = (piece + w) / 4
                shifted = sum(velocity[:, m] * comb(m, k) * piece ** (m - k) / _PIECES**m for m in range(k, 7))
                pieces[piece, j] += comb(j, k) / comb(6, k) * shifted
    return pieces


SNAP = _snap_costs()
_VELOCITY = _velocity_pieces()


@kernel_jit
def _power(base: float, exponent: int) -> float:
    """A power with an exponent above 0, by multiplication."""
    result = base
    for _ in range(exponent - 1):
        result *= base
    return result


@kernel_jit
def _add_segment(
    time: float, points: np.ndarray, k: int, rows: np.ndarray, this_end: int, other_end: int, other_column: int
) -> None:
    """Add the terms of segment k to the equations for the unknowns at one of its ends.

    Args:
        time: Duration of the segment (s).
        points: Shape (n, 3).
        k: Segment, from point k to k + 1.
        rows: Changed: coefficients of the previous, this and the next unknowns, right-hand side. Shape (3, 12).
        this_end: First index of the unknowns at this end among the eight end values: 1 or 5.
        other_end: First index of the neighbour's unknowns: 5 or 1.
        other_column: Column of `rows` for the unknowns of the other end: 0 or 6.
    """
    for i in range(3):
        for j in range(3):
            power = 1.0 / _power(time, 5 - i - j)
            rows[i, 3 + j] += SNAP[this_end + i, this_end + j] * power
            rows[i, other_column + j] += SNAP[this_end + i, other_end + j] * power
        scale = SNAP[this_end + i, 4] / _power(time, 6 - i)
        for axis in range(3):
            rows[i, 9 + axis] -= scale * (points[k + 1, axis] - points[k, axis])


@kernel_jit
def _fix(rows: np.ndarray, velocity: np.ndarray, acceleration: np.ndarray) -> None:
    """Replace the equations for velocity and acceleration by given values."""
    for i in range(2):
        for column in range(9):
            rows[i, column] = 0.0
        rows[i, 3 + i] = 1.0
        for axis in range(3):
            rows[i, 9 + axis] = velocity[axis] if i == 0 else acceleration[axis]


@kernel_jit
def _equations(
    points: np.ndarray,
    times: np.ndarray,
    count: int,
    k: int,
    velocity: np.ndarray,
    acceleration: np.ndarray,
    rows: np.ndarray,
) -> None:
    """Equations for the unknowns at point k; `rows` as in `_add_segment`, arguments as for `solve`."""
    rows[:] = 0.0
    if k > 0:
        _add_segment(times[k - 1], points, k - 1, rows, 5, 1, 0)
    if k < count - 1:
        _add_segment(times[k], points, k, rows, 1, 5, 6)
    if k == 0:
        _fix(rows, velocity, acceleration)
    if k == count - 1:
        still = np.zeros(3)
        _fix(rows, still, still)


@kernel_jit
def _reduce(rows: np.ndarray) -> None:
    """Solve the three equations for their own unknowns (Gauss-Jordan; the block is positive definite)."""
    for i in range(3):
        pivot = rows[i, 3 + i]
        for column in range(3, 12):
            rows[i, column] /= pivot
        for other in range(3):
            factor = rows[other, 3 + i]
            if other != i:
                for column in range(3, 12):
                    rows[other, column] -= factor * rows[i, column]


@kernel_jit
def _eliminate(rows: np.ndarray, before: np.ndarray, result: np.ndarray) -> None:
    """One step of the block elimination: unknowns = right part of the result - left part x next unknowns."""
    for i in range(3):
        for j in range(3):
            for m in range(3):
                rows[i, 3 + j] -= rows[i, m] * before[m, j]
                rows[i, 9 + j] -= rows[i, m] * before[m, 3 + j]
    _reduce(rows)
    for i in range(3):
        for column in range(6):
            result[i, column] = rows[i, 6 + column]


@kernel_jit
def _substitute(points: np.ndarray, count: int, work: np.ndarray, ends: np.ndarray) -> bool:
    """Back-substitute the unknowns from the last point to the first; returns whether all are bounded."""
    for k in range(count - 1, -1, -1):
        for axis in range(3):
            ends[k, 0, axis] = points[k, axis]
            for i in range(3):
                value = work[k, i, 3 + axis]
                if k < count - 1:
                    for j in range(3):
                        value -= work[k, i, j] * ends[k + 1, 1 + j, axis]
                if not abs(value) < _HUGE:
                    return False
                ends[k, 1 + i, axis] = value
    return True


@kernel_jit
def solve(
    points: np.ndarray,
    times: np.ndarray,
    count: int,
    velocity: np.ndarray,
    acceleration: np.ndarray,
    work: np.ndarray,
    ends: np.ndarray,
) -> bool:
    """Minimum-snap curve through points.

    Args:
        points: Points of the curve (m). Shape (>= count, 3).
        times: Durations of the segments between them (s). Shape (>= count - 1,).
        count: Number of points, 2 to `KNOT_LIMIT`.
        velocity: Velocity at the first point (m/s). Shape (3,); the curve ends at rest without acceleration.
        acceleration: Acceleration at the first point (m/s^2). Shape (3,).
        work: Work space. Shape (>= count, 3, 6).
        ends: Output: position, velocity, acceleration, jerk at each point. Shape (>= count, 4, 3).

    Returns:
        Whether all times and numbers are within bounds.
    """
    if count < 2:
        return False
    rows = np.empty((3, 12))
    work[0] = 0.0  # the first point has none before it
    for k in range(count):
        if k < count - 1 and not _SHORTEST <= times[k] <= _LONGEST:
            return False
        _equations(points, times, count, k, velocity, acceleration, rows)
        _eliminate(rows, work[max(k - 1, 0)], work[k])
    return _substitute(points, count, work, ends)


@kernel_jit
def _end_values(ends: np.ndarray, k: int, time: float, values: np.ndarray) -> None:
    """Normalize segment k to duration 1 and start at the origin: its eight end values. `values` has shape (8, 3)."""
    for axis in range(3):
        scale = 1.0
        for i in range(4):
            values[i, axis] = scale * ends[k, i, axis]
            values[4 + i, axis] = scale * ends[k + 1, i, axis]
            scale *= time
        values[4, axis] -= values[0, axis]
        values[0, axis] = 0.0


@kernel_jit
def coefficients(ends: np.ndarray, k: int, time: float, result: np.ndarray) -> None:
    """Polynomial of segment k in u = time since its start / its duration, relative to the start position.

    Args:
        ends: A curve from `solve`.
        k: Segment.
        time: Duration of the segment (s).
        result: Coefficients of 1, u .. u^7 per axis. Shape (8, 3).
    """
    values = np.empty((8, 3))
    _end_values(ends, k, time, values)
    for m in range(8):
        for axis in range(3):
            total = 0.0
            for i in range(8):
                total += BASIS[i, m] * values[i, axis]
            result[m, axis] = total


@kernel_jit
def peaks(ends: np.ndarray, k: int, time: float) -> tuple[float, float]:
    """Upper bounds of speed (m/s) and acceleration (m/s^2) on segment k.

    A Bezier curve lies in the convex hull of its control points, so those of velocity and acceleration in each quarter
    of the segment bound them; the bounds are at most a few per cent too high.
    """
    values = np.empty((8, 3))
    _end_values(ends, k, time, values)
    control = np.empty((7, 3))
    speed = 0.0
    acceleration = 0.0
    for piece in range(_PIECES):
        for j in range(7):
            for axis in range(3):
                total = 0.0
                for i in range(8):
                    total += _VELOCITY[piece, j, i] * values[i, axis]
                control[j, axis] = total / time
            speed = max(speed, math.sqrt(control[j, 0] ** 2 + control[j, 1] ** 2 + control[j, 2] ** 2))
            if j > 0:
                acceleration = max(acceleration, 6.0 * _PIECES / time * distance(control[j], control[j - 1]))
    return speed, acceleration


@kernel_jit
def evaluate(polynomial: np.ndarray, start: np.ndarray, time: float, u: float, point: np.ndarray) -> None:
    """Position, velocity and acceleration on a segment.

    Args:
        polynomial: From `coefficients`. Shape (8, 3).
        start: Position at its start (m). Shape (3,).
        time: Duration of the segment (s).
        u: Elapsed share of the duration.
        point: Output: position, velocity, acceleration. Shape (9,).
    """
    for axis in range(3):
        p = 0.0
        v = 0.0
        a = 0.0
        for m in range(7, -1, -1):
            a = a * u + 2.0 * v
            v = v * u + p
            p = p * u + polynomial[m, axis]
        point[axis] = start[axis] + p
        point[3 + axis] = v / time
        point[6 + axis] = a / (time * time)


@kernel_jit
def sample(
    ends: np.ndarray,
    times: np.ndarray,
    n: int,
    step: float,
    look: float,
    yaw: float,
    yaw_rate: float,
    points: np.ndarray,
) -> int:
    """Sample a curve at equal times: position, yaw, velocity, acceleration, duration at each instant.

    Args:
        ends: A curve from `solve`.
        times: Durations of its segments (s).
        n: Number of its points.
        step: Time between samples (s).
        look: Look-ahead distance of the yaw (m).
        yaw: Yaw at the start; NaN = along the course (rad).
        yaw_rate: Limit (rad/s).
        points: Output, columns x y z yaw v(3) a(3) duration. Shape (m, POINT_WIDTH).

    Returns:
        Number of points.
    """
    polynomial = np.empty((8, 3))
    values = np.empty(9)
    count = 0
    late = 0.0
    for k in range(n - 1):
        coefficients(ends, k, times[k], polynomial)
        while late < times[k] and count < points.shape[0] - 1:
            evaluate(polynomial, ends[k, 0], times[k], late / times[k], values)
            _set_point(values, step, points[count])
            count += 1
            late += step
        late -= times[k]
    if count < points.shape[0] - 1:
        for axis in range(3):
            values[axis] = ends[n - 1, 0, axis]
    for i in range(3, 9):
        values[i] = 0.0
    _set_point(values, step, points[count])
    _look_ahead(points, count + 1, look, yaw, yaw_rate * step)
    return count + 1


@kernel_jit
def _set_point(values: np.ndarray, step: float, point: np.ndarray) -> None:
    """Position, velocity, acceleration -> columns of a point, except yaw."""
    for axis in range(3):
        point[axis] = values[axis]
        point[4 + axis] = values[3 + axis]
        point[7 + axis] = values[6 + axis]
    point[POINT_WIDTH - 1] = step


@kernel_jit
def _wrapped(angle: float) -> float:
    """The same angle in [-pi, pi] (rad)."""
    return angle - 2.0 * math.pi * math.floor(angle / (2.0 * math.pi) + 0.5)


@kernel_jit
def _look_ahead(points: np.ndarray, count: int, look: float, yaw: float, most: float) -> None:
    """Turn the yaw of each point towards a point ahead, by at most `most` between points (rad)."""
    ahead = 0
    gap = 0.0
    for k in range(count):
        while ahead < count - 1 and gap < look:
            gap += distance(points[ahead], points[ahead + 1])
            ahead += 1
        dx = points[ahead, 0] - points[k, 0]
        dy = points[ahead, 1] - points[k, 1]
        if dx * dx + dy * dy > 0.09:
            course = atan2(dy, dx)
            if not abs(yaw) < 1e3:
                yaw = course
            off = _wrapped(course - yaw)
            yaw = _wrapped(yaw + min(most, max(-most, off)))
        if not abs(yaw) < 1e3:
            yaw = 0.0
        points[k, 3] = yaw
        if k < count - 1:
            gap -= distance(points[k], points[k + 1])
