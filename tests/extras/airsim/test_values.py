"""Numbers of calls: counted, found, flipped."""

import math
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavfi.errors import BadInputError
from mavfi.extras.airsim import boundary as values
from mavfi.faults.changes import Change, ChangeInjector, When
from mavfi.faults.operations import Operation

LEAF = st.booleans() | st.integers(-(2**63), 2**63 - 1) | st.floats() | st.text(max_size=3) | st.binary(max_size=4)
DATA = st.recursive(
    LEAF | st.none(), lambda one: st.lists(one, max_size=4) | st.dictionaries(st.text(max_size=3), one, max_size=4)
)


def bits(value):
    return struct.pack("<d", value) if isinstance(value, float) else value


@given(DATA)
def test_every_number_has_a_path_and_there_are_no_others(data):
    paths = [values.path_of(data, n) for n in range(values.count(data))]
    assert None not in paths and len(set(paths)) == len(paths)
    assert values.path_of(data, values.count(data)) is None


def flip(container, path, bit, *, is_double=False):
    """Flip a bit of the number at a path; the number before and after."""
    number = values.CallNumber(container, path, is_double=is_double)
    change = ChangeInjector.of(Change(Operation("flip", bit=bit % number.bits), When()))
    return tuple(change.change(number))


@given(st.floats() | st.integers(-(2**63), 2**63 - 1) | st.booleans(), st.integers(0, 63))
def test_a_flip_changes_one_bit_and_is_its_own_inverse(value, bit):
    container = [value]
    before, changed = flip(container, (0,), bit)
    assert bits(container[0]) == bits(changed)
    assert bits(before) == bits(value)
    assert type(changed) is type(value) and bits(changed) != bits(value)
    assert bits(flip(container, (0,), bit)[1]) == bits(value)


def test_a_flip_goes_where_its_path_leads():
    data = [1.0, {"x": [2.0, True], "image": b"\x01\x02"}, 3]
    assert flip(data, (1, "x", 0), 63) == (2.0, -2.0) and data[1]["x"][0] == -2.0
    assert flip(data, (1, "x", 1), 40) == (True, False)
    assert flip(data, (1, "image", 1), 9) == (2, 0) and data[1]["image"] == b"\x01\x00"
    assert flip(data, (2,), 63, is_double=True) == (3.0, -3.0)
    assert math.isinf(flip(data, (0,), 62)[1])


@pytest.mark.parametrize("path", [(3,), (1, "y"), (1, "image", 2), (1, "x"), (0, 0), (1, "name", 0)])
def test_what_is_no_number_cannot_be_changed(path):
    with pytest.raises(BadInputError):
        values.CallNumber([1.0, {"x": [2.0], "image": b"\x01\x02", "name": "abc"}], path, is_double=False)
