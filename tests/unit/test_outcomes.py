import pytest

from mavfi.outcomes import FlightEnd, Outcome, classify


@pytest.mark.parametrize(
    ("golden", "injected", "outcome"),
    [
        (FlightEnd("a"), FlightEnd("a"), Outcome.MASKED),
        (FlightEnd("a"), FlightEnd("b"), Outcome.SDC),
        (FlightEnd("a"), FlightEnd(None, died=True), Outcome.DUE),
        (None, FlightEnd(None, died=True), Outcome.DUE),
        (None, FlightEnd("a"), Outcome.UNKNOWN),
        (FlightEnd("a"), FlightEnd(None), Outcome.UNKNOWN),
        (FlightEnd(None), FlightEnd(None), Outcome.UNKNOWN),
    ],
)
def test_classify(golden, injected, outcome):
    assert classify(golden, injected) is outcome


def test_outcomes_have_labels_and_sentences():
    assert [outcome.label for outcome in Outcome] == ["masked", "sdc", "due", "unknown"]
    assert all(outcome.value.endswith(".") for outcome in Outcome)
