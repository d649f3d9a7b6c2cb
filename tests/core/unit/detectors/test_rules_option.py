"""Each of the five rules alone: together they are the acceptance test, and each alarm belongs to one of them."""

import pytest

from mavfi.detectors.acceptance import (
    CHECKED,
    COPIES,
    COUNTERS,
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
from tests.core.unit.detectors.test_acceptance import STATUS, WAYPOINT
from tests.core.unit.detectors.test_registry import FITS


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
