"""Decisions of recovery against tables in words, over all combinations of their arguments."""

import itertools
import math

import pytest

from mavfi.kernels.perception.collision_check import NO_COLLISION
from mavfi.kernels.recovery.response import (
    ABANDON,
    BEGIN,
    CHARGE,
    DEGRADE,
    END,
    FIRST,
    KEEP,
    NOT_WAITING,
    OVERDUE,
    POSTPONE,
    RECOMPUTE,
    RECOMPUTED,
    RESEND,
    RESENT,
    RESTART,
    STOP,
    is_free,
    respond,
    wait_for_path,
)

BOTH = (False, True)


def test_an_alarm_has_the_first_response_that_applies():
    for after, uncured, stop, abandon, own, resends in itertools.product((FIRST, RESENT, RECOMPUTED), *[BOTH] * 5):
        applies = {
            DEGRADE: uncured, RESTART: after == RECOMPUTED, STOP: stop, ABANDON: abandon, CHARGE: not own,
            RESEND: resends and after == FIRST, RECOMPUTE: True,
        }  # fmt: skip
        expected = next(code for code in applies if applies[code])
        assert respond(after, uncured, stop, abandon, own, resends) == expected


def test_a_wait_begins_with_an_alarm_and_ends_with_an_answer_or_its_deadline():
    for answered, raised, same, free, away, waiting, late in itertools.product(*[BOTH] * 7):
        since, now = (1_000_000 if waiting else NOT_WAITING), 1_600_000 + late
        applies = {
            BEGIN: raised and not waiting, KEEP: not waiting, END: answered or (same and free), POSTPONE: away,
            OVERDUE: late,
        }  # fmt: skip
        expected = next((code for code in applies if applies[code]), KEEP)
        status = (NO_COLLISION if free else 2.0, math.inf, 0)
        assert wait_for_path(answered, raised, same, *status, away, since, now, 6e5) == expected


@pytest.mark.parametrize("time", [NO_COLLISION, 2.0, math.nan])
@pytest.mark.parametrize("distance", [math.inf, 5.0, math.nan])
@pytest.mark.parametrize("index", [-1, 0, 3])
def test_only_a_status_without_time_and_distance_withdraws_an_alarm_on_a_trajectory(time, distance, index):
    assert is_free(time, distance, index) == ((time, distance) == (NO_COLLISION, math.inf) and index != -1)
