"""Keyword arguments of functions that fly: the keys of a mission, for type checkers and for completion."""

import inspect
from typing import get_type_hints

import pytest

import mavfi
from mavfi.mission_keys import MissionKeys, MissionKeysWithoutSeed

KEYS = {name: field.annotation for name, field in mavfi.MissionSpec.model_fields.items()}


def test_type_checkers_know_the_keys_of_a_mission():
    assert get_type_hints(MissionKeys) == KEYS
    assert KEYS.keys() - get_type_hints(MissionKeysWithoutSeed).keys() == {"seed"}


@pytest.mark.parametrize("function", [mavfi.fly, mavfi.draw])
def test_completion_and_help_know_the_keys_of_a_mission(function):
    parameters = inspect.signature(function).parameters
    assert KEYS.keys() <= parameters.keys() and "options" not in parameters
    assert "\n    wind: Amplitude of gusts, m/s.\n" in function.__doc__


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda: mavfi.fly(enviroment="dense"),
            r"^enviroment: unknown argument \(did you mean 'environment'\?\); allo",
        ),
        (
            lambda: mavfi.fly(detecter="gaussian"),
            r"^detecter: unknown argument \(did you mean 'detector'\?\); allowed: d",
        ),
        (lambda: mavfi.draw("null", seeds=3), r"^seeds: unknown argument \(did you mean 'seed'\?\); allowed: seed, "),
    ],
)
def test_an_unknown_argument_is_refused_with_the_likely_one(call, message):
    with pytest.raises(mavfi.BadInputError, match=message):
        call()
