"""The first published field that differs."""

import math

import numpy as np
import pytest

from mavfi.flight.instruction_cases import Output, first_difference

SIGNALLING = np.array([0x7FA00000], np.uint32).view(np.float32)[0]


def output(value):
    header = np.zeros(1, [("stamp", "i8")])
    elements = np.zeros(3, [("x", "f4")])
    elements["x"][1:2].view(np.uint32)[:] = np.float32(value).view(np.uint32)
    if value is SIGNALLING:
        elements["x"].view(np.uint32)[1] = 0x7FA00000
    return Output({"perception.point_cloud": (header, elements)}, b"")


@pytest.mark.parametrize(("value", "largest"), [(2.5, 2.5), (math.inf, math.inf), (SIGNALLING, math.inf)])
def test_any_corrupted_value_is_described_without_a_warning(value, largest):
    difference = first_difference(output(0.0), output(value))
    assert difference is not None and (difference["field"], difference["element"], difference["elements"]) == (
        "x",
        1,
        1,
    )
    assert difference["largest"] == largest
