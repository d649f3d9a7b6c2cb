"""Recorded calls of a function."""

import numpy as np

from mavfi.extras.hardening.observed import CallRecording


def test_recorded_calls_are_spread_evenly_and_taken_before_the_call():
    recording, value = CallRecording(), np.zeros(1)
    for number in range(300):
        recording.note((value,))
        value += 1
        assert recording.total == number + 1
    calls = sorted(recording.arguments)
    assert 12 <= len(calls) <= 24 and len(set(np.diff(calls))) == 1 and calls[0] == 0
    assert all(recording.arguments[call][0][0] == call for call in calls)


def test_large_arguments_are_recorded_less_often():
    recording, large = CallRecording(), np.zeros(1 << 22)  # 32 MiB, of which four fit
    for _ in range(9):
        recording.note((large,))
    assert sorted(recording.arguments) == [0, 4, 8]
