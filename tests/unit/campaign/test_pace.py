"""The time that is left is not shown before it can be known, and is sensible from then on.

`paces.json` holds two campaigns of short missions, flown by two workers: instant (s), mission, what was completed
(golden run, injected run, `e` the mission itself), wall time (s).
"""

import json
import math
from pathlib import Path

import pytest

from mavfi.campaign.pace import Pace, left_s

RECORDED = json.loads((Path(__file__).parent / "paces.json").read_text(encoding="utf-8"))
WORKERS = 2


def estimates_of(events):
    """Time left as it was, and as it was estimated, after each run."""
    pace, end = Pace(0.0), events[-1][0]
    left = {golden: sum(kind == name for _, _, kind, _ in events) for golden, name in ((True, "g"), (False, "i"))}
    for now, mission, kind, wall_s in events:
        if kind == "e":
            pace.over(mission)
            continue
        pace.note(now, mission, kind == "g", wall_s)
        left[kind == "g"] -= 1
        yield end - now, pace.remaining_s(left, WORKERS)


@pytest.mark.parametrize("level", RECORDED)
def test_an_estimate_is_never_far_off(level):
    end = RECORDED[level][-1][0]
    until_shortly_before = [(true, found) for true, found in estimates_of(RECORDED[level]) if true > 0.1 * end]
    estimates = [(true, found) for true, found in until_shortly_before if math.isfinite(found)]
    assert estimates[0][0] > 0.5 * end, "it is shown early"
    assert all(true / 1.5 < found < 1.5 * true for true, found in estimates)


@pytest.mark.parametrize("level", RECORDED)
def test_the_rate_since_the_first_run_was_far_off(level):
    """What was shown before: golden runs first and bursts make it wrong several times over."""
    runs = [now for now, _, kind, _ in RECORDED[level] if kind != "e"]
    before = [
        (len(runs) - done) / ((done - 1) / (now - runs[0])) / (runs[-1] - now)
        for done, now in enumerate(runs, 1)
        if runs[0] < now < 0.9 * runs[-1]
    ]
    assert max(max(before), 1 / min(before)) > 2


def test_no_time_is_shown_before_a_mission_is_over():
    pace, left = Pace(0.0), {True: 5, False: 100}
    assert pace.remaining_s(left, WORKERS) == math.inf and pace.rate == 0.0
    for second in range(1, 11):
        pace.note(float(second), "a", second < 3, 1.0)
    assert pace.remaining_s(left, WORKERS) == math.inf and pace.rate == 1.0
    pace.over("a")
    assert pace.remaining_s(left, WORKERS) == 105 / WORKERS


def test_a_mission_of_many_runs_is_not_waited_for():
    pace = Pace(0.0)
    for second in range(1, 60):
        assert pace.remaining_s({True: 0, False: 10}, 1) == math.inf or second > 50
        pace.note(float(second), "a", False, 1.0)
    assert pace.remaining_s({True: 0, False: 10}, 1) == 10.0


def test_the_past_is_forgotten():
    pace = Pace(0.0)
    for second in range(1000):
        pace.note(10.0 * second, "slow", False, 10.0)
    pace.over("slow")
    for second in range(400):
        pace.note(1e4 + 0.1 * second, "fast", False, 0.1)
    pace.over("fast")
    assert pace.rate == pytest.approx(10.0, rel=0.3)
    assert pace.remaining_s({True: 0, False: 100}, 1) == pytest.approx(10.0, rel=0.01)


def test_golden_and_injected_runs_count_with_their_own_time():
    walls = {True: (2, 8.0), False: (100, 10.0)}
    assert left_s({True: 3, False: 50}, walls, 1, 1) == pytest.approx(3 * 4.0 + 50 * 0.1)
    assert left_s({True: 3, False: 50}, walls, 1, 4) == pytest.approx((3 * 4.0 + 50 * 0.1) / 4)
    assert left_s({True: 3, False: 0}, {False: (9, 9.0)}, 1, 1) == 3.0, "of an unknown kind: as long as the other"
    assert left_s({True: 0, False: 0}, {}, 0, 0) == 0.0
    assert left_s({True: 1, False: 0}, walls, 1, 0) == math.inf, "nothing is in the air"
    assert left_s({True: 1, False: 0}, {}, 1, 1) == math.inf
