"""What a fault in a state changes: a field, or the length of a list in the serialized message.

The layout of a message is that of ROS 1 (little-endian, packed; a uint32 length precedes each list;
http://wiki.ros.org/msg) with the header fields in table order, then one list per element field.  A bit of a number is
thus a bit of a field of the state.  A flipped length moves everything behind it.
"""

import numpy as np

from mavfi.states import State, StateSpec

_LENGTH = np.dtype("<u4")
"""Type of a list's length in a serialized message, as of ROS."""


def is_length(spec: StateSpec, name: str) -> bool:
    """Whether this names the length of a list."""
    return any(length.name == name for length in spec.lengths)


class StateField:
    """The carrier of a field of a state, which is changed in place; `row` is that of a list element."""

    def __init__(self, state: State, name: str, row: int = 0) -> None:
        container = state.header
        if state.spec.in_elements(name):
            container = state.elements
        self._word = container[name][row : row + 1]

    def read(self) -> np.ndarray:
        """See `Carrier.read`."""
        return self._word.copy()

    def write(self, word: np.ndarray) -> None:
        """See `Carrier.write`."""
        self._word[:] = word


class ListLength:
    """The carrier of a list's length.

    Attributes:
        state: The publication as subscribers read it after a change; None = they drop it.
    """

    def __init__(self, state: State, name: str) -> None:
        self.state: State | None = state
        self._state = state
        self._name = name

    def read(self) -> np.ndarray:
        """See `Carrier.read`."""
        return np.array([len(self._state.elements)], _LENGTH)

    def write(self, word: np.ndarray) -> None:
        """See `Carrier.write`."""
        spec = self._state.spec
        data = serialize(self._state)
        start = spec.header_dtype.itemsize
        for field, length in zip(spec.elements, spec.lengths, strict=True):
            if length.name == self._name:
                break
            start += _LENGTH.itemsize + len(self._state.elements) * np.dtype(field.dtype).itemsize
        data[start : start + _LENGTH.itemsize] = word.tobytes()
        self.state = parse(spec, data)


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
