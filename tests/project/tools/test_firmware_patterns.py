"""What a fault does to a short flight: pure functions, on flights made by hand."""

import math

import numpy as np
import pytest

from mavfi.record import Injection
from tools import firmware_patterns as patterns
from tools.firmware_patterns import PatternFlight

TRACK = np.linspace((0.0, 0.0, 8.0), (6.0, 0.0, 8.0), 100)


def flight(
    off=0.0,
    *,
    count=100,
    tilt=0.1,
    touched=False,
    lost=("", ""),
    digest="other",
    symbol="pidController+0x4",
    register="rax",
    time_s=3.0,
):
    one = Injection("register", register, time_s, 3, "0x0", "0x8", True, details={"symbol": symbol})
    return PatternFlight((TRACK + [0.0, off, 0.0])[:count], tilt, touched, lost, digest, one)


GOLDEN = flight(digest="golden")


@pytest.mark.parametrize(
    ("found", "expected"),
    [
        (flight(digest="golden"), "bit-identical"),
        (flight(0.019), "slight"),
        (flight(0.021), "degraded"),
        (flight(4.9), "degraded"),
        (flight(5.1), "loss of control"),
        (flight(tilt=math.radians(61)), "loss of control"),
        (flight(0.001, touched=True), "loss of control"),
        (flight(lost=("crash", "SIGSEGV")), "process ends"),
        (flight(lost=("hang", ""), touched=True), "hang"),
    ],
)
def test_the_outcome_is_the_worst_that_happened(found, expected):
    assert patterns.outcome(GOLDEN, found) == expected
    assert expected in patterns.OUTCOMES


def test_phases_are_those_of_the_pattern():
    assert patterns.phase("hover", flight().injection) == "hover"
    assert patterns.phase("square", flight(time_s=4.2).injection) == "turning"
    assert patterns.phase("square", flight(time_s=3.0).injection) == "straight"


def test_the_square_closes():
    ways = np.array(patterns.PATTERNS["square"])[:, :3]
    assert ways.sum(axis=0).tolist() == [0.0, 0.0, 0.0]
