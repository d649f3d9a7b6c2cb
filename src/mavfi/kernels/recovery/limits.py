"""Limits of recovery: which alarms get another response, how many are too many, and restarts with their down times.

The result 0 is no response, also that of a node that died while it decided.
"""

from mavfi.kernels.recovery.response import FIRST, RECOMPUTED, RESENT
from mavfi.numerics.jit import kernel_jit

REFUSED, CURABLE, UNCURED = range(3)
"""Whether an alarm gets a response; `UNCURED`: that is the degraded mode."""
FEW, MANY = 1, 2
"""Frequency of alarms."""
RESTART_US, BACK_OFF = 20_000, 3
"""Down time of a node that a detector restarts (us): the process survives, its memory is initialized; and the factor
by which the down time grows with each restart in a flight.  Their sum exceeds the duration of a fault of 1 s."""
MOST_RESTARTS = 5
"""Limit per flight: a faulty detector must not keep a vehicle from flying."""
PERSISTS_US, GAP_US = 2_000_000, 500_000
"""Hard alarms are persistent if they span the first duration with gaps of at most the second (us)."""
ALARMS_WITHIN_US = 10_000_000
"""Time within which alarms are counted against the detector (us)."""


@kernel_jit
def series_start(first_us: int, last_us: int, now: int) -> int:
    """First instant of the contiguous series of hard alarms that the present one continues, or begins (us).

    Args:
        first_us: First instant of the latest series (us).
        last_us: Its last instant (us).
        now: Instant of the alarm (us).
    """
    return now if now - last_us > GAP_US else first_us


@kernel_jit
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


@kernel_jit
def frequency(oldest_us: int, now: int) -> int:
    """Whether as many alarms as are permitted came within `ALARMS_WITHIN_US`, as a code.

    Args:
        oldest_us: Instant of the oldest of that number of alarms (us).
        now: Present instant (us).
    """
    return MANY if now - oldest_us < ALARMS_WITHIN_US else FEW


@kernel_jit
def left_after(restarts_left: int) -> int:
    """Number of restarts left after one; a corrupted number is bounded, so that it cannot stall the flight."""
    return min(max(restarts_left, 1), MOST_RESTARTS) - 1


@kernel_jit
def down_time(restarts_left: int) -> int:
    """Down time of a node, given the number of restarts left before (us)."""
    earlier = MOST_RESTARTS - 1 - left_after(restarts_left)
    return RESTART_US * int(BACK_OFF**earlier)
