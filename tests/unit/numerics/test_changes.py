import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from mavfi.numerics.changes import gather_changes

SIZE = 8
VALUES = st.sampled_from([0.0, -0.0, 1.5, -2.0, np.inf, np.nan])


@given(
    st.lists(st.tuples(st.integers(0, SIZE - 1), VALUES), max_size=12), st.lists(VALUES, min_size=SIZE, max_size=SIZE)
)
def test_changes_are_those_of_a_comparison_of_bits(written, content):
    array = np.array(content, np.float32)
    places = np.array([place for place, _ in written], np.int32)
    before = np.array([value for _, value in written] + [7.0], np.float32)  # longer than the places
    after, changed, old, new = np.empty(len(places), np.float32), *(np.empty(12, t) for t in "iff")
    count = gather_changes(array, places, before, after, changed, old, new)
    expected = [
        (place, was, array[place]) for place, was in zip(places, before, strict=False)
        if was.tobytes() != array[place].tobytes()
    ]  # fmt: skip
    assert after.tobytes() == array[places].tobytes()
    assert count == len(expected)
    assert changed[:count].tolist() == [place for place, _, _ in expected]
    for found, place in ((old, 1), (new, 2)):
        assert found[:count].tobytes() == np.array([one[place] for one in expected], np.float32).tobytes()
