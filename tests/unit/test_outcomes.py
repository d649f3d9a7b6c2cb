from dataclasses import replace

import pytest

from mavfi.flight_log import KernelEffect
from mavfi.flight_record import End, FlightRecord
from mavfi.outcomes import DUE, Effect, effect_of

A, B = FlightRecord(End.FLOWN, digest="a"), FlightRecord(End.FLOWN, digest="b")
LOST, DEAD = FlightRecord(End.UNKNOWN, error="ZeroDivisionError"), FlightRecord(End.DUE, error="died each time")


@pytest.mark.parametrize(
    ("golden", "injected", "effect"),
    [
        (A, A, Effect.MASKED),
        (A, B, Effect.SDC),
        (A, DEAD, Effect.CRASH),
        (None, DEAD, Effect.CRASH),
        (None, A, Effect.UNKNOWN),
        (A, LOST, Effect.UNKNOWN),
        (LOST, LOST, Effect.UNKNOWN),
        (DEAD, A, Effect.UNKNOWN),
    ],
)
def test_the_effect_of_a_fault_on_a_flight(golden, injected, effect):
    assert effect_of(golden, injected) is effect


def test_what_protected_code_found_is_not_silent():
    assert effect_of(A, replace(B, kernel=KernelEffect("detected"))) is Effect.DETECTED
    assert effect_of(A, replace(A, kernel=KernelEffect("detected"))) is Effect.MASKED


def test_effects_have_labels_and_sentences():
    labels = ["masked", "sdc", "crash", "hang", "exception", "detected", "not_activated", "unknown"]
    assert [effect.label for effect in Effect] == labels
    assert all(effect.value.endswith(".") for effect in Effect)
    assert {effect.label for effect in DUE} == {"crash", "hang", "exception"}
