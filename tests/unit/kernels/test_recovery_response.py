"""Decisions of recovery against tables in words, over all combinations of their arguments."""

import itertools
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavfi.kernels.perception.collision_check import NO_COLLISION
from mavfi.kernels.recovery.limits import (
    ALARMS_WITHIN_US,
    CURABLE,
    FEW,
    GAP_US,
    MANY,
    MOST_RESTARTS,
    PERSISTS_US,
    REFUSED,
    RESTART_US,
    UNCURED,
    down_time,
    escalate,
    frequency,
    left_after,
    series_start,
)
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
from mavfi.kernels.recovery.setpoints import GAIN, closing_rate, distance

BOTH = (False, True)


def test_an_alarm_has_the_first_response_that_applies():
    for after, uncured, stop, abandon, own, resends in itertools.product((FIRST, RESENT, RECOMPUTED), *[BOTH] * 5):
        applies = {
            DEGRADE: uncured, RESTART: after == RECOMPUTED, STOP: stop, ABANDON: abandon, CHARGE: not own,
            RESEND: resends and after == FIRST, RECOMPUTE: True,
        }  # fmt: skip
        expected = next(code for code in applies if applies[code])
        assert respond(after, uncured, stop, abandon, own, resends) == expected


def test_an_alarm_is_refused_after_a_response_that_leaves_none_and_uncured_if_a_rule_stays_violated():
    for hard, degrades, restarts, persists, gap in itertools.product(*[BOTH] * 5):
        for after, left in itertools.product((FIRST, RESENT, RECOMPUTED), (-1, 0, 1, MOST_RESTARTS)):
            first, now = 1_000_000, 1_000_000 + PERSISTS_US + persists
            spent = restarts and after == RECOMPUTED and left <= 0
            last = now - GAP_US - gap  # after a gap a new series begins
            applies = {
                UNCURED: hard and degrades and (spent or (persists and not gap)), CURABLE: after == FIRST,
                REFUSED: not hard or (after == RECOMPUTED and left <= 0),
            }  # fmt: skip
            expected = next((code for code in applies if applies[code]), CURABLE)
            assert escalate(after, hard, degrades, restarts, left, first, last, now) == expected
            assert series_start(first, last, now) == (now if gap else first)


@pytest.mark.parametrize(("later", "expected"), [(-1, MANY), (0, FEW)])
def test_alarms_are_many_if_the_oldest_is_recent(later, expected):
    assert frequency(7, 7 + ALARMS_WITHIN_US + later) == expected


def test_restarts_are_few_and_each_takes_three_times_as_long():
    left, downs = MOST_RESTARTS, []
    while left > 0:
        downs.append(down_time(left))
        left = left_after(left)
    assert downs == [RESTART_US * 3**number for number in range(MOST_RESTARTS)]
    assert [left_after(corrupted) for corrupted in (-(2**62), -1, 0, 2**62)] == [0, 0, 0, MOST_RESTARTS - 1]
    assert down_time(-(2**62)) == downs[-1] and down_time(2**62) == downs[0], "bounded"


@given(st.tuples(*[st.floats(-1e6, 1e6)] * 3), st.tuples(*[st.floats(-1e6, 1e6)] * 3), st.floats(0.0, 10.0))
def test_a_command_closes_the_distance_in_proportion_up_to_its_limit(start, end, largest):
    away = distance(*start, *end)
    assert away == pytest.approx(math.dist(start, end), rel=1e-12, abs=1e-150)
    rate = closing_rate(away, largest)
    assert rate * away <= largest * (1 + 1e-12) and 0.0 <= rate <= GAIN
    assert away == 0.0 or rate == pytest.approx(GAIN) or rate * away == pytest.approx(largest)
    assert closing_rate(0.0, largest) == 0.0


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
