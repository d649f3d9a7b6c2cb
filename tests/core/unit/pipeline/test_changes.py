import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from mavfi.pipeline.memory import Changes

SIZE = 12
WRITES = st.lists(st.tuples(st.integers(0, SIZE - 1), st.sampled_from([0.0, -0.0, 1.5, -2.0, np.nan])), max_size=6)


class Plain:
    """An array whose changes are kept, and copies of all it was."""

    def __init__(self):
        self.array = np.zeros(SIZE, np.float32)
        self.changes = Changes(self.array)

    def put(self, places, values):
        for place, value in zip(places, values, strict=True):
            self.array[place] = value

    def write(self, writes):
        places = np.array([place for place, _ in writes], np.int32)
        before = []
        for place, value in writes:
            before.append(self.array[place])
            self.array[place] = value
        self.changes.note(places, np.array(before, np.float32), self.array[places])

    def restore(self, saved):
        self.array[:] = self.changes.restore(saved)


@settings(max_examples=150, deadline=None)
@given(st.lists(WRITES, max_size=8), st.lists(st.tuples(st.integers(0, 99), WRITES), max_size=8))
def test_every_content_can_be_gone_back_to(first, more):
    plain = Plain()
    saves = [(plain.changes.save(), plain.array.copy())]
    for writes in first:
        plain.write(writes)
        saves.append((plain.changes.save(), plain.array.copy()))
    for number, writes in more:
        saved, content = saves[number % len(saves)]
        plain.restore(saved)
        assert plain.array.tobytes() == content.tobytes()
        plain.write(writes)
        saves.append((plain.changes.save(), plain.array.copy()))
    for saved, content in saves:
        assert plain.changes.same(saved, 0) == (plain.array.tobytes() == content.tobytes())


@settings(max_examples=50, deadline=None)
@given(st.lists(WRITES, max_size=8), st.integers(0, 8))
def test_changes_are_taken_back_one_by_one(writes, left):
    plain, contents = Plain(), []
    for some in writes:
        contents.append(plain.array.copy())
        plain.write(some)
    contents.append(plain.array.copy())
    left = min(left, len(writes))
    plain.changes.take_back(left, plain.put)
    assert len(plain.changes) == left
    assert plain.array.tobytes() == contents[left].tobytes()


def test_what_may_be_taken_back_must_be_the_same_too():
    one, other = Plain(), Plain()
    one.write([(3, 1.0)])
    saved = one.changes.save()
    other.write([(3, 2.0)])
    other.write([(3, 1.0)])
    assert other.changes.same(saved, 0), "the arrays are"
    assert not other.changes.same(saved, 1), "to take the last change back gives 2 here and 0 there"
    assert not other.changes.same(saved, 2)
    one.write([(3, 1.0)])
    again = Plain()
    again.write([(3, 1.0)])
    again.write([(3, 1.0)])
    assert again.changes.same(one.changes.save(), 2)


def test_what_was_forgotten_cannot_be_taken_back():
    plain = Plain()
    plain.write([(0, 1.0)])
    plain.changes.forget()
    plain.write([(0, 2.0)])
    plain.changes.take_back(0, plain.put)
    assert plain.array[0] == 1.0
