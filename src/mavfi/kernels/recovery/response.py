"""Decisions of recovery: the response to an alarm, and the wait for the path that answers a collision alarm.

Both are codes; 0 is no response, also that of a node that died while it decided.
"""

import math

from mavfi.kernels.perception.collision_check import NO_COLLISION
from mavfi.numerics.jit import kernel_jit

NOTHING, RECOMPUTE, RESEND, ABANDON, STOP, RESTART, DEGRADE, CHARGE = range(8)
"""Responses; `CHARGE`: the latency of another stage than the writer's is charged, and the value passes."""
FIRST, RESENT, RECOMPUTED = range(3)
"""What produced a value: the kernel's step, a retransmission, or a recomputation."""
KEEP, BEGIN, END, POSTPONE, OVERDUE = range(5)
"""What becomes of a wait."""
NOT_WAITING = -1


@kernel_jit
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


@kernel_jit
def is_free(time_to_collision: float, distance_to_blocked: float, index: int) -> bool:
    """Whether a collision status without a flag says that the trajectory in force is free.

    Args:
        time_to_collision: As published (s).
        distance_to_blocked: As published (m).
        index: Index of the way-point in force; negative without a trajectory, which the check cannot judge.
    """
    return time_to_collision == NO_COLLISION and distance_to_blocked == math.inf and index >= 0


@kernel_jit
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
