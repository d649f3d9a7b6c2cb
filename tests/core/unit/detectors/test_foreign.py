"""GAD and AAD on numbers of which nothing is known."""

import numpy as np
import pytest

from mavfi.detectors.foreign import foreign_spec, foreign_state, learn
from mavfi.errors import BadInputError

SPECS = {"/arm": foreign_spec("/arm", ["position[0]", "tiny"]), "/speed": foreign_spec("/speed", ["v.x"])}


def normal(count, start=0):
    """Two sources in turn: slow sines, one of them tiny, and a constant."""
    found = []
    for step in range(start, start + count):
        found.append(foreign_state(SPECS["/arm"], [np.sin(0.02 * step), 1e-6 * np.cos(0.03 * step)]))
        found.append(foreign_state(SPECS["/speed"], [5.0]))
    return found


def watch(detector, states):
    """Places of the alarms, and their fields."""
    detector.start()
    found = {}
    for place, state in enumerate(states):
        alarm = detector.check(state, place)
        detector.accept(state, place)
        if alarm is not None:
            found[place] = alarm.fields
    return found


@pytest.mark.parametrize("kind", ["gaussian", "autoencoder"])
@pytest.mark.parametrize("profile", ["paper", "tuned"])
def test_normal_numbers_raise_no_alarm_and_a_wild_one_does(kind, profile):
    detector = learn(kind, profile, [normal(800)], SPECS)
    assert watch(detector, normal(400, 800)) == {}
    for place, values, field in ((201, [5e9], "/speed.v.x"), (300, [1e12, 0.0], "/arm.position[0]")):
        states = normal(400, 800)
        states[place] = foreign_state(states[place].spec, values)
        found = watch(detector, states)
        assert min(found) == place and field in found[place], (place, found)


@pytest.mark.parametrize(
    ("kind", "states", "message"),
    [
        ("oracle", normal(100), "allowed: gaussian, autoencoder"),
        ("gaussian", normal(49), "49 messages of /arm; allowed: 50 or more"),
        (
            "gaussian",
            [*normal(100), foreign_state(SPECS["/arm"], [np.inf, 0.0])],
            "/arm position[0]: holds numbers that",
        ),
    ],
)
def test_what_cannot_be_learned_is_refused(kind, states, message):
    with pytest.raises(BadInputError) as error:
        learn(kind, "tuned", [states], SPECS)
    assert message in str(error.value)
