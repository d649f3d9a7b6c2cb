"""Messages derived from the table of states: every field, every bit."""

import io
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from mavfi.extras.ros.ros1 import messages as ros_messages
from mavfi.extras.ros.ros1.messages import from_msg, from_stamp, to_msg
from mavfi.states import STATES, State
from tests.extras.ros.ros1.needs import ros


def blank():
    """What a message object is to the conversion: attributes, and a stamp in its header."""
    return SimpleNamespace(header=SimpleNamespace(stamp=SimpleNamespace(secs=0, nsecs=0)), number=0)


@st.composite
def states(draw, name):
    """Any bits at all; flags are 0 or 1."""
    spec = STATES[name]
    count = draw(st.integers(0, 5)) if spec.elements else 0
    parts = []
    for dtype, rows in ((spec.header_dtype, 1), (spec.element_dtype, count)):
        raw = bytearray(draw(st.binary(min_size=dtype.itemsize * rows, max_size=dtype.itemsize * rows)))
        array = np.frombuffer(raw, dtype).copy() if dtype.itemsize else np.zeros(rows, dtype)
        for field in dtype.names or ():
            if dtype[field].kind == "b":
                array[field] = array[field].view(np.uint8) & 1
        parts.append(array)
    return State(spec, *parts)


any_state = st.sampled_from(sorted(STATES)).flatmap(states)


@pytest.mark.slow
@given(any_state, st.integers(0, 2**63), st.integers(0, 10**12))
def test_a_state_becomes_a_message_and_a_state_again(state, number, time_us):
    message = to_msg(state, number, time_us, blank)
    assert message.number == number
    assert from_stamp(message.header.stamp) == time_us
    assert from_msg(message, state.spec).same_bits(state)


def test_lists_of_unequal_length_are_cut():
    spec = STATES["perception.map_update"]
    message = to_msg(State(spec, np.zeros(1, spec.header_dtype), np.ones(5, spec.element_dtype)), 1, 0, blank)
    message.log_odds = message.log_odds[:3]
    assert len(from_msg(message, spec).elements) == 3


@pytest.fixture(scope="module")
def store():
    """The same definitions in the library `rosbags`."""
    store = get_typestore(Stores.ROS1_NOETIC)
    for name, text in ros_messages.definitions().items():
        store.register(get_types_from_msg(text, f"{ros_messages.PACKAGE}/msg/{name}"))
    return store


class TestOnTheWire:
    pytestmark = ros

    @given(any_state)
    def test_no_bit_is_lost(self, messages, state):
        kind = messages[state.spec.name]
        wire = io.BytesIO()
        to_msg(state, 7, 123_456, kind).serialize(wire)
        came = kind()
        came.deserialize(wire.getvalue())
        assert from_msg(came, state.spec).same_bits(state)
        assert (came.number, from_stamp(came.header.stamp)) == (7, 123_456)

    @pytest.mark.parametrize("name", STATES)
    def test_another_library_sees_the_same_type_and_values(self, messages, store, name):
        spec = STATES[name]
        full = f"{ros_messages.PACKAGE}/msg/{ros_messages.type_name(spec)}"
        assert store.generate_msgdef(full)[1] == messages[name]._md5sum
        random = np.random.default_rng(3)
        state = State(spec, np.zeros(1, spec.header_dtype), np.zeros(4 if spec.elements else 0, spec.element_dtype))
        for array in (state.header, state.elements):
            for field in array.dtype.names or ():
                array[field] = random.integers(0, 2 if array.dtype[field].kind == "b" else 100, len(array))
        wire = io.BytesIO()
        to_msg(state, 5, 20_000, messages[name]).serialize(wire)
        came = store.deserialize_ros1(wire.getvalue(), full)
        assert came.number == 5
        for slot, field in zip(ros_messages.header_slots(spec), spec.header, strict=True):
            assert getattr(came, slot) == state.header[field.name][0]
        for slot, field in zip(ros_messages.element_slots(spec), spec.elements, strict=True):
            assert np.array_equal(getattr(came, slot), state.elements[field.name])
