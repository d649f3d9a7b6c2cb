"""Serialized messages and wrong lengths of their lists; the oracle is rosbags, which decodes whole messages."""

import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rosbags.serde.errors import SerdeError
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from mavfi.faults.changes import ValueChange
from mavfi.faults.fault import NO_SITE, FaultSite, fault_from_json
from mavfi.faults.operations import Operation
from mavfi.faults.strata import WORD_BITS
from mavfi.levels.state.carriers import ListLength, parse, serialize
from mavfi.levels.state.drawing import draw_in_message, locate_bit, message_bits
from mavfi.levels.state.fault import StateFault
from mavfi.levels.state.injector import StateInjector
from mavfi.record import Profile
from mavfi.states import STATES, new_state

LISTS = [name for name, spec in STATES.items() if spec.elements]
STRATA = ("sign_exponent", "mantissa", "length")


def random_state(name, count, seed=0):
    state, random = new_state(name, count), np.random.default_rng(seed)
    for part in (state.header, state.elements):
        for field in part.dtype.names or ():
            part[field] = (
                random.integers(0, 2, len(part)) if part[field].dtype == bool else random.normal(size=len(part))
            )
    return state


TYPES = {"f8": "float64", "f4": "float32", "i4": "int32", "?": "bool"}


def header_slots(spec):
    """Member of each field of the header."""
    return [f"header_{field.name}" for field in spec.header]


def element_slots(spec):
    """Member of each field of the elements."""
    return [field.name for field in spec.elements]


def message_text(spec):
    """Message definition of a state, as in a `.msg` file."""
    numbers = [f"{TYPES[field.dtype]} {slot}" for slot, field in zip(header_slots(spec), spec.header, strict=True)]
    lists = [f"{TYPES[field.dtype]}[] {slot}" for slot, field in zip(element_slots(spec), spec.elements, strict=True)]
    return "\n".join(numbers + lists) + "\n"


def decoded(spec, data):
    """The message as rosbags reads it; None = it cannot."""
    text = message_text(spec)
    store = get_typestore(Stores.ROS1_NOETIC)
    store.register(get_types_from_msg(text, "mavfi_msgs/msg/Own"))
    definition = store.get_msgdef("mavfi_msgs/msg/Own")
    try:  # not `store.deserialize_ros1`, which also refuses bytes that are left over; subscribers do not
        return definition.deserialize_ros1(memoryview(bytes(data)), 0, definition.cls, store)[0]
    except (SerdeError, struct.error, ValueError):
        return None


def same(spec, state, message):
    """Whether a state is the message that rosbags read, with lists cut to the shortest."""
    lists = [np.asarray(getattr(message, slot)) for slot in element_slots(spec)]
    count = min(map(len, lists), default=0)
    return (
        len(state.elements) == count
        and all(
            state.header[field.name][0].tobytes() == np.array(getattr(message, slot), field.dtype).tobytes()
            for field, slot in zip(spec.header, header_slots(spec), strict=True)
        )
        and all(
            state.elements[field.name].tobytes() == values[:count].astype(field.dtype).tobytes()
            for field, values in zip(spec.elements, lists, strict=True)
        )
    )


@pytest.mark.parametrize("name", STATES)
def test_a_message_has_the_bytes_that_ros_gives_it(name):
    state = random_state(name, 3 if STATES[name].elements else 0)
    assert same(state.spec, state, decoded(state.spec, serialize(state)))
    assert parse(state.spec, serialize(state)).same_bits(state)


@given(st.sampled_from(LISTS), st.integers(0, 5), st.data())
def test_a_wrong_length_is_read_as_ros_reads_it(name, count, data):
    spec, state = STATES[name], random_state(name, count)
    field = data.draw(st.sampled_from([length.name for length in spec.lengths]))
    bit = data.draw(st.integers(0, 31))
    carrier = ListLength(state, field)
    before, after = ValueChange(Operation("flip", bit=bit)).apply(carrier)
    received = carrier.state
    assert (before, after) == (count, count ^ 1 << bit)
    raw, start = serialize(state), spec.header_dtype.itemsize
    for element_field in spec.elements:
        if f"length_{element_field.name}" == field:
            raw[start : start + 4] = after.to_bytes(4, "little")
        start += 4 + count * np.dtype(element_field.dtype).itemsize
    message = decoded(spec, raw)
    assert (received is None) == (message is None)
    assert received is None or same(spec, received, message)


@given(st.sampled_from(list(STATES)), st.integers(0, 4), st.sampled_from(STRATA))
def test_every_bit_of_a_stratum_has_one_number(name, count, stratum):
    spec = STATES[name]
    parts, share = message_bits(name, stratum, count)
    total = sum(copies * len(bits) for _, copies, bits in parts)
    places = {locate_bit(parts, place) for place in range(total)}
    assert len(places) == total
    with pytest.raises(IndexError):
        locate_bit(parts, total)
    for field, copy, bit in places:
        assert copy < (count if spec.in_elements(field) else 1) and bit < WORD_BITS[spec.find(field).dtype]
    shares = [message_bits(name, one, count)[1] for one in STRATA]
    assert sum(shares) == pytest.approx(1.0) and share == pytest.approx(shares[STRATA.index(stratum)])


def profile(name, count):
    return Profile({name: np.arange(1, 6, dtype=np.int64) * 100_000}, {name: np.full(5, count, np.int32)})


def test_faults_in_a_message_are_drawn_bit_by_bit():
    name = "planning.path"
    drawn = [draw_in_message(name, "length", profile(name, 7), seed) for seed in range(300)]
    assert draw_in_message(name, "length", profile(name, 7), 3) == drawn[3]
    assert {fault.where.field for fault in drawn} == {"length_x", "length_y", "length_z"}
    assert {fault.bit for fault in drawn} == set(range(32)) and {fault.bit_class for fault in drawn} == {"length"}
    assert len({fault.time_us for fault in drawn}) == 5
    drawn = [draw_in_message(name, "sign_exponent", profile(name, 7), seed) for seed in range(2000)]
    in_list = sum(fault.where.element is not None for fault in drawn) / len(drawn)
    assert in_list == pytest.approx(21 * 12 / (21 * 12 + 12 + 1 + 1), abs=0.02)  # entry_speed, two counters


def test_a_message_that_is_never_published_or_has_no_such_bit_gives_no_site():
    assert draw_in_message("planning.path", "length", Profile(), 1).time_us == NO_SITE
    name = "perception.map_update"
    assert draw_in_message(name, "mantissa", profile(name, 0), 1).has_site  # its header has bits
    name = "perception.map_update"
    assert draw_in_message(name, "exponent", profile(name, 0), 1).weight == 0.0  # no voxel, no float
    name = "planning.waypoint"
    assert not draw_in_message(name, "length", profile(name, 0), 1).has_site


def lengths(fault, *states):
    injector = StateInjector(fault)
    return [injector(state, time) for time, state in enumerate(states)], injector.finish()


def test_the_injector_loses_a_message_and_says_so():
    state = random_state("planning.path", 3)
    fault = StateFault(FaultSite("planning.path", "length_z"), 1, 31)
    seen, (injection,) = lengths(fault, state, state, state)
    assert seen[1] is None and seen[0] is state and seen[2] is state
    assert injection.activated and injection.details == {"lost": True}
    assert (injection.before, injection.after) == (3, 3 + 2**31)
    assert fault_from_json(fault.to_json()) == fault
