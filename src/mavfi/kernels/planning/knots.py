"""Knots: path points on a smooth curve, before and after corners, and every few metres."""

from typing import NamedTuple

import numpy as np

from mavfi.kernels.planning import minimum_snap
from mavfi.kernels.planning.path import distance
from mavfi.kernels.planning.travel import turn
from mavfi.numerics.jit import kernel_jit

VERTEX_LIMIT = 400
BEND = 0.4
"""Turns up to this angle are passed through, larger ones are cut (rad)."""
NEAR = 0.05
"""Smallest distance of two knots (m)."""
_APART = 0.3
"""Smallest distance of two initial knots (m)."""
_PASSED = 0.5
"""Gentle bends closer to the last knot than this share of the spacing are not passed exactly."""


class CurveLimits(NamedTuple):
    """Limits of the vehicle, and of its deviation from the path.

    Attributes:
        speed: Limit everywhere (m/s).
        acceleration: Limit everywhere (m/s^2).
        tight_speed: Planned speed where the wide counter is blocked (m/s).
        lateral: Planned acceleration in corners (m/s^2).
        tangential: Planned acceleration along the path (m/s^2).
        braking: Planned deceleration after entering too fast (m/s^2).
        reach: Longest distance between a corner and the points where the curve leaves the path for it (m).
        spacing: Longest distance of knots on a straight leg (m).
    """

    speed: float
    acceleration: float
    tight_speed: float
    lateral: float
    tangential: float
    braking: float
    reach: float
    spacing: float


class Work(NamedTuple):
    """Work space of `fit`; its result is in `points`, `times` and `ends`.

    Attributes:
        corners: Arc length of each vertex (m). Shape (VERTEX_LIMIT,).
        arc: Arc length of each knot (m). Shape (KNOT_LIMIT,).
        leg: Leg of the path on which each knot lies. Shape (KNOT_LIMIT,), int64.
        points: Position of each knot (m). Shape (KNOT_LIMIT, 3).
        lengths: Approximate length of the segment starting there (m). Shape (KNOT_LIMIT,).
        shares: Tight share of that segment. Shape (KNOT_LIMIT,).
        caps: Largest speed at the knot, from corners and narrow places (m/s). Shape (KNOT_LIMIT,).
        push: Acceleration on the segment / the planned one. Shape (KNOT_LIMIT,).
        speeds: Planned speed at the knot (m/s). Shape (KNOT_LIMIT,).
        times: Duration of the segment (s). Shape (KNOT_LIMIT,).
        excess: Relative excess of the segment over its limits. Shape (KNOT_LIMIT,).
        ends: Derivatives at the knot, from `minimum_snap.solve`. Shape (KNOT_LIMIT, 4, 3).
        elimination: Work space of `minimum_snap.solve`. Shape (KNOT_LIMIT, 3, 6).
    """

    corners: np.ndarray
    arc: np.ndarray
    leg: np.ndarray
    points: np.ndarray
    lengths: np.ndarray
    shares: np.ndarray
    caps: np.ndarray
    push: np.ndarray
    speeds: np.ndarray
    times: np.ndarray
    excess: np.ndarray
    ends: np.ndarray
    elimination: np.ndarray


def new_work() -> Work:
    """Work space for `fit`."""
    n = minimum_snap.KNOT_LIMIT
    return Work(
        np.zeros(VERTEX_LIMIT),
        np.zeros(n),
        np.zeros(n, np.int64),
        np.zeros((n, 3)),
        np.zeros(n),
        np.zeros(n),
        np.zeros(n),
        np.zeros(n),
        np.zeros(n),
        np.zeros(n),
        np.zeros(n),
        np.zeros((n, 4, 3)),
        np.zeros((n, 3, 6)),
    )


@kernel_jit
def _add(work: Work, n: int, arc: float) -> int:
    """Append a knot unless it is too close to the last one; returns the number of knots."""
    if n >= work.arc.shape[0] - 1 or (n > 0 and not arc - work.arc[n - 1] > _APART):
        return n
    work.arc[n] = arc
    return n + 1


@kernel_jit
def _add_leg(work: Work, n: int, arc: float, spacing: float) -> int:
    """Append evenly spaced knots on a straight leg, up to `arc`; returns the number of knots."""
    first = work.arc[n - 1]
    gap = arc - first
    if gap > spacing:
        steps = int(min(gap / spacing, 1e6)) + 1
        for k in range(1, min(steps, work.arc.shape[0])):
            n = _add(work, n, first + gap * k / steps)
    return _add(work, n, arc)


@kernel_jit
def first_knots(path: np.ndarray, count: int, limits: CurveLimits, work: Work) -> int:
    """Initial knots: before, after and between corners.

    Args:
        path: Vertices without consecutive duplicates (m). Shape (>= count, 3).
        count: Number of vertices, 2 to `VERTEX_LIMIT`.
        limits: Reach of corners and spacing.
        work: Output: `corners` and `arc`.

    Returns:
        Number of knots; 0 if they do not fit or a vertex is corrupted.
    """
    work.corners[0] = 0.0
    for i in range(1, count):
        work.corners[i] = work.corners[i - 1] + distance(path[i - 1], path[i])
    length = work.corners[count - 1]
    if not NEAR < length < limits.spacing * (work.arc.shape[0] - 2.0 * count - 2.0):
        return 0
    work.arc[0] = 0.0
    n = 1
    for i in range(1, count - 1):
        before = work.corners[i] - work.corners[i - 1]
        after = work.corners[i + 1] - work.corners[i]
        if turn(path[i - 1], path[i], path[i + 1]) < BEND:
            if work.corners[i] - work.arc[n - 1] > _PASSED * limits.spacing:
                n = _add_leg(work, n, work.corners[i], limits.spacing)
            continue
        # the first leg has only one corner, which may take most of it
        reach = min(limits.reach, min((0.9 if i == 1 else 0.5) * before, 0.5 * after))
        n = _add_leg(work, n, work.corners[i] - reach, limits.spacing)
        n = _add(work, n, work.corners[i] + reach)
    if n > 1 and not length - work.arc[n - 1] > _APART:
        n -= 1
    n = _add_leg(work, n, length, limits.spacing)
    if n == 1:
        n = 2
    work.arc[n - 1] = length
    return n


@kernel_jit
def place(path: np.ndarray, count: int, work: Work, n: int) -> None:
    """Set position and leg of each of the n knots; arguments as for `first_knots`."""
    leg = 0
    for k in range(n):
        while leg < count - 2 and work.corners[leg + 1] <= work.arc[k]:
            leg += 1
        length = work.corners[leg + 1] - work.corners[leg]
        share = min(1.0, (work.arc[k] - work.corners[leg]) / length) if length > 0.0 else 0.0
        work.leg[k] = leg
        for axis in range(3):
            work.points[k, axis] = path[leg, axis] + (path[leg + 1, axis] - path[leg, axis]) * share


@kernel_jit
def insert(work: Work, n: int, arc: float) -> int:
    """Insert a knot in order unless one is close; returns the number of knots."""
    if n >= work.arc.shape[0]:
        return n
    k = n
    while k > 0 and work.arc[k - 1] > arc:
        k -= 1
    if k in (0, n) or arc - work.arc[k - 1] < 0.5 * NEAR or work.arc[k] - arc < 0.5 * NEAR:
        return n
    for j in range(n, k, -1):
        work.arc[j] = work.arc[j - 1]
    work.arc[k] = arc
    return n + 1
