"""What nodes send to each other, as bytes: every bit arrives."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavfi.detectors.detector import Alarm
from mavfi.extras.ros.lockstep.encoding import (
    Answer,
    NodeAction,
    NodeOrder,
    TopicFrame,
    answer_from_bytes,
    answer_to_bytes,
    from_bytes,
    from_frame,
    operations_from_bytes,
    operations_to_bytes,
    to_bytes,
    to_frame,
)
from mavfi.states import STATES


@st.composite
def states(draw, name):
    """Any bits at all."""
    spec = STATES[name]
    count = draw(st.integers(0, 5)) if spec.elements else 0
    size = spec.header_dtype.itemsize + count * spec.element_dtype.itemsize
    return spec, draw(st.binary(min_size=size, max_size=size)), count


@pytest.mark.slow
@given(st.sampled_from(sorted(STATES)).flatmap(states))
def test_a_value_becomes_bytes_and_a_value_again(value):
    spec, bits, count = value
    state = from_bytes(spec, bits)
    assert len(state.elements) == count
    assert to_bytes(state) == bits
    state.header.view(np.uint8)[0] ^= 1  # an injector changes it
    assert to_bytes(state) != bits


@given(st.integers(-1, 2**63 - 1), st.integers(0, 10**12), st.binary(max_size=8))
def test_a_frame_is_what_was_framed(number, time_us, content):
    assert from_frame(to_frame(number, time_us, content)) == TopicFrame(number, time_us, content)


def test_operations_and_answers_survive():
    operations = [
        NodeOrder(NodeAction.STEP, "planner", 7, 20_000, 60_000),
        NodeOrder(NodeAction.GIVE, "pid", 3, state="planning.waypoint", value="00ff"),
    ]
    assert operations_from_bytes(operations_to_bytes(operations)) == operations
    for score in (0.1 + 0.2, np.inf, 5e-324):
        alarm = Alarm("gaussian", "planning", stop=True, score=score, fields=("a.x", "b.y"))
        answer = Answer(True, ["planning.path"], [4], alarm)
        assert answer_from_bytes(answer_to_bytes(answer)) == answer
    assert answer_from_bytes(answer_to_bytes(Answer())) == Answer()
