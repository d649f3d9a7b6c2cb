"""The search for the tracker's gains: seeds, variants, verdicts."""

import re

import pytest

from benchmarks import tune_pid
from benchmarks.tune_pid import CANDIDATES, Score, candidates, check_seeds, present, variant, verdict
from mavfi.config import AutopilotConfig, shipped
from mavfi.errors import BadInputError

AUTOPILOT = shipped("autopilots", AutopilotConfig, "hardened")


def of(tracking, arrived=1.0, speed=1.0):
    return Score(arrived, (tracking**2,) * 4, 2.0 * tracking, speed, 40.0)


@pytest.mark.parametrize(("first", "count"), [(10_000, 1), (9_999, 2), (-1, 1), (5, 0)])
def test_seeds_that_are_for_results_are_refused(first, count):
    with pytest.raises(BadInputError, match=f"SEED={first} N={count}: allowed: seeds from 0 to 9999"):
        check_seeds(first, count)


@pytest.mark.parametrize("key", CANDIDATES)
def test_a_variant_changes_one_value_and_the_present_one_is_among_those_tried(key):
    assert present(AUTOPILOT, key) in candidates(key, AUTOPILOT)
    assert variant(AUTOPILOT, key, present(AUTOPILOT, key)) == AUTOPILOT
    other = variant(AUTOPILOT, key, 0.123)
    assert present(other, key) == 0.123 and getattr(other, key) != getattr(AUTOPILOT, key)
    assert AUTOPILOT.model_dump(exclude={key}) == other.model_dump(exclude={key})


@pytest.mark.parametrize(
    ("best", "words"), [(0.195, ": confirmed, 2.6 % above the best .1.5."), (0.1, "NOT confirmed")]
)
def test_a_value_is_confirmed_within_the_tolerance(best, words):
    rows = [(1.5, of(best)), (2.0, of(0.2)), (3.0, of(0.3))]
    assert re.search(words, verdict("gain_p", AUTOPILOT, rows))
    assert " <- yaml" in tune_pid.table("gain_p", AUTOPILOT, rows).splitlines()[2]
