"""ROS messages of the states, derived from the state table: definitions, Python classes, and bit-exact conversion.

A state `planning.waypoint` becomes the type `mavfi_msgs/PlanningWaypoint`: a `Header` whose stamp is the publication
instant, the sequence `number` of the publication, then the fields of the state with names and types as in the table.
Element fields are arrays of the same name; a header field whose name is also an element field becomes `header_<name>`.
Only the classes require ROS.
"""

import importlib
import io
from contextlib import redirect_stderr, redirect_stdout
from enum import IntEnum
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from mavfi.errors import MavfiError
from mavfi.extras.ros.ros1.finder import find_file
from mavfi.states import STATES, State, StateSpec

MAP = "map"
"""World frame (REP-105), in which all states are expressed."""
FIRST_STAMP_S = 1
"""Stamp of the mission's start (s): in ROS a stamp of 0 means "not set"."""
PACKAGE = "mavfi_msgs"
_TYPES = {"f8": "float64", "f4": "float32", "i4": "int32", "?": "bool"}


class NodeAction(IntEnum):
    """What the world asks of a node, one `mavfi_msgs/Operation` each."""

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


SERVICES = {
    "Drive": """# Lock-step: what a node does next, and what came of the last operation.
mavfi_msgs/Operation[] operations
---
bool due
string[] states
uint64[] numbers
mavfi_msgs/Alarm[] alarms
""",
}
"""Definition of each service of the package, by name."""
_ACTIONS = "\n".join(f"uint8 {action.name} = {action.value}" for action in NodeAction)
_OTHERS = {
    "Operation": f"""# One operation of a kernel or of the detector; state, value: of the number, where that matters;
# publish_us: stamp of what is published at once, -1 = it is held.
{_ACTIONS}
uint8 action
string kernel
uint64 number
int64 time_us
int64 publish_us
string state
uint8[] value
""",
    "Alarm": """# A detector's alarm on one publication.
std_msgs/Header header
uint64 number
string state
string source
string stage
bool abandon_waypoint
bool stop
float64 score
string[] fields
bool hard
bool withhold
""",
}


def type_name(spec: StateSpec) -> str:
    """Message type name of a state, without its package: `planning.waypoint` -> `PlanningWaypoint`."""
    return "".join(word.capitalize() for word in spec.name.replace(".", "_").split("_"))


def header_slots(spec: StateSpec) -> tuple[str, ...]:
    """Message field names of the state's header, in table order."""
    slots = []
    for field in spec.header:
        if spec.in_elements(field.name):
            slots.append(f"header_{field.name}")
        else:
            slots.append(field.name)
    return tuple(slots)


def element_slots(spec: StateSpec) -> tuple[str, ...]:
    """Message field names of the state's elements, in table order."""
    return tuple(field.name for field in spec.elements)


def message_text(spec: StateSpec) -> str:
    """Message definition of a state, as in a `.msg` file."""
    lines = [f"# {spec.name}, published by {spec.writer}: {spec.rate}.", "std_msgs/Header header", "uint64 number"]
    lines += [f"{_TYPES[f.dtype]} {slot}  # {f.unit}" for slot, f in zip(header_slots(spec), spec.header, strict=True)]
    slots = zip(element_slots(spec), spec.elements, strict=True)
    lines += [f"{_TYPES[f.dtype]}[] {slot}  # {f.unit}, per {spec.element}" for slot, f in slots]
    return "\n".join(lines) + "\n"


def definitions() -> dict[str, str]:
    """Definition of each message of the package, by name."""
    return {type_name(spec): message_text(spec) for spec in STATES.values()} | _OTHERS


# ---- Python classes --------------------------------------------------------------------------------------------------
_PACKAGE = (
    f'<package format="2"><name>{PACKAGE}</name><version>1.0.0</version><description>Generated.'
    '</description><maintainer email="mavfi@localhost">mavfi</maintainer><license>Apache-2.0</license></package>\n'
)
"""The `package.xml` by which ROS's own tools find the messages."""


def generate(folder: Path) -> None:
    """Write the definitions and classes of `mavfi_msgs` to a folder.

    Raises:
        MavfiError: The generator fails.
    """
    from genpy import generate_initpy
    from genpy.generator import MsgGenerator, SrvGenerator

    package = PACKAGE
    sources = folder / package
    search = {"std_msgs": [str(find_file("usr/share/std_msgs/msg"))], package: [str(sources / "msg")]}
    for ending, texts, generator in (("msg", definitions(), MsgGenerator()), ("srv", SERVICES, SrvGenerator())):
        target = sources / ending
        target.mkdir(parents=True, exist_ok=True)
        for name, text in texts.items():
            (target / f"{name}.{ending}").write_text(text)
        files = sorted(str(path) for path in target.glob(f"*.{ending}"))
        output = io.StringIO()
        with redirect_stdout(output), redirect_stderr(output):
            failed = generator.generate_messages(package, files, str(target), search)
            generate_initpy.write_modules(str(target))
        if failed:
            raise MavfiError(f"ROS messages: {output.getvalue().strip()}")
        for path in target.glob("_*.py"):
            # genpy generates a method name that NumPy has removed
            path.write_text(path.read_text().replace(".tostring()", ".tobytes()"))
    (sources / "package.xml").write_text(_PACKAGE)
    (sources / "__init__.py").touch()


@cache
def state_types() -> dict[str, Any]:
    """Message class of each state, with list fields as NumPy arrays."""
    from rospy.numpy_msg import numpy_msg

    module = importlib.import_module(f"{PACKAGE}.msg")
    return {name: numpy_msg(getattr(module, type_name(spec))) for name, spec in STATES.items()}


@cache
def message_type(name: str) -> Any:
    """Any other message class of `mavfi_msgs`, e.g. "Alarm"."""
    return getattr(importlib.import_module(f"{PACKAGE}.msg"), name)


# ---- conversion ------------------------------------------------------------------------------------------------------
_SLOTS = {spec.name: (header_slots(spec), element_slots(spec)) for spec in STATES.values()}


def to_stamp(stamp: Any, time_us: int) -> None:
    """Set a `genpy.Time` to an instant of the flight."""
    seconds, rest = divmod(time_us, 1_000_000)
    stamp.secs = seconds + FIRST_STAMP_S
    stamp.nsecs = 1_000 * rest


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
    count = min(map(len, lists), default=0)
    elements = np.zeros(count, spec.element_dtype)
    for values, field in zip(lists, spec.elements, strict=True):
        elements[field.name] = values[:count]
    return State(spec, state_header, elements)


def serialized(state: State, number: int) -> bytes:
    """The message of a publication, as sent on its topic, without an instant."""
    content = io.BytesIO()
    to_msg(state, number, 0, state_types()[state.spec.name]).serialize(content)
    return content.getvalue()


def deserialized(content: bytes, name: str) -> State:
    """The state of a message as `serialized`, of the state with this name."""
    message = state_types()[name]()
    message.deserialize(content)
    return from_msg(message, STATES[name])
