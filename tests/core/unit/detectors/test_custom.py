"""Custom detectors: which ones they are, and a call that ends its process, or does not return, is named."""

import os
import signal
import time

import numpy as np
import pytest

from mavfi.detectors.detector import (
    Chain,
    CustomCallError,
    Detector,
    NoDetector,
    NotedCalls,
    StateChangedError,
    is_custom,
    split_noting_calls,
)
from mavfi.ir.forked import ForkPoint
from mavfi.states import new_state


class Own(Detector):
    """Does something else at each call of a method."""

    def __init__(self, **calls):
        self.calls = calls

    def start(self): ...

    def check(self, state, time_us):
        return self.calls.get("check", lambda: None)()

    def accept(self, state, time_us):
        self.calls.get("accept", lambda: None)()


def crash():
    os.kill(os.getpid(), signal.SIGSEGV)


def sleep():
    time.sleep(60)


def in_child(work, timeout=60.0):
    """How a child ended that does some work."""
    point = ForkPoint()
    with point.guard():
        ended = split_noting_calls(point, timeout)
        if ended is None:
            work()
            point.finish(b"done")
    return ended


@pytest.mark.parametrize(
    ("detector", "custom"), [(None, False), (NoDetector(), False), (Own(), True), (Chain(NoDetector(), Own()), True)]
)
def test_a_detector_is_custom_if_a_part_is_not_of_mavfi(detector, custom):
    assert is_custom(detector) == custom


@pytest.mark.parametrize(
    ("end", "how"),
    [(crash, r"ended its process \(SIGSEGV\)"), (lambda: os._exit(3), r"ended its process \(ended with status 3")],
)
@pytest.mark.parametrize("method", ["check", "accept"])
def test_a_call_that_ends_its_process_is_named(end, how, method):
    calls = NotedCalls(Own(**{method: end}))
    with pytest.raises(CustomCallError, match=rf"^detector \S+test_custom:Own: {method} {how}"):
        in_child(lambda: getattr(calls, method)(new_state("control.command"), 0))


def test_a_call_that_does_not_return_is_named():
    with pytest.raises(CustomCallError, match=r"^detector \S+:Own: check did not return within 0.3 s$"):
        in_child(lambda: NotedCalls(Own(check=sleep)).check(new_state("control.command"), 0), timeout=0.3)


class Writer(Detector):
    """Changes what it is shown."""

    def check(self, state, time_us):
        state.header["vx"] = np.nan

    def accept(self, state, time_us):
        state.header["vx"] = np.nan

    def seal(self, state, time_us):
        state.header["vx"] = np.nan


@pytest.mark.parametrize("method", ["check", "accept", "seal"])
def test_a_detector_that_changes_a_state_is_named_and_the_state_is_restored(method):
    state = new_state("control.command")
    with pytest.raises(StateChangedError, match=rf":Writer: {method} changed control.command at 3.50 s"):
        getattr(NotedCalls(Writer()), method)(state, 3_500_000)
    assert state.same_bits(new_state("control.command"))
