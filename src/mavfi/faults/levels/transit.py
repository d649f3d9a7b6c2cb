"""Inter-kernel messages in serialized form, and faults in the lengths of their lists.

The layout is that of ROS 1 (little-endian, packed; a uint32 length precedes each list; http://wiki.ros.org/msg) for
messages with the header fields in table order, then one list per element field.  A bit of a number is thus a bit of a
field of the state.  A flipped length moves everything behind it.
"""

from typing import NamedTuple

import numpy as np

from mavfi.states import State, StateSpec

_LENGTH = np.dtype("<u4")
"""Type of a list's length in a serialized message, as of ROS."""


def is_length(spec: StateSpec, name: str) -> bool:
    """Whether this names the length of a list."""
    return any(length.name == name for length in spec.lengths)


def serialize(state: State) -> bytearray:
    """The bytes of a message."""
    data = bytearray(state.header.tobytes())
    for field in state.spec.elements:
        data += np.array([len(state.elements)], _LENGTH).tobytes() + state.elements[field.name].tobytes()
    return data


def parse(spec: StateSpec, data: bytes | bytearray) -> State | None:
    """The state that a subscriber reads from a message; None = a list exceeds the message, which is then dropped.

    As ROS does, it ignores bytes that are left over; it cuts lists of unequal length to the shortest.
    """
    start = spec.header_dtype.itemsize
    header = np.frombuffer(bytearray(data[:start]), spec.header_dtype)
    # The lists: a length, and as many values.
    lists = []
    for field in spec.elements:
        kind = np.dtype(field.dtype)
        begin = start + _LENGTH.itemsize
        if begin > len(data):
            return None
        count = int(np.frombuffer(data, _LENGTH, 1, start)[0])
        start = begin + count * kind.itemsize
        if start > len(data):
            return None
        lists.append(np.frombuffer(data, kind, count, begin))
    elements = np.zeros(min(map(len, lists), default=0), spec.element_dtype)
    for field, values in zip(spec.elements, lists, strict=True):
        elements[field.name] = values[: len(elements)]
    return State(spec, header, elements)


class ChangedPublication(NamedTuple):
    """A publication with changed bits.

    Attributes:
        state: The publication as subscribers read it; None = they drop it.
        before: Value of the field before.
        after: Its value after.
        word: The bits of the value after, as an integer.
    """

    state: State | None
    before: float | int | bool
    after: float | int | bool
    word: int


def changed_bits(word: int, mask: int, stuck: int | None) -> int:
    """A word with masked bits flipped, or set as in `stuck` if this is not None."""
    if stuck is None:
        return word ^ mask
    return (word & ~mask) | (stuck & mask)


def with_length(state: State, name: str, mask: int, stuck: int | None = None) -> ChangedPublication:
    """The state as read after masked bits of a list's length were flipped, or set as in `stuck`.

    Args:
        state: A publication.
        name: As in `StateSpec.lengths`.
        mask: Bits to change.
        stuck: Their values; None = flip them.
    """
    data = serialize(state)
    start = state.spec.header_dtype.itemsize
    for field, length in zip(state.spec.elements, state.spec.lengths, strict=True):
        if length.name == name:
            break
        start += _LENGTH.itemsize + len(state.elements) * np.dtype(field.dtype).itemsize
    before = len(state.elements)
    after = changed_bits(before, mask, stuck)
    data[start : start + _LENGTH.itemsize] = np.array([after], _LENGTH).tobytes()
    return ChangedPublication(parse(state.spec, data), before, after, after)
