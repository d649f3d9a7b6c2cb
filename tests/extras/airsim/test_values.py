"""Numbers of calls: counted, found, flipped."""

import math
import struct

from hypothesis import given
from hypothesis import strategies as st

from mavfi.extras.airsim import boundary as values
from mavfi.faults.strata import WORD_BITS

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


@given(st.floats() | st.integers(-(2**63), 2**63 - 1) | st.booleans(), st.integers(0, 63))
def test_a_flip_changes_one_bit_and_is_its_own_inverse(value, bit):
    bit %= WORD_BITS[values.dtype_of(value)]
    changed = values.flipped(value, bit)
    assert type(changed) is type(value) and bits(changed) != bits(value)
    assert bits(values.flipped(changed, bit)) == bits(value)


def test_a_flip_goes_where_its_path_leads():
    data = [1.0, {"x": [2.0, True], "image": b"\x01\x02"}]
    flipped, before, after, bit = values.flip(data, (1, "x", 0), 63)
    assert (flipped, before, after, bit) == (data, 2.0, -2.0, 63) and data[1]["x"][0] == -2.0
    assert values.flip(data, (1, "x", 1), 40)[1:] == (True, False, 0)
    assert values.flip(data, (1, "image", 1), 9)[1:] == (2, 0, 1) and data[1]["image"] == b"\x01\x00"
    assert math.isinf(values.flip(1.0, (), 62)[0])
