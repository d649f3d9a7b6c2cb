"""Each of the five rules alone: together they are the acceptance test, and each alarm belongs to one of them."""

import pytest

from mavfi.detectors.acceptance import (
    CHECKED,
    COPIES,
    COUNTERS,
    DYNAMICS,
    EPOCHS,
    NODES,
    RULES,
    AcceptanceTest,
    rule_of,
)
from mavfi.detectors.detector import part_of
from mavfi.detectors.registry import load_detector
from mavfi.errors import BadInputError
from mavfi.states import STATES
from tests.core.unit.detectors.streams import LIMITS
from tests.core.unit.detectors.test_acceptance import NOW, STATUS, WAYPOINT, flying, good
from tests.core.unit.detectors.test_registry import FITS


def only(*rules):
    """A detector in flight whose alarms are those of some rules, with what `flying` has seen."""
    detector = AcceptanceTest(LIMITS["published"], rules=rules)
    detector.restore(flying("published").memory())
    return detector


@pytest.mark.parametrize(
    ("case", "field", "value", "rule"),
    [
        ("no collision", "collision", True, COUNTERS),
        ("a new collision", "future_collision_seq", 3, COUNTERS),
        ("path", "future_collision_seq", 3, EPOCHS),
        ("trajectory", "trajectory_seq", 3, EPOCHS),
        ("next point", "index", 5, EPOCHS),
        ("path", "x", 70.0, DYNAMICS),
        ("command", "vx", 3.3, DYNAMICS),
        ("next point", "vx", 7.5, COPIES),
    ],
)
def test_only_the_rule_that_is_violated_raises_an_alarm(case, field, value, rule):
    state, _ = good("published")[case]
    inside = field in (state.elements.dtype.names or ())
    state = state.copy()
    if inside:
        state.elements[field][1] = value
    else:
        state.header[field] = value
    whole = flying("published").check(state, NOW)
    assert whole is not None and whole.hard
    assert only(rule).check(state, NOW) == only(rule, NODES).check(state, NOW) == whole
    assert only(*(number for number in RULES if number != rule)).check(state, NOW) is None
    assert only(rule).score(state, NOW) > 0.0
    assert only(NODES).score(state, NOW) == 0.0


def test_every_checked_field_belongs_to_one_rule():
    rules = {
        f"{name}.{field.name}": rule_of(f"{name}.{field.name}") for name in CHECKED for field in STATES[name].fields
    }
    assert set(rules.values()) == set(RULES) - {NODES}
    assert rules[f"{STATUS}.collision"] == COUNTERS
    copied = {field for field, rule in rules.items() if rule == COPIES}
    assert copied < {f"{WAYPOINT}.{field.name}" for field in STATES[WAYPOINT].fields}


def test_it_is_an_option_of_the_detector_and_its_code_is_the_same_target():
    mission = {**FITS, "limits": LIMITS["published"]}
    detector, _ = load_detector("acceptance", "paper", None, mission, options={"rules": [1, 3]})
    assert detector.rules == (1, 3) and part_of(detector, "acceptance") is detector
    assert load_detector("recommended", "paper", None, mission).detector.rules == (1, 2, 3, 4, 5)


@pytest.mark.parametrize("rules", [[0], [6], 1, ["1"], [[1]]])
def test_there_are_five(rules):
    with pytest.raises(BadInputError, match="rules: .*: allowed: a list of numbers from 1 to 5"):
        AcceptanceTest(LIMITS["published"], rules=rules)
