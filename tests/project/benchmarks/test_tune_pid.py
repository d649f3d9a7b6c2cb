"""The search for the tracker's gains: seeds, variants, verdicts."""

import re

import pytest

from benchmarks import tune_pid
from benchmarks.tune_pid import CANDIDATES, Score, candidates, check_seeds, present, score, search, variant, verdict
from mavfi.config import AutopilotConfig, shipped
from mavfi.errors import BadInputError

AUTOPILOT = shipped("autopilots", AutopilotConfig, "hardened")


def of(tracking, arrived=1.0, speed=1.0):
    return Score(arrived, (tracking**2,) * 4, 2.0 * tracking, speed, 40.0)


@pytest.mark.parametrize(("first", "count"), [(10_000, 1), (9_999, 2), (-1, 1), (5, 0)])
def test_seeds_that_are_for_results_are_refused(first, count):
    with pytest.raises(BadInputError, match=f"SEED={first} N={count}: allowed: seeds from 0 to 9999"):
        check_seeds(first, count)


def test_design_seeds_are_taken():
    check_seeds(0, 1)
    check_seeds(9_999, 1)


@pytest.mark.parametrize("key", CANDIDATES)
def test_a_variant_changes_one_value_and_the_present_one_is_among_those_tried(key):
    assert present(AUTOPILOT, key) in candidates(key, AUTOPILOT)
    assert variant(AUTOPILOT, key, present(AUTOPILOT, key)) == AUTOPILOT
    other = variant(AUTOPILOT, key, 0.123)
    assert present(other, key) == 0.123 and getattr(other, key) != getattr(AUTOPILOT, key)
    assert AUTOPILOT.model_dump(exclude={key}) == other.model_dump(exclude={key})


def test_what_misses_its_goal_or_is_too_fast_costs_more_than_what_tracks_badly():
    assert of(0.2).objective == pytest.approx(0.2)
    assert of(0.2, speed=1.1).objective == of(0.2).objective and of(0.2, speed=1.2).objective == pytest.approx(0.7)
    assert of(0.2, arrived=0.9).objective == pytest.approx(1.2)


@pytest.mark.parametrize(
    ("best", "words"), [(0.195, ": confirmed, 2.6 % above the best .1.5."), (0.1, "NOT confirmed")]
)
def test_a_value_is_confirmed_within_the_tolerance(best, words):
    rows = [(1.5, of(best)), (2.0, of(0.2)), (3.0, of(0.3))]
    assert re.search(words, verdict("gain_p", AUTOPILOT, rows))
    assert " <- yaml" in tune_pid.table("gain_p", AUTOPILOT, rows).splitlines()[2]


def test_a_value_that_loses_by_chance_is_confirmed_and_one_that_fails_is_not():
    best = Score(1.0, (0.01, 0.01, 0.02, 0.01), 0.3, 1.0, 40.0)
    uneven = Score(1.0, (0.005, 0.01, 0.08, 0.01), 0.6, 1.0, 40.0)
    assert verdict("gain_p", AUTOPILOT, [(1.5, best), (2.0, uneven)]).endswith("which may be chance")
    steadily = Score(1.0, (0.03, 0.031, 0.04, 0.03), 0.6, 1.0, 40.0)
    assert "NOT confirmed" in verdict("gain_p", AUTOPILOT, [(1.5, best), (2.0, steadily)])
    lost = Score(0.75, uneven.squares, 0.6, 1.0, 40.0)
    assert "NOT confirmed" in verdict("gain_p", AUTOPILOT, [(1.5, best), (2.0, lost)])


def test_what_was_flown_is_not_flown_again(monkeypatch):
    flown = []
    monkeypatch.setattr(tune_pid, "score", lambda autopilot, seeds: flown.append(autopilot) or of(0.2))
    rows = dict(search(AUTOPILOT, list(CANDIDATES), range(3), {}))
    assert rows.keys() == CANDIDATES.keys()
    assert (
        len(flown)
        == len({autopilot.model_dump_json() for autopilot in flown})
        == 1 + sum(len(found) - 1 for found in rows.values())
    )


@pytest.mark.slow
def test_a_score_is_a_function_of_autopilot_and_seeds(monkeypatch):
    monkeypatch.setattr(tune_pid, "SETTINGS", (("sparse", 3.0),))
    first = score(AUTOPILOT, range(7, 8))
    assert first == score(AUTOPILOT, range(7, 8)) and first.arrived == 1.0
    assert first != score(variant(AUTOPILOT, "gain_p", 1.0), range(7, 8))


def test_the_program_refuses_in_one_line(monkeypatch):
    monkeypatch.setenv("SEED", "10000")
    with pytest.raises(SystemExit, match="SEED=10000 N=4: allowed"):
        tune_pid.main()
    monkeypatch.setenv("SEED", "200")
    monkeypatch.setenv("ONLY", "gain_x")
    with pytest.raises(SystemExit, match="ONLY=gain_x: not known; allowed: gain_p"):
        tune_pid.main()
