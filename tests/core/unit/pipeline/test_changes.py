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

    def write(self, writes):
        places = np.array([index for index, _ in writes], np.int32)
        before = []
        for index, value in writes:
            before.append(self.array[index])
            self.array[index] = value
        self.changes.note(places, np.array(before, np.float32), self.array[places])

    def restore(self, saved):
        self.array[:] = self.changes.restore(saved)


@settings(max_examples=150)
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
