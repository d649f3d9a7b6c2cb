import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from mavfi.numerics.changes import select_changes

VALUES = st.sampled_from([0.0, -0.0, 1.5, -2.0, np.inf, np.nan])


@given(st.lists(st.tuples(st.integers(0, 7), VALUES, VALUES), max_size=12))
def test_changes_are_those_of_a_comparison_of_bits(written):
    places = np.array([place for place, _, _ in written], np.int32)
    before = np.array([value for _, value, _ in written] + [7.0], np.float32)  # longer than the places
    after = np.array([value for _, _, value in written], np.float32)
    changed = np.empty(12, np.int32), np.empty(12, np.float32), np.empty(12, np.float32)
    count = select_changes(places, before, after, *changed)
    expected = [one for one in zip(places, before, after, strict=False) if one[1].tobytes() != one[2].tobytes()]
    assert count == len(expected)
    for found, values in zip(changed, zip(*expected, strict=True), strict=True) if expected else ():
        assert found[:count].tobytes() == np.array(values, found.dtype).tobytes()
