"""From a path to a minimum-snap trajectory: times at the knots, and restoring a curve that leaves free space.

Times follow a trapezoidal speed profile; where a limit is violated, planned speed and acceleration are lowered; where
the curve leaves free space, knots are added in the middle of that part of the path, as in the published code.
"""

import math

import numpy as np

from mavfi.kernels.planning import minimum_snap
from mavfi.kernels.planning.knots import BEND, NEAR, VERTEX_LIMIT, CurveLimits, Work, first_knots, insert, place
from mavfi.kernels.planning.path import distance
from mavfi.kernels.planning.travel import tight_share, turn
from mavfi.numerics.elementary import tan
from mavfi.numerics.jit import kernel_jit
from mavfi.numerics.voxels import Grid, segment_free, voxel_of

ROUNDS = 10
"""Largest number of rounds of adding knots."""
_TRIALS = 40
"""Largest number of reductions of the speed profile."""
_MOST_SOLVED = 10_000
"""Limit on the knots of all curves of a search, so that a path with a corrupted vertex terminates as well."""
_SHARED = 0.5
"""Share of a segment's excess speed by which its neighbours are slowed down as well."""
_SHARPNESS = 1.2
"""Largest curvature of a cut corner x its reach / tan of half the turn."""
_SLOWEST = 0.2
"""Smallest speed between start and end (m/s)."""
_ABSURD = 1e3
"""Larger entry speeds are rejected (m/s)."""
_STEP = 0.02
"""Time between free-space checks (s)."""
_MOST_STEPS = 2_000


@kernel_jit
def _corner_speed(bend: float, reach: float, sharpness: float, limits: CurveLimits) -> float:
    """Speed in a turn for a given reach (m/s)."""
    sharp = sharpness * tan(0.5 * min(bend, 3.0))
    return min(limits.speed, math.sqrt(limits.lateral * max(reach, 0.0) / sharp)) if sharp > 1e-6 else limits.speed


@kernel_jit
def _knot_speeds(
    wide: np.ndarray, grid: Grid, path: np.ndarray, count: int, limits: CurveLimits, work: Work, n: int
) -> None:
    """Largest speed at each knot, from corners and narrow places; length and tight share of each segment."""
    for k in range(n):
        point = work.points[k]
        voxel = voxel_of(grid, point[0], point[1], point[2])
        work.caps[k] = limits.tight_speed if voxel >= 0 and wide[voxel] > 0 else limits.speed
        work.push[k] = 1.0
    for k in range(n - 1):
        chord = distance(work.points[k], work.points[k + 1])
        work.lengths[k] = 0.5 * (work.arc[k + 1] - work.arc[k] + chord)
        work.shares[k] = tight_share(wide, grid, work.points[k], work.points[k + 1])
        for i in range(work.leg[k] + 1, min(work.leg[k + 1] + 1, count - 1)):
            bend = turn(path[i - 1], path[i], path[i + 1])
            to = work.arc[k + 1] - work.corners[i]
            since = work.corners[i] - work.arc[k]
            if bend < BEND and to > 1e-6:
                slow = _corner_speed(bend, 0.5 * (since + to), 1.0, limits)
                work.caps[k] = min(work.caps[k], slow)
            elif to > 1e-6:
                slow = _corner_speed(bend, min(since, to), _SHARPNESS, limits)
                work.caps[k] = min(work.caps[k], slow)
            else:  # the curve passes through the corner
                after = work.arc[k + 2] - work.arc[k + 1] if k < n - 2 else since
                slow = _corner_speed(bend, 0.5 * min(since, after), 1.0, limits)
            work.caps[k + 1] = min(work.caps[k + 1], slow)


@kernel_jit
def _trapezoid(entry: float, limits: CurveLimits, work: Work, n: int) -> None:
    """Consecutively reachable speeds, and the duration of each segment."""
    caps, speeds, push = work.caps, work.speeds, work.push
    for k in range(n):
        speeds[k] = max(caps[k], _SLOWEST)
    speeds[n - 1] = 0.0
    for k in range(n - 2, -1, -1):
        gained = 2.0 * limits.tangential * push[k] * work.lengths[k]
        speeds[k] = min(speeds[k], math.sqrt(speeds[k + 1] ** 2 + gained))
    speeds[0] = entry
    unavoidable = entry
    for k in range(n - 1):
        gained = 2.0 * limits.tangential * push[k] * work.lengths[k]
        lost = 2.0 * limits.braking * push[k] * work.lengths[k]
        speeds[k + 1] = min(speeds[k + 1], math.sqrt(speeds[k] ** 2 + gained))
        tight = max(limits.tight_speed, unavoidable)
        # an excess speed at the start decreases only gradually
        unavoidable = math.sqrt(max(0.0, unavoidable**2 - lost))
        if k < n - 2:
            speeds[k + 1] = max(speeds[k + 1], unavoidable)
        mean = 0.5 * (speeds[k] + speeds[k + 1])
        if mean > 1e-3:
            share = work.shares[k]
            work.times[k] = work.lengths[k] * ((1.0 - share) / mean + share / min(mean, tight))
        else:
            work.times[k] = 2.0 * math.sqrt(work.lengths[k] / (limits.tangential * push[k]))


@kernel_jit
def _within_limits(entry: float, limits: CurveLimits, work: Work, n: int) -> bool:
    """Whether all segments are within limits; slows down those that are not, and to a lesser degree neighbours."""
    within_limits = True
    excess = work.excess
    for k in range(n - 1):
        speed, acceleration = minimum_snap.peaks(work.ends, k, work.times[k])
        fastest = max(
            limits.speed, 1.05 * max(entry if k == 0 else 0.0, work.speeds[k] if entry > limits.speed else 0.0)
        )
        over = max(speed / fastest, acceleration / limits.acceleration)
        within_limits = within_limits and over <= 1.0
        excess[k] = min(1.0, over - 1.0 + 5e-3) if not over <= 1.0 else 0.0
    if within_limits:
        return True
    for k in range(1, n - 1):
        excess[k] = max(excess[k], _SHARED * excess[k - 1])
    for k in range(n - 3, -1, -1):
        excess[k] = max(excess[k], _SHARED * excess[k + 1])
    for k in range(n - 1):
        work.push[k] /= 1.0 + excess[k]
        gentler = 1.0 + 0.3 * max(excess[k], excess[k - 1] if k > 0 else 0.0)
        work.caps[k] = min(work.caps[k], limits.speed) / gentler
    return False


@kernel_jit
def _segment_is_free(counter: np.ndarray, grid: Grid, work: Work, k: int) -> bool:
    """Whether the polynomial of segment k stays in free space."""
    polynomial = np.empty((8, 3))
    point = np.empty(9)
    last = np.empty(3)
    minimum_snap.coefficients(work.ends, k, work.times[k], polynomial)
    steps = int(min(work.times[k] / _STEP, _MOST_STEPS)) + 1
    for axis in range(3):
        last[axis] = work.points[k, axis]
    for step in range(1, steps + 1):
        minimum_snap.evaluate(polynomial, work.points[k], work.times[k], step / steps, point)
        if not segment_free(counter, grid, last, point[:3]):
            return False
        for axis in range(3):
            last[axis] = point[axis]
    return True


@kernel_jit
def _path_is_free(counter: np.ndarray, grid: Grid, path: np.ndarray, work: Work, k: int) -> bool:
    """Whether the path between the knots of segment k stays in free space."""
    last = work.points[k]
    for i in range(work.leg[k] + 1, work.leg[k + 1] + 1):
        if not segment_free(counter, grid, last, path[i]):
            return False
        last = path[i]
    return segment_free(counter, grid, last, work.points[k + 1])


@kernel_jit
def split(counter: np.ndarray, grid: Grid, path: np.ndarray, count: int, work: Work, n: int, added: np.ndarray) -> int:
    """Knots to add where the curve leaves free space although the path does not.

    Args:
        counter: > 0 = blocked. Shape (grid.size,).
        grid: Geometry.
        path: Vertices (m). Shape (>= count, 3).
        count: Number of vertices.
        work: A solved curve.
        n: Number of knots.
        added: Output: new knots, halfway on the legs of each such segment (m). Shape (KNOT_LIMIT,).

    Returns:
        Number of new knots; 0 = the curve is free.
    """
    new = 0
    for k in range(n - 1):
        if new > added.shape[0] - 3:
            break
        if _segment_is_free(counter, grid, work, k) or not _path_is_free(counter, grid, path, work, k):
            continue
        a, b = work.arc[k], work.arc[k + 1]
        corner = work.leg[k] + 1
        inside = corner < count and work.corners[corner] < b - 1e-6
        if inside and b - a > 4.0 * NEAR:
            added[new] = 0.5 * (a + work.corners[corner])
            added[new + 1] = 0.5 * (b + work.corners[corner])
            new += 2
        else:
            added[new] = work.corners[corner] if inside else 0.5 * (a + b)
            new += 1
    return new


@kernel_jit
def _timed(velocity: np.ndarray, acceleration: np.ndarray, limits: CurveLimits, work: Work, n: int, trials: int) -> int:
    """Fit a curve within the limits through the knots; returns the number of trials, 0 = there is no such curve."""
    entry = math.sqrt(velocity[0] ** 2 + velocity[1] ** 2 + velocity[2] ** 2)
    if not entry < _ABSURD:
        return 0
    for trial in range(trials):
        _trapezoid(entry, limits, work, n)
        if not minimum_snap.solve(work.points, work.times, n, velocity, acceleration, work.elimination, work.ends):
            return 0
        if _within_limits(entry, limits, work, n):
            return trial + 1
    return 0


@kernel_jit
def fit(
    narrow: np.ndarray,
    wide: np.ndarray,
    grid: Grid,
    path: np.ndarray,
    count: int,
    velocity: np.ndarray,
    acceleration: np.ndarray,
    limits: CurveLimits,
    work: Work,
) -> int:
    """Minimum-snap curve along a path, within the limits, and in free space wherever the path is.

    Args:
        narrow: > 0 = blocked. Shape (grid.size,).
        wide: > 0 = too close to an obstacle for full speed. Shape (grid.size,).
        grid: Geometry.
        path: Vertices without consecutive duplicates (m). Shape (>= count, 3).
        count: Number of vertices, at least 2.
        velocity: Velocity at the start (m/s). Shape (3,).
        acceleration: Acceleration at the start (m/s^2). Shape (3,).
        limits: Of the vehicle, and of the deviation from the path.
        work: Work space, including the result.

    Returns:
        Number of knots of the curve; 0 = none was found.
    """
    if count < 2 or count > VERTEX_LIMIT:
        return 0
    n = first_knots(path, count, limits, work)
    if n < 2:
        return 0
    added = np.empty(work.arc.shape[0])
    left = _MOST_SOLVED
    for _ in range(ROUNDS):
        place(path, count, work, n)
        _knot_speeds(wide, grid, path, count, limits, work, n)
        tried = _timed(velocity, acceleration, limits, work, n, min(_TRIALS, left // n))
        if tried == 0:
            return 0
        left -= n * tried
        new = split(narrow, grid, path, count, work, n, added)
        if new == 0:
            return n
        before = n
        for k in range(new):
            n = insert(work, n, added[k])
        if n == before:
            return 0
    return 0
