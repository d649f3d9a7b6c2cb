"""Decisions of recovery: the response to an alarm, its limits, the wait for a path, and the degraded mode's command.

The result 0 is no response, also that of a node that died while it decided.
"""

import math

from mavfi.kernels.perception.collision_check import NO_COLLISION
from mavfi.numerics.jit import kernel_jit, short_jit

NOTHING, RECOMPUTE, RESEND, ABANDON, STOP, RESTART, DEGRADE, CHARGE = range(8)
"""Responses; `CHARGE`: the latency of another stage than the writer's is charged, and the value passes."""
FIRST, RESENT, RECOMPUTED = range(3)
"""What produced a value: the kernel's step, a retransmission, or a recomputation."""
REFUSED, CURABLE, UNCURED = range(3)
"""Whether an alarm gets a response; `UNCURED`: that is the degraded mode."""
FEW, MANY = 1, 2
"""Frequency of alarms."""
KEEP, BEGIN, END, POSTPONE, OVERDUE = range(5)
"""What becomes of a wait."""
NOT_WAITING = -1
RESTART_US, BACK_OFF = 20_000, 3
"""Down time of a node that a detector restarts (us): the process survives, its memory is initialized; and the factor
by which the down time grows with each restart in a flight.  Their sum exceeds the duration of a fault of 1 s."""
MOST_RESTARTS = 5
"""Limit per flight: a faulty detector must not keep a vehicle from flying."""
PERSISTS_US, GAP_US = 2_000_000, 500_000
"""Hard alarms are persistent if they span the first duration with gaps of at most the second (us)."""
ALARMS_WITHIN_US = 10_000_000
"""Time within which alarms are counted against the detector (us)."""
GAIN = 1.0
"""Commanded speed of a degraded mode / distance to its target (1/s)."""


@short_jit
def respond(after: int, uncured: bool, stop: bool, abandon: bool, own_stage: bool, resends: bool) -> int:
    """Response to an alarm, as a code.

    A value that is rejected after a retransmission was computed incorrectly; one that is rejected after a recomputation
    indicates corrupted memory of its node.

    Args:
        after: What produced the value.
        uncured: Whether the degraded mode applies.
        stop: Whether the alarm requests a stop.
        abandon: Whether it requests the next way-point.
        own_stage: Whether it requests recomputation of the stage of the value's writer.
        resends: Whether values are retransmitted before they are recomputed.
    """
    if uncured:
        return DEGRADE
    if after == RECOMPUTED:
        return RESTART
    if stop:
        return STOP
    if abandon:
        return ABANDON
    if not own_stage:
        return CHARGE
    return RESEND if resends and after == FIRST else RECOMPUTE


@short_jit
def series_start(first_us: int, last_us: int, now: int) -> int:
    """First instant of the contiguous series of hard alarms that the present one continues, or begins (us).

    Args:
        first_us: First instant of the latest series (us).
        last_us: Its last instant (us).
        now: Instant of the alarm (us).
    """
    return now if now - last_us > GAP_US else first_us


@short_jit
def escalate(
    after: int, hard: bool, degrades: bool, restarts: bool, restarts_left: int, first_us: int, last_us: int, now: int
) -> int:  # fmt: skip
    """Whether an alarm gets a response, and whether restarts are of no help, as a code.

    A statistical score may be high twice on a correct value; a violated rule remains an error while there is a
    response left.

    Args:
        after: What produced the value.
        hard: Whether the alarm is that of a violated rule.
        degrades: Whether a degraded mode is configured.
        restarts: Whether the policy includes node restarts.
        restarts_left: Remaining number of node restarts.
        first_us: As of `series_start`.
        last_us: As of `series_start`.
        now: As of `series_start`.
    """
    used_up = restarts and after == RECOMPUTED and restarts_left <= 0
    if hard and degrades and (used_up or now - series_start(first_us, last_us, now) > PERSISTS_US):
        return UNCURED
    if after == FIRST:
        return CURABLE
    return CURABLE if hard and (after == RESENT or restarts_left > 0) else REFUSED


@short_jit
def frequency(oldest_us: int, now: int) -> int:
    """Whether as many alarms as are permitted came within `ALARMS_WITHIN_US`, as a code.

    Args:
        oldest_us: Instant of the oldest of that number of alarms (us).
        now: Present instant (us).
    """
    return MANY if now - oldest_us < ALARMS_WITHIN_US else FEW


@short_jit
def left_after(restarts_left: int) -> int:
    """Number of restarts left after one; a corrupted number is bounded, so that it cannot stall the flight."""
    return min(max(restarts_left, 1), MOST_RESTARTS) - 1


@short_jit
def down_time(restarts_left: int) -> int:
    """Down time of a node, given the number of restarts left before (us)."""
    earlier = MOST_RESTARTS - 1 - left_after(restarts_left)
    return RESTART_US * int(BACK_OFF**earlier)


@short_jit
def distance(x: float, y: float, z: float, to_x: float, to_y: float, to_z: float) -> float:
    """Distance between two positions (m)."""
    return math.sqrt((to_x - x) ** 2 + (to_y - y) ** 2 + (to_z - z) ** 2)


@short_jit
def closing_rate(away: float, largest: float) -> float:
    """Commanded speed / distance to the target (1/s): `GAIN`, less where the speed would exceed its limit.

    Args:
        away: Distance to the target (m).
        largest: Limit on the speed (m/s).
    """
    return min(GAIN * away, largest) / away if away > 0.0 else 0.0


@kernel_jit
def is_free(time_to_collision: float, distance_to_blocked: float, index: int) -> bool:
    """Whether a collision status without a flag says that the trajectory in force is free.

    Args:
        time_to_collision: As published (s).
        distance_to_blocked: As published (m).
        index: Index of the way-point in force; negative without a trajectory, which the check cannot judge.
    """
    return time_to_collision == NO_COLLISION and distance_to_blocked == math.inf and index >= 0


@short_jit
def wait_for_path(
    answered: bool, raised: bool, same_alarm: bool, time_to_collision: float, distance_to_blocked: float, index: int,
    away: bool, since: int, now: int, limit_us: float,
) -> int:  # fmt: skip
    """What becomes of the wait for a path that answers a collision alarm, at a publication, as a code.

    Args:
        answered: Whether it is a path that answers the alarm.
        raised: Whether it is a collision status with the flag.
        same_alarm: Whether it is one without, under the number of the last alarm, that may withdraw it.
        time_to_collision: As of `is_free`.
        distance_to_blocked: As of `is_free`.
        index: As of `is_free`.
        away: Whether the planner is restarting; the deadline restarts when it is back.
        since: Instant of the unanswered alarm (us); `NOT_WAITING` = none.
        now: Instant of the publication (us).
        limit_us: Deadline (us).
    """
    if since == NOT_WAITING:
        return BEGIN if raised else KEEP
    if answered or (same_alarm and is_free(time_to_collision, distance_to_blocked, index)):
        return END
    if away:
        return POSTPONE
    return OVERDUE if now - since > limit_us else KEEP
