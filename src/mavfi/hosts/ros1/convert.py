"""Bit-exact conversion between states and ROS messages of this package; pure functions on message objects."""

from typing import Any

import numpy as np

from mavfi.hosts.ros1.definitions import element_slots, header_slots
from mavfi.states import STATES, State, StateSpec

MAP = "map"
"""World frame (REP-105), in which all states are expressed."""
FIRST_STAMP_S = 1
"""Stamp of the mission's start (s): in ROS a stamp of 0 means "not set"."""
_SLOTS = {spec.name: (header_slots(spec), element_slots(spec)) for spec in STATES.values()}


def to_stamp(stamp: Any, time_us: int) -> None:
    """Set a `genpy.Time` to an instant of the flight."""
    seconds, rest = divmod(time_us, 1_000_000)
    stamp.secs, stamp.nsecs = seconds + FIRST_STAMP_S, 1_000 * rest


def from_stamp(stamp: Any) -> int:
    """Instant of the flight (microseconds) of a `genpy.Time`."""
    return (int(stamp.secs) - FIRST_STAMP_S) * 1_000_000 + int(stamp.nsecs) // 1_000


def to_msg(state: State, number: int, time_us: int, kind: Any) -> Any:
    """A message (of a class of `generate.state_types`) with the same bits; `time_us`: instant for its stamp."""
    message = kind()
    to_stamp(message.header.stamp, time_us)
    message.header.frame_id = MAP
    message.number = number
    header, elements = _SLOTS[state.spec.name]
    for slot, value in zip(header, state.header[0].item(), strict=True):
        setattr(message, slot, value)
    for slot, field in zip(elements, state.spec.elements, strict=True):
        setattr(message, slot, np.ascontiguousarray(state.elements[field.name]))
    return message


def from_msg(message: Any, spec: StateSpec) -> State:
    """The state of a message; element lists of unequal length, which no mavfi node sends, are truncated."""
    header, slots = _SLOTS[spec.name]
    state_header = np.zeros(1, spec.header_dtype)
    state_header[0] = tuple(getattr(message, slot) for slot in header)
    lists = [np.asarray(getattr(message, slot)) for slot in slots]
    count = min(map(len, lists)) if lists else 0
    elements = np.zeros(count, spec.element_dtype)
    for values, field in zip(lists, spec.elements, strict=True):
        elements[field.name] = values[:count]
    return State(spec, state_header, elements)
