import math
import struct

import pytest

from mavfi.reports.change import change


@pytest.mark.parametrize(
    ("before", "after", "told"),
    [
        (2.5, 1e300, ("2.5", "1e+300")),
        (2.7495712345, 2.7495712346, ("2.7495712345", "2.7495712346")),
        (0.0, -0.0, ("0", "-0")),
        (3, 4, ("3", "4")),
        (1.5, "inf", ("1.5", "inf")),
        (False, True, ("False", "True")),
        (2.5, 2.5, ("2.5", "2.5")),
    ],
)
def test_as_short_as_shows_the_difference(before, after, told):
    assert change(before, after) == told


def test_digits_are_given_by_the_caller():
    assert change(51.30162, 9.463487e20, digits=4) == ("51.3", "9.463e+20")
    assert change(51.30162, 51.30163, digits=4) == ("51.30162", "51.30163")


def test_nans_are_told_by_their_bits():
    (other,) = struct.unpack(">d", bytes.fromhex("7ff8000000000001"))
    assert change(math.nan, other) == ("nan (0x7ff8000000000000)", "nan (0x7ff8000000000001)")
