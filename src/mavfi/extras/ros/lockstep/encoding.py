"""What travels between nodes, as bytes: values of states, operations of the world, and answers.

A value is its number, its instant, and the bytes of its header and its elements, so that every bit survives.
Operations and answers are JSON.
"""

import json
import struct
from dataclasses import asdict, dataclass, field
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from mavfi.detectors.detector import Alarm
from mavfi.states import State, StateSpec

_HEAD = struct.Struct("<qq")  # little-endian: number, instant (us)
HELD = -1
"""In place of the instant of publication: the node holds the result until the world asks for its publication."""


class TopicFrame(NamedTuple):
    """One publication of any topic.

    Attributes:
        number: Of the value or call; see `GREETING`.
        time_us: Instant of the flight (us); of a greeting, the process id of its sender.
        content: The rest.
    """

    number: int
    time_us: int
    content: bytes


GREETING = -1
"""Number of the publication with which a publisher greets new subscribers."""


def to_frame(number: int, time_us: int, content: bytes = b"") -> bytes:
    """The bytes of a publication."""
    return _HEAD.pack(number, time_us) + content


def from_frame(frame: bytes) -> TopicFrame:
    """The publication with these bytes."""
    number, time_us = _HEAD.unpack_from(frame)
    return TopicFrame(number, time_us, frame[_HEAD.size :])


# ---- values ----------------------------------------------------------------------------------------------------------
def to_bytes(state: State) -> bytes:
    """The bits of a value: header, then elements."""
    return state.header.tobytes() + state.elements.tobytes()


def from_bytes(spec: StateSpec, content: bytes) -> State:
    """The value with these bits, in memory of its own."""
    memory = bytearray(content)
    size = spec.header_dtype.itemsize
    header = np.frombuffer(memory, spec.header_dtype, 1)
    if len(memory) == size:
        return State(spec, header, spec.no_elements)
    return State(spec, header, np.frombuffer(memory, spec.element_dtype, offset=size))


# ---- operations and answers ------------------------------------------------------------------------------------------
class NodeAction(IntEnum):
    """What the world asks of a node, one `NodeOrder` each."""

    RECEIVE = 0  # the kernel receives the publication `number`
    STEP = 1  # the kernel computes; its results get the numbers from `number` on
    PUBLISH = 2  # the result `number` is published
    MARK = 3  # the kernel marks its memory
    ROLLBACK = 4  # the kernel's memory becomes that of the last mark
    STOP = 5  # the setpoint generator abandons its trajectory
    ABANDON = 6  # the setpoint generator skips a way-point
    AGAIN = 7  # the kernel prepares to repeat its last step
    GIVE = 8  # the publication `number` is `value`: one of before the node's restart
    RESUME = 9  # the kernel continues from what was given
    RESET = 10  # the node's kernels are constructed again
    CHECK = 11  # the detector checks the publication `number`
    ACCEPT = 12  # the detector records the publication `number`


class NodeOrder(NamedTuple):
    """One operation of a kernel or of the detector.

    Attributes:
        action: What is done.
        kernel: By which kernel; for the detector, the state of the value.
        number: Of the publication, or of the first result.
        time_us: Instant of the flight (us).
        publish_us: Instant (us) for which results are published at once; `HELD` = they are held.
        state: Of `value`.
        value: Bits of a value, hexadecimal.
    """

    action: NodeAction
    kernel: str
    number: int = 0
    time_us: int = 0
    publish_us: int = HELD
    state: str = ""
    value: str = ""


@dataclass(slots=True)
class Answer:
    """What came of the operations of a call.

    Attributes:
        due: Whether a received value makes a step due.
        states: Names of the results, or of the states from which a kernel resumed.
        numbers: Their numbers.
        alarm: The detector's alarm.
    """

    due: bool = False
    states: list[str] = field(default_factory=list)
    numbers: list[int] = field(default_factory=list)
    alarm: Alarm | None = None


def operations_to_bytes(operations: list[NodeOrder]) -> bytes:
    """A call."""
    return json.dumps(operations).encode()


def operations_from_bytes(content: bytes) -> list[NodeOrder]:
    """The operations of a call, in order."""
    return [NodeOrder(*values) for values in json.loads(content)]


def answer_to_bytes(answer: Answer) -> bytes:
    """An answer; a float is written such that it reads back bit for bit."""
    alarm = None
    if answer.alarm is not None:
        alarm = asdict(answer.alarm)
    return json.dumps([answer.due, answer.states, answer.numbers, alarm]).encode()


def answer_from_bytes(content: bytes) -> Answer:
    """The answer with these bytes."""
    due, states, numbers, values = json.loads(content)
    alarm = None
    if values is not None:
        alarm = Alarm(**{**values, "fields": tuple(values["fields"])})
    return Answer(due, states, numbers, alarm)
