"""Each of the five rules alone: together they are the acceptance test, and each alarm belongs to one of them."""

import pickle
from dataclasses import replace

import pytest

from mavfi.detectors import load_detector
from mavfi.detectors.acceptance import PLAIN, RULES, AcceptanceTest
from mavfi.detectors.detector import part_of
from mavfi.detectors.registry import is_named, mission_keys
from mavfi.detectors.single_rule import COPIES, COUNTERS, DYNAMICS, EPOCHS, NODES, SingleRule, fields_of, rule_of
from mavfi.errors import BadInputError
from mavfi.states import STATES
from tests.unit.detectors.streams import LIMITS
from tests.unit.detectors.test_acceptance import NOW, STATUS, WAYPOINT, flying, good
from tests.unit.detectors.test_registry import FITS

NUMBERS = range(COUNTERS, NODES + 1)


def alone(rule, autopilot="published"):
    """A detector in flight, with what `flying` has seen."""
    detector = SingleRule(LIMITS[autopilot], rule=rule)
    detector.restore(flying(autopilot).memory())
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
    found = {number: alone(number).check(state, NOW) for number in NUMBERS}
    assert whole is not None and whole.hard
    assert found.pop(rule) == replace(whole, source=f"rule_{rule}")
    assert set(found.values()) == {None}
    assert alone(rule).score(state, NOW) > 0.0
    assert alone(NODES).score(state, NOW) == 0.0


def test_every_checked_field_belongs_to_one_rule():
    every = [field for number in NUMBERS for field in fields_of(number)]
    assert sorted(every) == sorted(f"{name}.{field.name}" for name in RULES for field in STATES[name].fields)
    assert fields_of(NODES) == []
    assert rule_of(f"{STATUS}.collision") == COUNTERS
    assert set(fields_of(COPIES)) < {f"{WAYPOINT}.{field.name}" for field in STATES[WAYPOINT].fields}


def test_what_it_remembers_is_that_of_the_whole_test():
    one, whole = alone(COPIES), AcceptanceTest(LIMITS["published"])
    whole.restore(one.memory())
    broken = good("published")["no collision"][0]
    broken.header["collision"] = True  # passes, as another rule's
    assert one.check(broken, NOW) is None
    for detector in (one, whole):
        detector.accept(broken, NOW)
    assert one.memory() == whole.memory()
    again = pickle.loads(pickle.dumps(one))
    assert (again.rule, again.memory()) == (one.rule, one.memory())


@pytest.mark.parametrize("number", NUMBERS)
def test_they_are_detectors_by_name(number):
    detector, _ = load_detector(f"rule_{number}", "paper", None, {**FITS, "limits": LIMITS["published"]})
    assert isinstance(detector, SingleRule) and detector.rule == number
    assert mission_keys(f"rule_{number}").items() <= mission_keys("recommended").items()


@pytest.mark.parametrize("rule", [0, 6])
def test_there_are_five(rule):
    with pytest.raises(BadInputError, match=f"rule: {rule}: not known; allowed: 1 to 5"):
        SingleRule(LIMITS["published"], PLAIN, rule)


@pytest.mark.parametrize("number", NUMBERS)
def test_its_code_is_the_target_acceptance_under_its_own_name(number):
    detector, _ = load_detector(f"rule_{number}", "paper", None, {**FITS, "limits": LIMITS["published"]})
    assert part_of(detector, "acceptance") is detector
    assert is_named(f"rule_{number}", f"rule_{number}") and not is_named(f"rule_{number}", "acceptance")
